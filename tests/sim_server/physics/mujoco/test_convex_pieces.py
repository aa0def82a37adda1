"""Convex pieces of meshes."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.optimize import linprog

from zensim.sim_server.physics.mujoco.convex_pieces import (
    COARSE_TOLERANCE_M,
    PLATE_TOLERANCE_M,
    SHEET_THICKNESS_M,
    HullPoints,
    join_close_corners,
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


def test_concave_mesh_is_a_thin_plate_per_wall() -> None:
    found = split_into_convex_pieces(a_room(), is_static=True)

    assert [len(piece) for piece in found] == [8] * 6
    for piece in found:
        assert not (np.abs(piece - [2.0, 2.0, 1.0]) < 0.9).all(axis=1).any()


def a_grid(height_of: Callable[[float, float], float], cells: int) -> HullPoints:
    """Triangles (6 cells^2, 3) of a surface above a square of 1 m by 1 m."""
    places = np.linspace(0.0, 1.0, cells + 1)
    corners = [
        (places[x + dx], places[y + dy])
        for x in range(cells)
        for y in range(cells)
        for dx, dy in ((0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1))
    ]
    return np.array([(x, y, height_of(x, y)) for x, y in corners])


def find_top(pieces: Sequence[HullPoints], x: float, y: float) -> float:
    """Find the height of the hulls of pieces at a place."""
    tops = [-math.inf]
    for piece in pieces:
        # The top is the greatest height of a convex combination of corners above the place.
        weights = linprog(
            -piece[:, 2], A_eq=np.vstack([piece[:, :2].T, np.ones(len(piece))]), b_eq=[x, y, 1.0]
        )
        tops += [-weights.fun] if weights.success else []
    return max(tops)


def test_fine_flat_surface_is_a_few_plates_that_keep_to_its_outline() -> None:
    flat = a_grid(lambda _x, _y: 0.0, 8)
    is_corner = (flat.reshape(-1, 3, 3)[:, :, :2] > 0.49).all(axis=(1, 2))
    angle = flat.reshape(-1, 3, 3)[~is_corner].reshape(-1, 3)

    found = split_into_convex_pieces(angle, is_static=True)

    assert len(found) <= 3
    assert find_top(found, 0.9, 0.25) == pytest.approx(0.0, abs=1e-9)
    assert find_top(found, 0.25, 0.9) == pytest.approx(0.0, abs=1e-9)
    assert find_top(found, 0.6, 0.6) == -math.inf


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["bowl", "dome"])
def test_plates_of_a_curved_surface_keep_to_it(sign: float) -> None:
    def height_of(x: float, y: float) -> float:
        return sign * 0.3 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)

    surface = a_grid(height_of, 24)
    # A fin makes the dome concave as a whole.
    fin = np.array([[0.0, 0.0, height_of(0, 0)], [1.0, 0.0, height_of(1, 0)], [0.5, 0.0, 0.9]])
    found = split_into_convex_pieces(np.concatenate([surface, fin]), is_static=True)

    assert len(found) < 2 * 24 * 24 / 8
    for x, y in np.random.default_rng(3).uniform(0.05, 0.95, (12, 2)).tolist():
        assert find_top(found, x, y) == pytest.approx(height_of(x, y), abs=PLATE_TOLERANCE_M + 5e-4)


def test_every_triangle_of_a_double_sided_sheet_has_a_plate_behind_it() -> None:
    flat = a_grid(lambda _x, _y: 0.0, 4)
    both = np.concatenate([flat, flat.reshape(-1, 3, 3)[:, ::-1].reshape(-1, 3)])

    found = split_into_convex_pieces(both, is_static=True)

    assert len(found) == 2
    assert find_top(found, 0.5, 0.5) == pytest.approx(SHEET_THICKNESS_M)


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


def test_wrinkled_surface_has_fewer_plates_that_keep_to_it_less_closely() -> None:
    def height_of(x: float, y: float) -> float:
        return 0.008 * math.sin(25.0 * x) * math.sin(25.0 * y)

    surface = a_grid(height_of, 40)
    found = split_into_convex_pieces(surface, is_static=True)

    assert len(found) < 200
    for x, y in np.random.default_rng(3).uniform(0.05, 0.95, (12, 2)).tolist():
        assert find_top(found, x, y) == pytest.approx(height_of(x, y), abs=COARSE_TOLERANCE_M)


def test_concave_part_that_plates_would_fill_is_its_hull() -> None:
    (piece,) = split_into_convex_pieces(a_room() * 0.005, is_static=True)

    assert len(piece) == 8


def test_corners_that_are_close_become_one() -> None:
    fine = a_grid(lambda _x, _y: 0.0, 50).reshape(-1, 3, 3) * 0.1

    joined = join_close_corners(fine, 0.01)

    assert 0 < len(joined) < len(fine) / 4
    corners = {tuple(corner) for corner in joined.reshape(-1, 3).tolist()}
    assert corners <= {tuple(corner) for corner in fine.reshape(-1, 3).tolist()}


def test_wire_keeps_its_triangles() -> None:
    wire = a_cuboid((0.0, 0.0, 0.0), (0.3, 2e-4, 2e-4)).reshape(-1, 3, 3)

    joined = join_close_corners(wire, 0.002)

    assert np.ptp(joined, axis=(0, 1)) == pytest.approx([0.3, 2e-4, 2e-4])
