"""Hulls against those of Qhull: of few points and many, flat, thin, tiny, large and repeated."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.spatial import ConvexHull

from zensim.proto.messages.model_messages import Joint, Origin, Shape
from zensim.sim_server.description.meshes.convex_hull import (
    MAX_HULL_CORNERS,
    Hull,
    HullNotFound,
    find_exact_hull,
    find_hull,
)
from zensim.sim_server.description.wheel_contacts import find_round_wheel

Points = npt.NDArray[np.float64]
CUBE = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).T.reshape(-1, 3)
TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
ELLIPSOID_AXES = np.array([3.0, 2.0, 1.0])
TASKS = Path("/proc/self/task")
SUM_OF_HULLS = """
import hashlib, sys
import numpy as np
from zensim.sim_server.description.meshes.convex_hull import find_hull
points = np.frombuffer(sys.stdin.buffer.read()).reshape(-1, 3)
hull = find_hull(points)
print(hashlib.sha256(hull.corners.tobytes() + hull.faces.tobytes()).hexdigest())
"""


def make_cloud(count: int, seed: int = 1) -> Points:
    points: Points = np.random.default_rng(seed).normal(size=(count, 3))
    return points


def make_ellipsoid(count: int, seed: int = 1) -> Points:
    points = make_cloud(count, seed)
    points *= ELLIPSOID_AXES / np.linalg.norm(points, axis=1)[:, None]
    return points


def make_prism(sides: int, height: float) -> Points:
    turns = np.arange(sides) * 2.0 * np.pi / sides
    ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(sides)], axis=1)
    points: Points = np.concatenate([ring, ring + np.array([0.0, 0.0, height])])
    return points


def make_grid(side: int) -> Points:
    points: Points = np.array(np.meshgrid(*[np.linspace(-1.0, 1.0, side)] * 3)).T.reshape(-1, 3)
    return points


def as_stored(points: Points) -> Points:
    """Round points as a file of binary STL does."""
    return points.astype(np.float32).astype(np.float64)


def find_volume(hull: Hull) -> float:
    first, second, third = (hull.corners[hull.faces[:, i]] for i in range(3))
    origin = hull.corners[0]
    triple = (np.cross(first - origin, second - origin) * (third - origin)).sum()
    return float(triple / 6.0)


def is_closed(hull: Hull) -> bool:
    starts, ends = hull.faces.reshape(-1).tolist(), hull.faces[:, [1, 2, 0]].reshape(-1).tolist()
    edges = set(zip(starts, ends, strict=True))
    return (
        len(edges) == len(starts)
        and all((end, start) in edges for start, end in edges)
        and len(hull.faces) == 2 * len(hull.corners) - 4
    )


def find_gap(points: Points, hull: Hull) -> float:
    """Find how far points are outside a hull, as a share of their extent."""
    directions = make_cloud(400, seed=2)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    reach = (points @ directions.T).max(axis=0) - (hull.corners @ directions.T).max(axis=0)
    return float(reach.max() / np.ptp(points, axis=0).max())


FEW_CORNERS = {
    "cloud": as_stored(make_cloud(500)),
    "large cloud": as_stored(make_cloud(50_000)),
    "plate": make_cloud(500) * [1.0, 1.0, 1e-3],
    "turned plate": as_stored(make_cloud(500) * [1.0, 1.0, 1e-3] @ TURN.T),
    "needle": make_cloud(500) * [1.0, 1e-3, 1e-3],
    "turned needle": as_stored(make_cloud(500) * [1.0, 1e-3, 1e-3] @ TURN.T),
    "grid": make_grid(30),
    "turned grid": as_stored(make_grid(30) @ TURN.T),
    "prism": make_prism(40, 0.2),
    "thin prism": make_prism(32, 1e-3),
    "repeated corners": np.repeat(CUBE, 500, axis=0),
    "plate with a bump": np.concatenate([make_prism(4, 1e-3), [[0.1, 0.2, 0.002]]]) @ TURN.T,
    "spindle": np.array([[1, 0, 0], [-1, 0, 0], [0, 1e-3, 0], [0, 0, 1e-3], [0, -1e-3, -1e-3]])
    @ TURN.T,
    "far away": make_cloud(500) + 1e4,
    "tiny": make_cloud(500) * 1e-9,
    "huge": make_cloud(500) * 1e5,
}


@pytest.mark.parametrize("points", FEW_CORNERS.values(), ids=FEW_CORNERS)
def test_hull_with_few_corners_is_that_of_qhull(points: Points) -> None:
    hull = find_hull(points)

    assert find_volume(hull) == pytest.approx(ConvexHull(points).volume, rel=1e-4)
    assert find_gap(points, hull) < 1e-6
    assert is_closed(hull)


@pytest.mark.parametrize("count", [200, 500, 1500, 5000, 50_000, 110_000])
def test_hull_of_a_round_mesh_is_close_with_few_corners(count: int) -> None:
    points = as_stored(make_ellipsoid(count))

    hull = find_hull(points)

    assert len(hull.corners) <= MAX_HULL_CORNERS
    assert find_volume(hull) == pytest.approx(ConvexHull(points).volume, rel=0.09)
    assert find_gap(points, hull) < 0.03
    assert is_closed(hull)


@pytest.mark.parametrize("seed", range(20))
def test_hull_of_points_on_few_planes_is_found(seed: int) -> None:
    """Corners on common planes and circles, as those of robots' links, differ by rounding only."""
    random = np.random.default_rng(seed)
    rings = [
        make_prism(int(random.integers(8, 200)), random.uniform(0.1, 1.0)) * random.uniform(0.1, 1)
        for _ in range(5)
    ]
    points = as_stored(np.concatenate(rings) @ TURN.T)

    hull = find_hull(points)

    assert find_gap(points, hull) < 0.02
    assert is_closed(hull)


