"""Wheels of a drive as its links and joints have them, and what they should be."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import TURNING_KINDS, ZERO, Link, Shape, Vec3
from zensim.proto.rigid_transforms import rotate, transform_point
from zensim.sim_server.description.model_geometry import find_link_poses
from zensim.sim_server.description.parsed_model import MODEL_FRAME
from zensim.sim_server.description.plugins.drive_plugin import UnusableDrive
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.model_geometry import FindCorners
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags


MIN_LENGTH_M, MAX_LENGTH_M = 1e-6, 1e6
ROUND_KINDS = ("sphere", "cylinder", "capsule")
GRAVITY = 9.81
MAX_BACKWARD_AXIS_Y = -0.5
"""y of an axis that points to the right rather than the left."""
LENGTH_TOLERANCE = 0.05
"""Share by which a written length may differ from the measured one."""
ROUND_TOLERANCE = 0.15
"""Share by which the extents of a round mesh may differ across its axle."""
_WheelSize = tuple[Vec3, float, float]
"""Centre in the link, radius [m], distance of the centre from the axle [m]."""


def find_base_link(lumped: LumpedModel) -> str:
    """Find the root link; below a model frame, the first link that is fixed to it."""
    root = lumped.links[0].name
    fixed = (frame.name for frame in lumped.frames if frame.parent == root)
    return next(fixed, root) if root == MODEL_FRAME else root


def check_lengths(tags: PluginTags, tag: str, lengths: Iterable[float]) -> None:
    """Check lengths [m] of wheels; others give wheel speeds that overflow.

    Raises:
        ModelError: One is below a micrometre or above a thousand kilometres.
    """
    for length in lengths:
        if not MIN_LENGTH_M <= length <= MAX_LENGTH_M:
            raise ModelError(
                f"{tags.subject}, {tag}: {length:g} is out of range; "
                f"use {MIN_LENGTH_M:g} to {MAX_LENGTH_M:g} metres",
                slug=f"drive.{tag}",
            )


def check_sides(left: Sequence[str], right: Sequence[str]) -> None:
    """Check that there are as many left as right joints.

    Raises:
        UnusableDrive: There are not, or none.
    """
    if not left or len(left) != len(right):
        raise UnusableDrive(
            f"{len(left)} left and {len(right)} right joints; write as many of each"
        )


def check_wheel_joints(names: Iterable[str], lumped: LumpedModel) -> None:
    """Check that joints exist, turn and differ.

    Raises:
        UnusableDrive: One does not.
    """
    joints = {joint.name: joint for joint in lumped.joints}
    seen: set[str] = set()
    for name in names:
        if name not in joints:
            known = ", ".join(list(joints)[:10]) or "none"
            raise UnusableDrive(
                f"joint {name[:80]!r} does not exist or is fixed; moving joints: {known}"
            )
        if joints[name].kind not in TURNING_KINDS:
            raise UnusableDrive(f"joint {name!r} is {joints[name].kind}; make it continuous")
        if name in seen:
            raise UnusableDrive(f"joint {name!r} is used twice")
        seen.add(name)


def find_grip_torque(
    lumped: LumpedModel, *, radius_m: float, wheels: int, joints: Iterable[str]
) -> float:
    """Find a motor torque [N m] where the plug-in sets none.

    It is the torque at which the wheels slip under the robot's weight, or a joint's lower limit.
    """
    weight = GRAVITY * sum(link.inertial.mass_kg for link in lumped.links)
    limits = {joint.name: joint.effort for joint in lumped.joints if joint.effort > 0.0}
    return min(weight * radius_m / wheels, *(limits.get(name, weight) for name in joints))


class MeasuredWheel(msgspec.Struct, frozen=True):
    """A wheel in the frame of the root link, all joints at zero."""

    joint: str
    centre: Vec3
    axis: Vec3
    radius_m: float
    """0 where the link has no round shape and no mesh that is known here."""
    off_axle_m: float = 0.0
    """Distance of the centre from the axle; infinite for a mesh that is not round."""
    has_collision: bool = True


def rolls_backward(wheel: MeasuredWheel) -> bool:
    """Whether a wheel rolls backward at positive speed of its joint."""
    return wheel.axis[1] < MAX_BACKWARD_AXIS_Y


def measure_wheels(names: Iterable[str], lumped: LumpedModel) -> list[MeasuredWheel]:
    """Find the wheels that joints move."""
    joints = {joint.name: joint for joint in lumped.joints}
    links = {link.name: link for link in lumped.links}
    poses = find_link_poses(lumped.links[0].name, lumped.joints)
    wheels = []
    for joint in (joints[name] for name in names):
        pose = poses[joint.child]
        link = links[joint.child]
        place, radius, off = _measure_wheel(link, joint.axis, lumped.corners)
        centre = transform_point(pose, place)
        axis = rotate(pose.orientation, joint.axis)
        wheels.append(MeasuredWheel(joint.name, centre, axis, radius, off, bool(link.collisions)))
    return wheels


def measure_separation(left: MeasuredWheel, right: MeasuredWheel) -> float:
    """Measure the distance [m] of two wheels along the axis of the first."""
    across = [a - b for a, b in zip(left.centre, right.centre, strict=True)]
    return abs(sum(part * axis for part, axis in zip(across, left.axis, strict=True)))


def lengths_differ(written: float, measured: float) -> bool:
    """Whether a written length is not the measured one; a measured 0 is unknown."""
    return measured > 0.0 and abs(written - measured) > LENGTH_TOLERANCE * measured


def find_diameter_faults(tag: str, diameter_m: float, wheels: Iterable[MeasuredWheel]) -> list[str]:
    """Find the wheels that do not have the diameter of a tag."""
    return [
        f"{tag} is {diameter_m:g} m, but the wheel of {wheel.joint!r} measures "
        f"{2.0 * wheel.radius_m:g} m; {tag} is used"
        for wheel in wheels
        if lengths_differ(diameter_m, 2.0 * wheel.radius_m)
    ]


def find_distance_faults(
    tag: str, distance_m: float, one: MeasuredWheel, two: MeasuredWheel
) -> list[str]:
    """Compare the distance of two wheels along their axle with that of a tag."""
    apart = measure_separation(one, two)
    if abs(distance_m - apart) <= LENGTH_TOLERANCE * apart:
        return []
    return [
        f"{tag} is {distance_m:g} m, but {one.joint!r} and {two.joint!r} are {apart:g} m apart; "
        f"{tag} is used"
    ]


def _measure_wheel(link: Link, axis: Vec3, corners: FindCorners) -> _WheelSize:
    """Measure a wheel; a radius of 0 is unknown."""
    rounds = [shape for shape in link.collisions if shape.kind in ROUND_KINDS]
    if rounds:
        return _measure_round_wheel(rounds, axis)
    for shapes in (link.collisions, link.visuals):
        found = [one for shape in shapes if (one := _measure_mesh_wheel(shape, axis, corners))]
        if found:
            return max(found, key=lambda one: one[1])
    rounds = [shape for shape in link.visuals if shape.kind in ROUND_KINDS]
    return _measure_round_wheel(rounds or [Shape("sphere")], axis)


def _measure_round_wheel(rounds: Sequence[Shape], axis: Vec3) -> _WheelSize:
    widest = max(rounds, key=lambda shape: shape.size[0])
    place = widest.origin.position
    along = sum(a * b for a, b in zip(place, axis, strict=True)) / math.dist(axis, ZERO)
    off = math.sqrt(max(math.dist(place, ZERO) ** 2 - along**2, 0.0))
    return place, widest.size[0], off


def _measure_mesh_wheel(shape: Shape, axis: Vec3, corners: FindCorners) -> _WheelSize | None:
    try:
        points = corners(shape.mesh) if shape.kind == "mesh" else None
    except KeyError:
        return None
    if points is None or not len(points):
        return None
    import numpy as np

    from zensim.proto.se3 import to_matrix

    turn = to_matrix(np.array(shape.origin.orientation))
    placed = (points * shape.size) @ turn.T + shape.origin.position
    # Rows: along the axle, and two directions across.
    basis = np.linalg.svd(np.array([axis]))[2]
    lowest, highest = (placed @ basis.T).min(axis=0), (placed @ basis.T).max(axis=0)
    middle, extents = (lowest + highest) / 2.0, highest - lowest
    radial = float(np.linalg.norm((placed @ basis.T)[:, 1:], axis=1).max())
    is_round = abs(extents[1] - extents[2]) <= ROUND_TOLERANCE * max(extents[1:])
    x, y, z = (basis[0] * middle[0]).tolist()
    return (x, y, z), radial, float(np.hypot(*middle[1:])) if is_round else math.inf
