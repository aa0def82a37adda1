from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.spawner.viewer.builders import BLUE, CUBE, a_robot
from zensim.proto.messages.model_messages import Origin, Shape
from zensim.proto.rotation import from_rpy
from zensim.spawner.viewer.form import Form, form_of
from zensim.spawner.viewer.meshes import (
    UNCOLOURED,
    box,
    capsule,
    cylinder,
    link_parts,
    merged,
    shape_mesh,
    top_of,
)
from zensim.spawner.viewer.triangles import Mesh

LENGTHS = st.floats(0.01, 5.0)


def volume(mesh: Mesh) -> float:
    """Signed: positive when the faces are seen counter-clockwise from outside."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def open_edges(mesh: Mesh) -> int:
    edges = Counter((int(face[i]), int(face[(i + 1) % 3])) for face in mesh.faces for i in range(3))
    return sum(edges[a, b] != 1 or edges[b, a] != 1 for a, b in edges)


@given(x=LENGTHS, y=LENGTHS, z=LENGTHS)
def test_box_has_its_volume_and_extents(x: float, y: float, z: float) -> None:
    mesh = box(x, y, z)

    assert volume(mesh) == pytest.approx(x * y * z)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx((x, y, z))


@given(radius=LENGTHS, length=LENGTHS)
def test_cylinder_has_nearly_its_volume_and_stands_along_z(radius: float, length: float) -> None:
    mesh = cylinder(radius, length)

    assert volume(mesh) == pytest.approx(np.pi * radius**2 * length, rel=0.01)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(length)


@given(radius=LENGTHS, length=st.one_of(st.just(0.0), LENGTHS))
def test_capsule_has_nearly_its_volume_and_a_cap_at_each_end(radius: float, length: float) -> None:
    mesh = capsule(radius, length)

    exact = np.pi * radius**2 * (length + 4.0 / 3.0 * radius)
    assert volume(mesh) == pytest.approx(exact, rel=0.03)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(length + 2.0 * radius)


@pytest.mark.parametrize(
    "mesh",
    [box(1.0, 2.0, 3.0), cylinder(0.5, 1.0), capsule(0.5, 1.0), capsule(0.5, 0.0)],
    ids=["box", "cylinder", "capsule", "sphere"],
)
def test_mesh_is_closed(mesh: Mesh) -> None:
    assert open_edges(mesh) == 0


@pytest.mark.parametrize("kind", ["plane", "mesh"])
def test_shape_is_refused_when_it_has_no_triangles(kind: str) -> None:
    with pytest.raises(ValueError, match="use box, sphere, cylinder or capsule"):
        shape_mesh(Shape(kind))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "extents"),
    [
        ("box", (0.4, 0.6, 0.2)),
        ("sphere", (0.8, 0.8, 0.8)),
        ("cylinder", (0.8, 0.8, 0.6)),
        ("capsule", (0.8, 0.8, 1.4)),
    ],
)
def test_shape_has_the_extents_that_its_size_says(
    kind: str, extents: tuple[float, float, float]
) -> None:
    size = extents if kind == "box" else (0.4, 0.6, 0.0)

    mesh = shape_mesh(Shape(kind, size))  # type: ignore[arg-type]

    assert np.ptp(mesh.vertices, axis=0) == pytest.approx(extents)


def test_merged_keeps_every_face_where_it_was() -> None:
    both = merged((box(1.0, 1.0, 1.0), cylinder(0.5, 1.0)))

    assert volume(both) == pytest.approx(volume(box(1, 1, 1)) + volume(cylinder(0.5, 1.0)))
    assert open_edges(both) == 0


def test_parts_are_one_for_each_colour() -> None:
    parts = link_parts((CUBE, Shape("sphere", (0.1, 0.0, 0.0)), CUBE))

    assert [part.rgba for part in parts] == [BLUE, UNCOLOURED]
    assert volume(parts[0].mesh) == pytest.approx(2 * 0.1**3)


def test_part_is_smooth_when_it_has_no_edges() -> None:
    box_part, ball_part = link_parts((CUBE, Shape("sphere", (0.1, 0.0, 0.0))))

    assert ball_part.is_smooth
    assert not box_part.is_smooth


def test_part_from_a_file_is_scaled_and_stands_where_its_origin_says() -> None:
    shape = Shape("mesh", (1.0, -2.0, 1.0), Origin((0.0, 0.0, 5.0)), mesh="sha")

    (part,) = link_parts((shape, Shape("box", (0.1, 0.1, 0.1))), {"sha": box(1.0, 1.0, 1.0)})

    assert part.has_file
    assert np.ptp(part.mesh.vertices[:8], axis=0).tolist() == [1.0, 2.0, 1.0]
    assert volume(part.mesh) == pytest.approx(2.0 + 0.1**3)  # not inside out


def test_part_stands_where_its_origin_says() -> None:
    turned = Origin((1.0, 0.0, 0.0), tuple(from_rpy(0.0, np.pi / 2.0, 0.0)))

    (part,) = link_parts((Shape("cylinder", (0.1, 2.0, 0.0), turned),))

    assert part.mesh.vertices[:, 0].min() == pytest.approx(0.0)
    assert part.mesh.vertices[:, 0].max() == pytest.approx(2.0)


def test_top_is_that_of_the_highest_link() -> None:
    assert top_of(form_of(a_robot())) == pytest.approx(0.05)


def test_top_is_the_base_when_nothing_is_drawn() -> None:
    assert top_of(Form(links=((), ()), hinges=form_of(a_robot()).hinges)) == 0.0