FLAT = {
    "plane": make_cloud(500) * [1.0, 1.0, 0.0],
    "turned plane": make_cloud(500) * [1.0, 1.0, 0.0] @ TURN.T,
    "stored plane": as_stored(make_cloud(500) * [1.0, 1.0, 0.0] @ TURN.T),
    "plane of many": make_cloud(60_000) * [0.0, 1.0, 1.0],
    "line": make_cloud(50) * [1.0, 0.0, 0.0],
    "turned line": make_cloud(50) * [1.0, 0.0, 0.0] @ TURN.T,
    "triangle": np.eye(3),
    "two points": np.repeat([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], 20, axis=0),
    "one point": np.ones((50, 3)),
    "far point": np.full((3, 3), 9e5),
}


@pytest.mark.parametrize("points", FLAT.values(), ids=FLAT)
def test_flat_points_get_a_thickness(points: Points) -> None:
    hull = find_hull(points)

    size = max(float(np.ptp(points, axis=0).max()), 1e-6)
    assert find_volume(hull) > 0.0
    assert is_closed(hull)
    assert np.abs(np.ptp(hull.corners, axis=0) - np.ptp(points, axis=0)).max() < 0.01 * size


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.full((4, 3), np.inf), np.concatenate([CUBE, [[0.0, np.nan, 0.0]]])],
    ids=["none", "infinite", "nan"],
)
def test_points_that_are_not_finite_have_no_hull(points: Points) -> None:
    with pytest.raises(HullNotFound):
        find_hull(points)


def test_points_on_a_plane_have_no_exact_hull() -> None:
    with pytest.raises(HullNotFound):
        find_exact_hull(np.eye(3) * [1.0, 1.0, 0.0])


def test_exact_hull_has_all_corners() -> None:
    points = make_ellipsoid(200)

    hull = find_exact_hull(points)

    assert len(hull.corners) == 200
    assert find_volume(hull) == pytest.approx(ConvexHull(points).volume)
    assert is_closed(hull)


def test_hulls_start_no_thread() -> None:
    """The sandbox of the parser refuses threads, except to root."""
    find_hull(make_cloud(10))
    before = set(TASKS.iterdir())

    find_hull(make_ellipsoid(5000))
    find_exact_hull(make_ellipsoid(256))

    assert set(TASKS.iterdir()) == before


def test_hull_has_the_same_bytes_in_each_process() -> None:
    points = as_stored(make_ellipsoid(5000)).tobytes()
    command = [sys.executable, "-c", SUM_OF_HULLS]

    sums = {
        subprocess.run(
            command,
            input=points,
            capture_output=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    }

    assert len(sums) == 1


@given(
    arrays.arrays(
        np.float64,
        st.tuples(st.integers(1, 40), st.just(3)),
        elements=st.integers(-3, 3).map(float),
    )
)
def test_hull_of_points_of_a_grid_encloses_all(points: Points) -> None:
    """Many points of a grid are on common planes and lines, or equal."""
    spans_space = np.linalg.matrix_rank(points - points.mean(axis=0)) == 3

    hull = find_hull(points)

    assert is_closed(hull)
    if spans_space:
        assert find_volume(hull) == pytest.approx(ConvexHull(points).volume, rel=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("width", [0.2, 0.5, 1.0])
def test_hull_of_a_tyre_with_a_curved_tread_is_a_round_wheel(axis: int, width: float) -> None:
    tyre = trimesh.creation.torus(0.6, 0.4, major_sections=96, minor_sections=48)
    points = np.roll(np.asarray(tyre.vertices) * [1.0, 1.0, width], axis + 1, axis=1)
    hull = find_hull(points + np.array([0.1, 0.2, 0.3]))
    joint = Joint("axle", "continuous", "base", "tyre", axis=tuple(np.eye(3)[axis].tolist()))

    sphere = find_round_wheel(
        Shape("mesh", (1.0, 1.0, 1.0), Origin((-0.1, -0.2, -0.3)), mesh="tyre"),
        joint,
        lambda _: hull.corners.astype(np.float32),
    )

    assert len(hull.corners) <= MAX_HULL_CORNERS
    assert sphere is not None
    assert sphere.size[0] == pytest.approx(1.0, rel=1e-3)
