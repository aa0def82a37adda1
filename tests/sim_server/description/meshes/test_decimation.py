"""Meshes with fewer triangles."""

import numpy as np
import pytest
import trimesh

from zensim.sim_server.description.meshes.decimation import decimate
from zensim.sim_server.description.meshes.mesh_triangles import PLAIN, Appearance, Triangles

MOST = 20_000


def of(mesh: trimesh.Trimesh) -> Triangles:
    return Triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def bounding_box(found: Triangles) -> list[float]:
    reach: list[float] = np.ptp(found.vertices, axis=0).tolist()
    return reach


def test_decimation_keeps_the_shape_of_a_mesh() -> None:
    ball = of(trimesh.creation.icosphere(subdivisions=7))

    drawn = decimate(ball, MOST)

    assert MOST / 10 < len(drawn.faces) <= MOST
    assert bounding_box(drawn) == pytest.approx([2.0, 2.0, 2.0], abs=0.02)


def test_decimation_returns_a_coarse_mesh_unchanged() -> None:
    box = of(trimesh.creation.box())

    assert decimate(box, 12) is box


@pytest.mark.parametrize(("radius_m", "least", "most"), [(0.01, 50, 1000), (0.2, 10_000, MOST)])
def test_decimation_uses_the_finest_possible_grid(radius_m: float, least: int, most: int) -> None:
    ball = of(trimesh.creation.icosphere(subdivisions=5, radius=radius_m))
    far = [[-1.0, -1.0, -1.0], [-1.0, -0.99, -1.0], [-1.0, -1.0, -0.99]]
    corners = np.concatenate([ball.vertices, far])
    faces = np.concatenate([ball.faces, [[len(corners) - 3, len(corners) - 2, len(corners) - 1]]])

    drawn = decimate(Triangles(corners, faces), MOST)

    assert least < len(drawn.faces) < most


def test_decimation_drops_triangles_without_common_corners() -> None:
    corners = np.random.default_rng(0).random((9000, 3))

    found = decimate(Triangles(corners, np.arange(9000).reshape(-1, 3)), 100)

    assert (len(found.faces), found.faces.max() < len(found.vertices)) == (100, True)


def test_decimated_mesh_keeps_coordinates_of_its_triangles() -> None:
    ball = trimesh.creation.icosphere(6)
    faces = np.asarray(ball.faces)
    points = np.asarray(ball.vertices)[faces][:, :, :2].astype(np.float32)
    looks = Appearance((PLAIN,), np.zeros(len(faces), np.int64), points)

    drawn = decimate(Triangles(np.asarray(ball.vertices), faces, looks), 20_000)

    assert drawn.appearance is not None
    assert drawn.appearance.coordinates.shape == (len(drawn.faces), 3, 2)
    moved = drawn.vertices[drawn.faces][:, :, :2] - drawn.appearance.coordinates
    assert float(np.abs(moved).max()) < 0.1
