"""Triangles as the page draws them. NumPy only."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Vertices = NDArray[np.float64]
Faces = NDArray[np.uint32]
MIXER = np.uint64(0x9E3779B97F4A7C15)


class Mesh(msgspec.Struct, frozen=True, eq=False):
    """Triangles, counter-clockwise seen from outside."""

    vertices: Vertices
    """(v, 3) [m]."""
    faces: Faces
    """(f, 3), indices of vertices; neighbours share theirs."""


Meshes = Mapping[str, Mesh]
"""By sha256."""
NO_MESHES: Final[Meshes] = MappingProxyType({})


def welded(corners: NDArray[np.float32]) -> Mesh:
    """Make a mesh of loose triangles (3 f, 3) by taking equal corners for one."""
    # Zero has two signs, and one place.
    bits = np.ascontiguousarray(corners + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    mixed = (bits[:, 0] * MIXER + bits[:, 1]) * MIXER + bits[:, 2]
    _, first, places = np.unique(mixed, return_index=True, return_inverse=True)
    faces = places.reshape(-1, 3).astype(np.uint32)
    return Mesh(corners[first].astype(np.float64), faces)
