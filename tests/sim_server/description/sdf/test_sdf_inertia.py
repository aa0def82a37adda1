"""Inertia of SDF links from the volumes and densities of their collisions."""

import math
import re
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
import trimesh

from tests.sim_server.description.robots import mentions, subjects
from tests.sim_server.description.sdf_robots import a_link, a_model, a_pose, read
from zensim.proto.messages.model_messages import Inertial, Model
from zensim.sim_server.description.pipeline import parse_world
from zensim.sim_server.description.sdf.sdf_includes import no_includes
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.errors import ModelError

AUTO = '<inertial auto="true"/>'
SUBJECT = "link 'a', inertial: attribute auto"
R, L = 0.3, 0.8
CUBE = "<box><size>1 1 1</size></box>"


def a_collision(shape: str, inside: str = "", name: str = "c") -> str:
    return f'<collision name="{name}">{inside}<geometry>{shape}</geometry></collision>'


def read_auto(*collisions: str, inertial: str = AUTO) -> Inertial:
    return read(a_link("a", "".join(collisions), inertial=inertial)).links[0].inertial


def a_round(tag: str) -> str:
    return f"<{tag}><radius>{R}</radius><length>{L}</length></{tag}>"


def sample_capsule(points: np.ndarray) -> np.ndarray:
    beyond = np.maximum(np.abs(points[:, 2]) - L / 2.0, 0.0)
    return np.asarray(points[:, 0] ** 2 + points[:, 1] ** 2 + beyond**2 < R**2)


SHAPES: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    "box": (
        "<box><size>0.3 0.5 0.9</size></box>",
        lambda p: (np.abs(p) < np.array([0.15, 0.25, 0.45])).all(axis=1),
    ),
    "sphere": (f"<sphere><radius>{R}</radius></sphere>", lambda p: (p**2).sum(axis=1) < R**2),
    "cylinder": (
        a_round("cylinder"),
        lambda p: ((p[:, :2] ** 2).sum(axis=1) < R**2) & (np.abs(p[:, 2]) < L / 2.0),
    ),
    "capsule": (a_round("capsule"), sample_capsule),
    "ellipsoid": (
        "<ellipsoid><radii>0.2 0.4 0.6</radii></ellipsoid>",
        lambda p: ((p / np.array([0.2, 0.4, 0.6])) ** 2).sum(axis=1) < 1.0,
    ),
    "cone": (
        a_round("cone"),
        lambda p: (
            (np.abs(p[:, 2]) < L / 2.0) & (np.hypot(p[:, 0], p[:, 1]) < R * (0.5 - p[:, 2] / L))
        ),
    ),
    "polyline": (
        "<polyline><point>0 0</point><point>0.6 0</point><point>0 0.4</point><height>0.7</height>"
        "</polyline>",
        lambda p: (p > 0.0).all(axis=1) & (p[:, 0] / 0.6 + p[:, 1] / 0.4 < 1.0) & (p[:, 2] < 0.7),
    ),
}
"""Geometry, and whether points are inside."""


@pytest.mark.parametrize("shape", SHAPES)
def test_solid_has_the_mass_and_moments_of_its_points(shape: str) -> None:
    geometry, is_inside = SHAPES[shape]
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (1_000_000, 3))
    inside = points[is_inside(points)]
    mass_kg = 1000.0 * 1.8**3 * len(inside) / len(points)
    spread = mass_kg * np.cov(inside.T, bias=True)

    found = read_auto(a_collision(geometry))

    assert found.mass_kg == pytest.approx(mass_kg, rel=0.03)
    assert found.com_in_link == pytest.approx(inside.mean(axis=0), abs=0.008)
    ixx, ixy, ixz, iyy, iyz, izz = found.inertia
    expected = np.trace(spread) * np.eye(3) - spread
    assert np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) == pytest.approx(
        expected, rel=0.06, abs=0.02 * expected.max()
    )


def test_density_of_a_collision_counts_before_that_of_the_link() -> None:
    light = a_collision(CUBE, "<density>10</density>" + a_pose("-1 0 0 0 0 0"), "light")
    heavy = a_collision(CUBE, a_pose("1 0 0 0 0 1.5707963267948966"), "heavy")

    found = read_auto(
        light, heavy, inertial='<inertial auto="true"><density>30</density></inertial>'
    )

    assert found.mass_kg == pytest.approx(40.0)
    assert found.com_in_link == pytest.approx((0.5, 0.0, 0.0))
    # Two cubes: 40 / 6, and 10 and 30 kg at 1.5 and 0.5 m.
    assert found.inertia == pytest.approx((40 / 6, 0, 0, 40 / 6 + 30, 0, 40 / 6 + 30), abs=1e-9)


