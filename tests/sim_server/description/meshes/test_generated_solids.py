"""Ellipsoids and cones, from a description to the bytes that engines and pages load."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.sim_server.description.robots import a_collision, a_link, a_robot, a_visual, an_inertial
from zensim.proto.messages.model_messages import Shape
from zensim.proto.stl import STL_HEAD, STL_RECORD, read_corners
from zensim.sim_server.description.meshes.generated_solids import (
    CONE_URI,
    ELLIPSOID_URI,
    PRISM_URI,
    is_generated,
    list_corners,
    make_cone,
    make_ellipsoid,
    make_prisms,
)
from zensim.sim_server.description.meshes.mesh_lookup import list_meshes
from zensim.sim_server.description.pipeline import ModelWithMeshes, parse_description, read_robot

ELLIPSOID = '<geometry><ellipsoid radii="0.1 0.2 0.3"/></geometry>'
CONE = '<geometry><cone radius="0.2" length="0.5"/></geometry>'


def a_solid(geometry: str) -> str:
    return a_robot(a_link("a", an_inertial() + a_collision(geometry) + a_visual(geometry)))


def parsed(text: str) -> ModelWithMeshes:
    return parse_description(text, assets={}, allow_missing=False, compat="fixed")


def corners_of(found: ModelWithMeshes, shape: Shape) -> np.ndarray:
    stl = found.meshes[shape.mesh]
    count = (len(stl) - STL_HEAD) // STL_RECORD.itemsize
    corners: np.ndarray = read_corners(stl, count) * np.array(shape.size)
    return corners


def test_sphere_has_corners_on_its_axes_and_little_less_volume() -> None:
    corners = np.array(list_corners(ELLIPSOID_URI))

    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 1.0, atol=1e-8)
    assert {tuple(axis) for axis in np.vstack([np.eye(3), -np.eye(3)])} <= set(map(tuple, corners))


def test_cone_is_centred_with_its_apex_up() -> None:
    corners = np.array(list_corners(CONE_URI))

    assert corners[corners[:, 2].argmax()] == pytest.approx((0.0, 0.0, 0.5))
    assert corners[:, 2].min() == -0.5


def test_ellipsoid_with_equal_radii_is_a_sphere() -> None:
    assert make_ellipsoid((0.2, 0.2, 0.2)) == Shape("sphere", (0.2, 0.0, 0.0))


def test_cone_is_scaled_by_radius_and_length() -> None:
    assert make_cone(0.2, 0.5).size == (0.2, 0.2, 0.5)


def test_only_uris_of_these_solids_are_generated() -> None:
    assert is_generated(ELLIPSOID_URI)
    assert not is_generated("package://robot/cone.stl")


def test_no_file_is_asked_for() -> None:
    assert all(map(is_generated, list_meshes(read_robot(a_solid(ELLIPSOID)))))


@pytest.mark.parametrize(
    ("geometry", "extents"), [(ELLIPSOID, (0.2, 0.4, 0.6)), (CONE, (0.4, 0.4, 0.5))]
)
def test_collision_and_visual_have_the_extents_of_the_solid(
    geometry: str, extents: tuple[float, float, float]
) -> None:
    found = parsed(a_solid(geometry))

    (link,) = found.model.links
    for shape in (*link.collisions, *link.visuals):
        assert np.ptp(corners_of(found, shape), axis=0) == pytest.approx(extents, rel=1e-6)


def test_robots_share_the_mesh_of_a_solid() -> None:
    larger = ELLIPSOID.replace("0.3", "0.9")

    assert set(parsed(a_solid(ELLIPSOID)).meshes) == set(parsed(a_solid(larger)).meshes)


def test_static_model_collides_by_the_same_mesh() -> None:
    fixed = a_solid(CONE).replace("</robot>", "<gazebo><static>true</static></gazebo></robot>")

    assert set(parsed(fixed).meshes) == set(parsed(a_solid(CONE)).meshes)


L_OUTLINE = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0))


@pytest.mark.parametrize("outline", [L_OUTLINE, L_OUTLINE[::-1]])
def test_prisms_fill_a_concave_outline(outline: tuple[tuple[float, float], ...]) -> None:
    prisms = make_prisms(outline, 0.5)

    volumes = [_volume(np.array(list_corners(prism.mesh)) * prism.size) for prism in prisms]
    assert len(prisms) == 4
    assert sum(volumes) == pytest.approx(1.5)
    assert all(is_generated(prism.mesh) for prism in prisms)


def _volume(corners: NDArray[np.float64]) -> float:
    (ax, ay, _), (bx, by, _), (cx, cy, _) = corners[::2].tolist()
    area: float = abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2.0
    return area * float(np.ptp(corners[:, 2]))


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4,5,x", "1,2,3,4,5,6,7", "1e9,2,3,4,5,6"])
def test_other_texts_are_no_prisms(text: str) -> None:
    assert not is_generated(PRISM_URI + text)
