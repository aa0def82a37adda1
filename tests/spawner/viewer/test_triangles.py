"""Loose triangles become a mesh whose neighbours share their corners."""

import numpy as np

from zensim.spawner.viewer.triangles import welded

SQUARE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [-0.0, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32
)


def test_equal_corners_are_one_vertex() -> None:
    mesh = welded(SQUARE)

    assert len(mesh.vertices) == 4
    assert np.array_equal(mesh.vertices[mesh.faces.reshape(-1)], SQUARE)


def test_different_corners_stay_apart() -> None:
    corners = np.random.default_rng(0).normal(size=(30_000, 3)).astype(np.float32)

    mesh = welded(corners)

    assert len(mesh.vertices) == 30_000
    assert np.array_equal(mesh.vertices[mesh.faces.reshape(-1)], corners)