def test_written_mass_scales_what_volumes_give() -> None:
    inertial = (
        '<inertial auto="true"><pose>5 0 0 0 0 0</pose><mass>12</mass><inertia><ixx>9</ixx>'
        "</inertia></inertial>"
    )

    found = read_auto(a_collision(CUBE), inertial=inertial)

    assert found.mass_kg == pytest.approx(12.0)
    assert found.com_in_link == (0.0, 0.0, 0.0)
    assert found.inertia == pytest.approx((2.0, 0.0, 0.0, 2.0, 0.0, 2.0))


def test_report_says_what_the_volumes_gave() -> None:
    model = read(a_link("a", a_collision(CUBE), inertial=AUTO))

    assert mentions(model.report, "applied", SUBJECT, "1000 kg")
    assert subjects(model.report, "suspicious") == []


@pytest.mark.parametrize("auto", ["false", "0", ""])
def test_density_without_effect_is_reported(auto: str) -> None:
    inertial = f'<inertial auto="{auto}"><mass>2</mass></inertial>'
    model = read(a_link("a", a_collision(CUBE, "<density>7</density>"), inertial=inertial))

    assert model.links[0].inertial.mass_kg == 2.0
    assert mentions(model.report, "ignored", "link 'a', inertial: <density>")


def test_link_without_collisions_keeps_its_mass_and_says_so() -> None:
    model = read(a_link("a", inertial='<inertial auto="true"><mass>3</mass></inertial>'))

    assert model.links[0].inertial.mass_kg == 3.0
    assert SUBJECT in subjects(model.report, "suspicious")


@pytest.mark.parametrize("density", ["0", "-1", "nan", "x"])
def test_impossible_density_is_refused(density: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_auto(a_collision(CUBE, f"<density>{density}</density>"))

    assert caught.value.slug in {"sdf.mass", "sdf.number"}


def read_mesh_model(solid: trimesh.Trimesh, scale: str) -> Model:
    mesh = a_collision(f"<mesh><uri>model://m/a.stl</uri><scale>{scale}</scale></mesh>")
    data = solid.export(file_type="stl")
    assert isinstance(data, bytes)
    files = {"model://m/a.stl": ("", data)}
    return read_sdf_model(a_model(a_link("a", mesh, inertial=AUTO)), find_mesh=files.get)


@pytest.mark.parametrize("scale", ["1 1 1", "-1 1 1"])
def test_concave_mesh_is_measured_without_its_hull(scale: str) -> None:
    ring = trimesh.creation.annulus(r_min=0.5, r_max=1.0, height=0.2, sections=256)

    model = read_mesh_model(ring, scale)

    mass_kg = 1000.0 * math.pi * 0.75 * 0.2
    found = model.links[0].inertial
    assert found.mass_kg == pytest.approx(mass_kg, rel=1e-3)
    assert found.inertia[5] == pytest.approx(mass_kg * 1.25 / 2.0, rel=1e-3)
    assert msgspec.msgpack.encode(model)
    assert subjects(model.report, "suspicious") == []


def test_unusable_mesh_leaves_its_model_out_of_a_world() -> None:
    mesh = a_collision("<mesh><uri>a.stl</uri></mesh>")
    models = a_model(a_link("a", mesh, inertial=AUTO)) + a_model(
        a_link("a", a_collision(CUBE), inertial=AUTO), attributes='name="n"'
    )
    world = re.sub(r"</?sdf[^>]*>", "", models)

    read = parse_world(
        f'<sdf version="1.11"><world name="w">{world}</world></sdf>',
        resolve=no_includes,
        find_mesh={"a.stl": ("", b"solid")}.get,
    ).world

    assert [placed.name for placed in read.models] == ["n"]
    # The result of the parser is sent, so it must have no numbers of numpy.
    assert msgspec.msgpack.encode(read)


def test_mesh_with_a_hole_is_measured_by_its_hull() -> None:
    cube = trimesh.creation.box()
    cube.update_faces(np.arange(len(cube.faces)) > 0)

    model = read_mesh_model(cube, "2 1 1")

    assert model.links[0].inertial.mass_kg == pytest.approx(2000.0, rel=1e-6)
    assert SUBJECT in subjects(model.report, "suspicious")
