"""The part of manifold3d that zensim calls; its own stubs are not marked as typed."""

import numpy as np
from numpy.typing import NDArray

class Mesh64:
    vert_properties: NDArray[np.float64]
    tri_verts: NDArray[np.uint64]

class Manifold:
    @staticmethod
    def hull_points(pts: NDArray[np.float64]) -> Manifold: ...
    def to_mesh64(self) -> Mesh64: ...
