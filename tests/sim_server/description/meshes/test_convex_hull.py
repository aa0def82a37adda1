"""Hulls against those of Qhull, and degenerate points."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.spatial import ConvexHull

from zensim.sim_server.description.meshes.convex_hull import HullNotFound, find_hull_faces

Points = npt.NDArray[np.float64]
CUBE = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).T.reshape(-1, 3)


def make_prism(sides: int, height: float) -> Points:
    turns = np.arange(sides) * 2.0 * np.pi / sides
    ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(sides)], axis=1)
    return np.concatenate([ring, ring + np.array([0.0, 0.0, height])])


def make_random(kind: str, seed: int) -> Points:
    random = np.random.default_rng(seed)
    points = random.normal(size=(100, 3))
    if kind == "ball":
        points /= np.linalg.norm(points, axis=1)[:, None]
    if kind == "plate":
        points *= [1.0, 1.0, 1e-3]
    if kind == "rod":
        points *= [1.0, 1e-2, 1e-2]
    return points.astype(np.float32).astype(np.float64)


def find_volume(points: Points, faces: npt.NDArray[np.int64]) -> float:
    first, second, third = (points[faces[:, i]] for i in range(3))
    return float((np.cross(first, second) * third).sum() / 6.0)


def find_greatest_height(points: Points, faces: npt.NDArray[np.int64]) -> float:
    """Find how far any point is in front of a face that is not a sliver."""
    first, second, third = (points[faces[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    lengths = np.linalg.norm(normals, axis=1)
    extent = float(np.ptp(points, axis=0).max())
    is_wide = lengths > 1e-6 * extent * extent
    normals, first = normals[is_wide] / lengths[is_wide, None], first[is_wide]
    return float((points @ normals.T - (normals * first).sum(axis=1)).max()) / extent


@pytest.mark.parametrize("kind", ["cloud", "ball", "plate", "rod"])
@pytest.mark.parametrize("seed", range(5))
def test_hull_of_random_points_is_that_of_qhull(kind: str, seed: int) -> None:
    points = make_random(kind, seed)

    faces = find_hull_faces(points)

    assert find_volume(points, faces) == pytest.approx(ConvexHull(points).volume, rel=1e-5)
    assert find_greatest_height(points, faces) < 1e-5


@pytest.mark.parametrize("sides", [3, 4, 12, 32, 60])
@pytest.mark.parametrize("height", [2.0, 1e-3])
def test_hull_of_a_prism_has_its_volume_and_all_corners(sides: int, height: float) -> None:
    points = make_prism(sides, height)

    faces = find_hull_faces(points)

    assert find_volume(points, faces) == pytest.approx(ConvexHull(points).volume, rel=1e-6)
    assert set(faces.reshape(-1).tolist()) == set(range(2 * sides))


def test_hull_of_a_subdivided_box_is_the_box() -> None:
    grid = np.linspace(-1.0, 1.0, 5)
    points = np.array(np.meshgrid(grid, grid, grid)).T.reshape(-1, 3)

    faces = find_hull_faces(points)

    assert len(faces) == 12
    assert find_volume(points, faces) == pytest.approx(8.0)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_hull_does_not_depend_on_the_unit(scale: float) -> None:
    faces = find_hull_faces(CUBE * scale)

    assert find_volume(CUBE, faces) == pytest.approx(8.0)


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.zeros((5, 3)), np.full((4, 3), np.inf), np.full((4, 3), np.nan)],
    ids=["none", "one", "infinite", "nan"],
)
def test_points_without_extent_have_no_hull(points: Points) -> None:
    with pytest.raises(HullNotFound):
        find_hull_faces(points)


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
    if not spans_space:
        return

    faces = find_hull_faces(points)

    assert find_volume(points, faces) == pytest.approx(ConvexHull(points).volume, rel=1e-6)
    assert find_greatest_height(points, faces) < 1e-6
