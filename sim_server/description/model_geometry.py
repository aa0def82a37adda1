"""Geometry of a model: link poses, extents, ground clearance."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from zensim.proto.messages.model_messages import (
    IDENTITY,
    Joint,
    Link,
    Model,
    Origin,
    Quat,
    ReportEntry,
    Shape,
    Vec3,
)
from zensim.proto.rigid_transforms import (
    compose,
    conjugate,
    from_axis_angle,
    from_rpy,
    normalize,
    rotate,
)
from zensim.sim_server.description.mimic_joints import list_following_joints

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    import numpy as np
    import numpy.typing as npt


FindCorners: TypeAlias = "Callable[[str], npt.NDArray[np.floating]]"
"""Corners (n, 3) of the mesh of a `Shape.mesh`, unscaled."""
_NO_CORNERS: dict[str, npt.NDArray[np.floating]] = {}
NO_MESHES: FindCorners = _NO_CORNERS.__getitem__
NO_POSITIONS: Mapping[str, float] = {}
FALL = ReportEntry("predicted", "driving", "it falls: it has no collisions")
"""Report entry of a model that falls without end."""
UNLIMITED_RAD = 20.0 * math.pi
"""Range from which a joint with limits can be that of a wheel; knees turn once or twice."""


def make_origin(position: Vec3, rpy: tuple[float, ...]) -> Origin:
    """Make a pose from a position [m] and roll, pitch, yaw [rad]."""
    if not any(rpy):
        return Origin(position)
    return Origin(position, from_rpy(*rpy))


def find_link_poses(
    root: str, joints: tuple[Joint, ...], positions: Mapping[str, float] = NO_POSITIONS
) -> dict[str, Origin]:
    """Find the pose of each link in the root link.

    Args:
        root: Name of the root link.
        joints: In tree order.
        positions: Of joints [rad or m], by name; zero for others.
    """
    poses = {root: Origin()}
    for joint in joints:
        child = find_child_pose(joint, positions.get(joint.name, 0.0))
        poses[joint.child] = compose(poses[joint.parent], child)
    return poses


def find_child_pose(joint: Joint, position: float) -> Origin:
    """Find the pose of a joint's child in its parent at a position [rad or m]."""
    if not position or joint.kind == "fixed":
        return joint.origin
    x, y, z = axis = normalize(joint.axis)
    if joint.kind == "prismatic":
        return compose(joint.origin, Origin((x * position, y * position, z * position)))
    return compose(joint.origin, Origin(orientation=from_axis_angle(axis, position)))


def find_start_positions(model: Model) -> dict[str, float]:
    """Find the position of each joint at the start [rad or m], at which a controller holds it."""
    initial = {
        one.joint: one.initial or 0.0 for one in model.command_interfaces if one.kind == "position"
    }
    found = {joint.name: initial.get(joint.name, 0.0) for joint in model.joints}
    for own, leader, ratio, offset in list_following_joints(model.joints):
        start = initial.get(model.joints[leader].name, 0.0)
        found[model.joints[own].name] = ratio * start + offset
    return found


def find_ground_clearance(
    model: Model, turn: Quat = IDENTITY, corners: FindCorners = NO_MESHES
) -> float:
    """Find the height [m] of the lowest collision point relative to the root link at the start.

    The robot stands on the ground when its root is spawned at minus this height. Planes are left
    out; 0 without other collisions.

    Args:
        model: The robot.
        turn: Orientation of the root link in the world.
        corners: Needed for meshes.
    """
    poses = find_link_poses(model.links[0].name, model.joints, find_start_positions(model))
    root = _TiltedFrame(0.0, rotate(conjugate(turn), (0.0, 0.0, 1.0)))
    frames = [(link, root.inner(poses[link.name])) for link in model.links]
    return min(
        (
            _lowest_height(shape, frame.inner(shape.origin), corners)
            for link, frame in frames
            for shape in link.collisions
            if shape.kind != "plane"
        ),
        default=0.0,
    )


def find_extents(
    link: Link, directions: Iterable[Vec3], corners: FindCorners = NO_MESHES
) -> list[float]:
    """Find the lengths [m] of a link's collisions along unit directions in the link."""
    found = []
    for x, y, z in directions:
        frames = (_TiltedFrame(0.0, (x, y, z)), _TiltedFrame(0.0, (-x, -y, -z)))
        ends = (
            min(
                _lowest_height(shape, frame.inner(shape.origin), corners)
                for shape in link.collisions
            )
            for frame in frames
        )
        found.append(-sum(ends))
    return found


def falls_without_end(model: Model) -> bool:
    """Whether a model has weight and nothing to stand on; engines give mass to what has none."""
    mass_kg = sum(link.inertial.mass_kg for link in model.links)
    lifted_kg = sum(link.weightless.mass_kg for link in model.links)
    stands = any(link.collisions for link in model.links)
    return not (model.is_static or stands) and (mass_kg > lifted_kg or lifted_kg == 0.0)


def list_joints_above(model: Model, joint: Joint) -> Iterator[str]:
    """List the names of the joints between a joint and the root, the nearest first."""
    by_child = {one.child: one for one in model.joints}
    parent = by_child.get(joint.parent)
    while parent is not None:
        yield parent.name
        parent = by_child.get(parent.parent)


def turns_freely(joint: Joint) -> bool:
    """Whether a joint turns without limits, as that of a wheel; some wheels have wide limits."""
    is_wide = joint.kind == "revolute" and joint.upper - joint.lower >= UNLIMITED_RAD
    return joint.mimic is None and (joint.kind == "continuous" or is_wide)


class _TiltedFrame(NamedTuple):
    """Height [m] of a frame over the root link, and the world's z axis in the frame."""

    height: float
    up: Vec3

    def inner(self, origin: Origin) -> _TiltedFrame:
        """Find the frame at an origin in this frame."""
        height = self.height + sum(a * b for a, b in zip(self.up, origin.position, strict=True))
        return _TiltedFrame(height, rotate(conjugate(origin.orientation), self.up))


def _lowest_height(shape: Shape, frame: _TiltedFrame, corners: FindCorners) -> float:
    if shape.kind == "mesh":
        heights = corners(shape.mesh) @ [a * b for a, b in zip(shape.size, frame.up, strict=True)]
        return frame.height + float(heights.min(initial=math.inf))
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
