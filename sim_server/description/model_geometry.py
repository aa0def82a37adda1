"""Geometry of a model: link poses, ground clearance, wheel contact shapes.

A cylinder touches the ground along a line. Engines solve a few contact points of it one after the
other, so that the robot drifts while it turns on the spot. A sphere of the same radius rolls the
same way and touches at one point. Where the twist is applied to the body, friction is removed.
"""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import (
    IDENTITY,
    ZERO,
    Joint,
    Link,
    Model,
    Origin,
    Quat,
    Shape,
    Vec3,
)
from zensim.proto.rigid_transforms import compose, conjugate, from_rpy, rotate


def make_origin(position: Vec3, rpy: tuple[float, ...]) -> Origin:
    """Make a pose from a position [m] and roll, pitch, yaw [rad]."""
    if not any(rpy):
        return Origin(position)
    return Origin(position, from_rpy(*rpy))


def find_link_poses(root: str, joints: tuple[Joint, ...]) -> dict[str, Origin]:
    """Find the pose of each link in the root link, joints at zero; `joints` in tree order."""
    poses = {root: Origin()}
    for joint in joints:
        poses[joint.child] = compose(poses[joint.parent], joint.origin)
    return poses


FindCorners = Callable[[str], npt.NDArray[np.floating]]
"""Corners (n, 3) of the mesh of a `Shape.mesh`, unscaled."""
_NO_CORNERS: dict[str, npt.NDArray[np.floating]] = {}
NO_MESHES: FindCorners = _NO_CORNERS.__getitem__


def find_ground_clearance(
    model: Model, turn: Quat = IDENTITY, corners: FindCorners = NO_MESHES
) -> float:
    """Find the height [m] of the lowest collision point relative to the root link, joints at zero.

    The robot stands on the ground when its root is spawned at minus this height. Planes are left
    out; 0 without other collisions.

    Args:
        model: The robot.
        turn: Orientation of the root link in the world.
        corners: Needed for meshes.
    """
    poses = find_link_poses(model.links[0].name, model.joints)
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


class _TiltedFrame(NamedTuple):
    """Height [m] of a frame over the root link, and the world's z axis in the frame."""

    height: float
    up: Vec3

    def inner(self, origin: Origin) -> "_TiltedFrame":
        """Find the frame at an origin in this frame."""
        height = self.height + sum(a * b for a, b in zip(self.up, origin.position, strict=True))
        return _TiltedFrame(height, rotate(conjugate(origin.orientation), self.up))


def _lowest_height(shape: Shape, frame: _TiltedFrame, corners: FindCorners) -> float:
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


MAX_AXLE_OFFSET = 0.01
"""Distance of a wheel cylinder from its axle, in radii."""
MIN_AXLE_COS = 0.9999
"""Cosine of the angle between the cylinder and its axle."""
MAX_WHEEL_WIDTH = 2.0
"""In radii; wider cylinders are rollers."""


def links_in_contact(model: Model) -> tuple[Link, ...]:
    """List the links with the collisions that engines use: spheres for wheels of the drive."""
    drive = model.drive
    if drive is None:
        return model.links
    if _is_driven_by_twist(drive):
        return tuple(_without_friction(link) for link in model.links)
    axles = _find_axles(drive, model.joints)
    return tuple(
        _with_sphere_wheels(link, axles[link.name]) if link.name in axles else link
        for link in model.links
    )


def describe_contacts(drive: Drive, links: Iterable[Link], joints: Iterable[Joint]) -> list[str]:
    """Describe what `links_in_contact` changes on a robot with this drive."""
    if _is_driven_by_twist(drive):
        return ["friction of its collisions is not used: the twist is applied to the body"]
    axles = _find_axles(drive, joints)
    rolling = [
        repr(link.name)
        for link in links
        if link.name in axles
        and any(is_wheel_cylinder(one, axles[link.name]) for one in link.collisions)
    ]
    if not rolling:
        return []
    return [f"cylinders of {', '.join(rolling)} touch the ground as spheres of their radius"]


def is_wheel_cylinder(shape: Shape, axle: Joint) -> bool:
    """Whether a collision is a cylinder around the axle of its link."""
    radius, length, _ = shape.size
    if shape.kind != "cylinder" or not 0.0 < length <= MAX_WHEEL_WIDTH * radius:
        return False
    axis = np.array(axle.axis) / np.linalg.norm(axle.axis)
    along = np.array(rotate(shape.origin.orientation, (0.0, 0.0, 1.0)))
    if abs(float(along @ axis)) < MIN_AXLE_COS:
        return False
    centre = np.array(shape.origin.position)
    return float(np.linalg.norm(centre - axis * (centre @ axis))) <= MAX_AXLE_OFFSET * radius


def _is_driven_by_twist(drive: Drive) -> bool:
    return any(actuator.mode == "twist" for actuator in drive.actuators)


def _find_axles(drive: Drive, joints: Iterable[Joint]) -> dict[str, Joint]:
    return {joint.child: joint for joint in joints if joint.name in drive.wheel_joints}


def _with_sphere_wheels(link: Link, axle: Joint) -> Link:
    if not any(is_wheel_cylinder(shape, axle) for shape in link.collisions):
        return link
    return msgspec.structs.replace(
        link, collisions=tuple(_replace_cylinders(link.collisions, axle))
    )


def _replace_cylinders(shapes: Iterable[Shape], axle: Joint) -> Iterable[Shape]:
    for shape in shapes:
        if is_wheel_cylinder(shape, axle):
            place = Origin(shape.origin.position)
            yield msgspec.structs.replace(
                shape, kind="sphere", size=(shape.size[0], 0.0, 0.0), origin=place
            )
        else:
            yield shape


def _without_friction(link: Link) -> Link:
    smooth = tuple(_frictionless(shape) for shape in link.collisions)
    return msgspec.structs.replace(link, collisions=smooth)


def _frictionless(shape: Shape) -> Shape:
    contact = msgspec.structs.replace(shape.contact, direction=ZERO, friction_across=0.0)
    return msgspec.structs.replace(shape, friction=0.0, contact=contact)
