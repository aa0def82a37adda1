"""How far a robot reaches below its root link."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import IDENTITY, Model, Origin, Quat, Shape, Vec3
from zensim.sim_server.description.transforms import link_poses

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
    poses = link_poses(model.links[0].name, model.joints)
    root = _Frame(0.0, _unturned(turn, (0.0, 0.0, 1.0)))
    frames = [(link, root.inner(poses[link.name])) for link in model.links]
    return min(
        (
            _lowest(shape, frame.inner(shape.origin), corners)
            for link, frame in frames
            for shape in link.collisions
            if shape.kind != "plane"
        ),
        default=0.0,
    )


class _Frame(NamedTuple):
    """How high a frame is over the root link, and which way is up in it."""

    height: float
    up: Vec3

    def inner(self, origin: Origin) -> "_Frame":
        """Find the frame at an origin in this one."""
        height = self.height + sum(a * b for a, b in zip(self.up, origin.position, strict=True))
        return _Frame(height, _unturned(origin.orientation, self.up))


def _lowest(shape: Shape, frame: _Frame, corners: Corners) -> float:
    if shape.kind == "mesh":
        heights = corners(shape.mesh) @ np.multiply(shape.size, frame.up)
        return frame.height + float(heights.min())
    down = [abs(part) for part in frame.up]
    if shape.kind == "box":
        reach = sum(part * size / 2.0 for part, size in zip(down, shape.size, strict=True))
    elif shape.kind == "sphere":
        reach = shape.size[0]
    elif shape.kind == "capsule":
        reach = shape.size[0] + down[2] * shape.size[1] / 2.0
    else:
        radius, length, _ = shape.size
        reach = radius * math.hypot(down[0], down[1]) + down[2] * length / 2.0
    return frame.height - reach


def _unturned(turn: Quat, vector: Vec3) -> Vec3:
    """Find in a turned frame a direction that is given outside of it."""
    if turn == IDENTITY:
        return vector
    x, y, z, w = turn
    vx, vy, vz = vector
    tx, ty, tz = 2.0 * (z * vy - y * vz), 2.0 * (x * vz - z * vx), 2.0 * (y * vx - x * vy)
    return (
        vx + w * tx + z * ty - y * tz,
        vy + w * ty + x * tz - z * tx,
        vz + w * tz + y * tx - x * ty,
    )
