"""How far a robot reaches below its root link."""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from proto.model import IDENTITY, Model, Origin, Quat, Shape
from sim_server.description.transforms import compose, link_poses, matrix_of

Corners = Callable[[str], npt.NDArray[np.floating]]
"""Corners (n, 3) of the mesh of a `Shape.mesh`, unscaled."""
_NOTHING: dict[str, npt.NDArray[np.floating]] = {}
NO_MESHES: Corners = _NOTHING.__getitem__


def ground_clearance(model: Model, turn: Quat = IDENTITY, corners: Corners = NO_MESHES) -> float:
    """Find the height [m] of the lowest point of all collisions over the root link, joints at zero.

    Negative when it is below the root, so that the robot stands on the ground when its root is
    spawned at minus this height. Planes are left out; 0 when nothing else is there.

    Args:
        model: The robot.
        turn: Orientation of the root link in the world.
        corners: Finds those of a mesh; needed when the robot has any.
    """
    root = Origin(orientation=turn)
    poses = link_poses(model.links[0].name, model.joints)
    return min(
        (
            _lowest(shape, compose(root, compose(poses[link.name], shape.origin)), corners)
            for link in model.links
            for shape in link.collisions
            if shape.kind != "plane"
        ),
        default=0.0,
    )


def _lowest(shape: Shape, pose: Origin, corners: Corners) -> float:
    towards_z = matrix_of(pose)[2]
    if shape.kind == "mesh":
        heights = corners(shape.mesh) @ (np.asarray(shape.size) * towards_z)
        return pose.position[2] + float(heights.min())
    down: list[float] = np.abs(towards_z).tolist()
    if shape.kind == "box":
        reach = sum(part * size / 2.0 for part, size in zip(down, shape.size, strict=True))
    elif shape.kind == "sphere":
        reach = shape.size[0]
    elif shape.kind == "capsule":
        reach = shape.size[0] + down[2] * shape.size[1] / 2.0
    else:
        radius, length, _ = shape.size
        reach = radius * math.hypot(down[0], down[1]) + down[2] * length / 2.0
    return pose.position[2] - reach
