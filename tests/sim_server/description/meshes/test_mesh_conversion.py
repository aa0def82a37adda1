"""Merging corners: fewer triangles, and still the same shape."""

import numpy as np
import pytest
import trimesh

from zensim.sim_server.description.meshes.mesh_conversion import decimate
from zensim.sim_server.description.meshes.mesh_formats import Triangles

MOST = 20_000


def of(mesh: trimesh.Trimesh) -> Triangles:
    return Triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def extents(found: Triangles) -> list[float]:
    reach: list[float] = np.ptp(found.vertices, axis=0).tolist()
    return reach


def test_fewer_keeps_the_shape_of_a_mesh_that_is_too_fine() -> None:
    ball = of(trimesh.creation.icosphere(subdivisions=7))

    drawn = decimate(ball, MOST)

    assert MOST / 10 < len(drawn.faces) <= MOST
    assert extents(drawn) == pytest.approx([2.0, 2.0, 2.0], abs=0.02)


def test_fewer_leaves_a_mesh_as_it_is_when_it_is_coarse() -> None:
    box = of(trimesh.creation.box())

    assert decimate(box, 12) is box


@pytest.mark.parametrize(("radius_m", "least", "most"), [(0.01, 50, 1000), (0.2, 10_000, MOST)])
def test_fewer_finds_the_finest_grid_that_will_do(radius_m: float, least: int, most: int) -> None:
    ball = of(trimesh.creation.icosphere(subdivisions=5, radius=radius_m))
    far = [[-1.0, -1.0, -1.0], [-1.0, -0.99, -1.0], [-1.0, -1.0, -0.99]]
    corners = np.concatenate([ball.vertices, far])
    faces = np.concatenate([ball.faces, [[len(corners) - 3, len(corners) - 2, len(corners) - 1]]])

    drawn = decimate(Triangles(corners, faces), MOST)

    assert least < len(drawn.faces) < most


def test_fewer_cuts_triangles_off_when_they_touch_nothing() -> None:
    corners = np.random.default_rng(0).random((9000, 3))

    found = decimate(Triangles(corners, np.arange(9000).reshape(-1, 3)), 100)

    assert (len(found.faces), found.faces.max() < len(found.vertices)) == (100, True)
