"""Convex pieces of stored meshes, each cut once for a process."""

from functools import cache
from pathlib import Path

import numpy as np

from zensim.proto.messages.model_messages import Shape
from zensim.proto.stl import read_corners
from zensim.sim_server.physics.casting.hulls import Points, pieces_of


@cache
def pieces(folder: str, shape: Shape, is_static: bool) -> tuple[Points, ...]:  # noqa: FBT001
    """Cut the mesh of a shape, scaled as it is."""
    corners = read_corners(Path(folder, f"{shape.mesh}.stl").read_bytes()) * np.array(shape.size)
    return tuple(pieces_of(corners, is_static=is_static))
