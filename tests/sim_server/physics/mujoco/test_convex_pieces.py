"""Convex pieces of meshes."""

import numpy as np
import pytest

from zensim.sim_server.physics.mujoco.convex_pieces import (
    SHEET_THICKNESS_M,
    HullPoints,
    split_into_convex_pieces,
    thicken,
)

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def a_cuboid(low: tuple[float, float, float], high: tuple[float, float, float]) -> HullPoints:
    """Triangles (36, 3) of a cuboid, facing outward."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    corners = np.array(low) + corners * (np.array(high) - np.array(low))
    faces = [face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))]
    return np.asarray(corners[np.array(faces)].reshape(-1, 3))


def a_room() -> HullPoints:
    """A cuboid facing inward."""
    return a_cuboid((0, 0, 0), (4, 4, 2)).reshape(-1, 3, 3)[:, ::-1].reshape(-1, 3)


def test_moving_mesh_is_one_hull() -> None:
    both = np.concatenate([a_cuboid((0, 0, 0), (1, 1, 1)), a_cuboid((3, 0, 0), (4, 1, 1))])

    (piece,) = split_into_convex_pieces(both, is_static=False)

    assert len(piece) == 16


def test_convex_component_of_a_static_mesh_stays_whole() -> None:
    both = np.concatenate([a_cuboid((0, 0, 0), (1, 1, 1)), a_cuboid((3, 0, 0), (4, 1, 1))])

    found = split_into_convex_pieces(both, is_static=True)

    assert [len(piece) for piece in found] == [8, 8]
    assert found[1][:, 0].min() == 3.0


def test_concave_mesh_is_a_thin_piece_per_triangle() -> None:
    found = split_into_convex_pieces(a_room(), is_static=True)

    assert [len(piece) for piece in found] == [6] * 12
    for piece in found:
        assert not (np.abs(piece - [2.0, 2.0, 1.0]) < 0.9).all(axis=1).any()


def test_triangle_is_thick_behind_its_front() -> None:
    front = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])

    apart = np.concatenate([front, front[:, [1, 0, 2]] + np.array([5.0, 0.0, 0.0])])
    found = split_into_convex_pieces(apart, is_static=True)

    assert len(found) == 2
    assert np.ptp(found[0][:, 2]) == pytest.approx(SHEET_THICKNESS_M, rel=0.01)


@pytest.mark.parametrize(
    "points",
    [
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]),
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
        np.array([[2.0, 0.0, 0.0]]),
    ],
    ids=["plane", "line", "point"],
)
def test_flat_points_are_thickened(points: HullPoints) -> None:
    found = thicken(points)

    assert np.linalg.matrix_rank(found - found[0], tol=1e-9) == 3
    assert np.abs(found - points.mean(axis=0)).max() < 1.01
