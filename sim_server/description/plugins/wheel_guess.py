"""Guess the wheels of a robot by geometry, and a drive for them."""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import Link, Model
from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.model_geometry import (
    NO_MESHES,
    find_ground_clearance,
    find_link_poses,
    turns_freely,
)
from zensim.sim_server.description.plugins.drive_plugin import MeasuredWheel, measure_wheels

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from zensim.proto.messages.model_messages import Joint
    from zensim.sim_server.description.joint_reduction import LumpedModel

MIN_WHEEL_RADIUS_M = 0.005
LEVEL_AXIS_Z = 0.2
"""Largest |z| of the axis of a wheel."""
UPRIGHT_AXIS_Z = 0.9
"""Smallest |z| of the axis of a steering joint or caster."""
MIN_AXLE_Y = 0.7
"""Smallest |y| of the axis of wheels that drive forward."""
SAME_RADIUS = 0.05
"""Share by which the radii of a pair may differ."""
OFF_AXLE = 0.2
"""Distance of two wheels from one axle, as a share of their radius."""
GROUND_SHARE = 0.5
"""A wheel's lowest point is not farther from the ground than this share of its radius."""
FULL_TURN_RAD = 2.0 * math.pi
MECANUM_WORDS = ("mecanum", "omni")
MECANUM_PAIRS = 2
STEERED_AXLES = 2


class GuessedPair(NamedTuple):
    """Left and right wheel on one axle."""

    left: MeasuredWheel
    right: MeasuredWheel
    steering: tuple[str, str] | None
    """Joints that steer them."""

    @property
    def x(self) -> float:
        """Place of the axle [m] in the root link."""
        return (self.left.centre[0] + self.right.centre[0]) / 2.0


def find_wheels(lumped: LumpedModel) -> list[MeasuredWheel]:
    """Find the wheels that touch the ground; those of casters, and motors of legs, are left out."""
    upright = _list_upright_joints(lumped)
    carriers = {joint.parent for joint in lumped.joints if joint.kind != "fixed"}
    free = {
        joint.name
        for joint in lumped.joints
        if turns_freely(joint)
        and joint.child not in carriers
        and not _is_caster(joint, lumped.joints, upright)
        and not _is_carried_freely(joint, lumped.joints, upright)
    }
    wheels = [
        wheel
        for wheel in measure_wheels([j.name for j in lumped.joints if j.name in free], lumped)
        if wheel.radius_m >= MIN_WHEEL_RADIUS_M
        and abs(wheel.axis[2]) <= LEVEL_AXIS_Z
        and wheel.off_axle_m <= OFF_AXLE * wheel.radius_m
    ]
    ground = min((_find_ground(lumped), *(wheel.centre[2] - wheel.radius_m for wheel in wheels)))
    return [
        wheel
        for wheel in wheels
        if wheel.centre[2] - wheel.radius_m - ground <= GROUND_SHARE * wheel.radius_m
    ]


def _find_ground(lumped: LumpedModel) -> float:
    """Find the height [m] of the lowest collision; without meshes where they are not known."""
    has_meshes = lumped.corners is not NO_MESHES
    links = lumped.links if has_meshes else tuple(map(_without_meshes, lumped.links))
    return find_ground_clearance(Model("", links, lumped.joints), corners=lumped.corners)


def _without_meshes(link: Link) -> Link:
    shapes = tuple(shape for shape in link.collisions if shape.kind != "mesh")
    return msgspec.structs.replace(link, collisions=shapes)


def _is_carried_freely(wheel: Joint, joints: Iterable[Joint], upright: set[str]) -> bool:
    """Whether a part that turns freely, such as the ring of a differential, carries a wheel."""
    by_child = {joint.child: joint for joint in joints}
    above = by_child.get(wheel.parent)
    while above is not None:
        if turns_freely(above) and above.name not in upright:
            return True
        above = by_child.get(above.parent)
    return False


def _list_upright_joints(lumped: LumpedModel) -> set[str]:
    poses = find_link_poses(lumped.links[0].name, lumped.joints)
    return {
        joint.name
        for joint in lumped.joints
        if (joint.kind == "continuous" or (joint.kind == "revolute" and joint.lower < joint.upper))
        and abs(rotate(poses[joint.child].orientation, joint.axis)[2]) >= UPRIGHT_AXIS_Z
    }


def _is_caster(wheel: Joint, joints: Iterable[Joint], upright: set[str]) -> bool:
    swivel = _find_swivel(wheel, {joint.child: joint for joint in joints}, upright)
    return swivel is not None and _swivels(swivel) and not _has_steering_limits(swivel)


def _swivels(joint: Joint) -> bool:
    is_wide = joint.kind == "revolute" and joint.upper - joint.lower >= FULL_TURN_RAD
    return joint.kind == "continuous" or is_wide


def _has_steering_limits(joint: Joint) -> bool:
    """Whether a joint has limits, also where its kind makes them void: so cars are written."""
    return 0.0 < joint.upper - joint.lower < FULL_TURN_RAD


def _find_swivel(wheel: Joint, by_child: dict[str, Joint], upright: set[str]) -> Joint | None:
    above = by_child.get(wheel.parent)
    while above is not None and above.name not in upright:
        above = by_child.get(above.parent)
    return above


def find_wheels_rolling_aside(lumped: LumpedModel) -> list[MeasuredWheel]:
    """Find the wheels whose axles point ahead, so that they roll to the left."""
    return [
        wheel
        for wheel in find_wheels(lumped)
        if abs(wheel.axis[0]) >= MIN_AXLE_Y and wheel.has_collision
    ]


def find_pairs(lumped: LumpedModel) -> list[GuessedPair]:
    """Find the pairs of equal wheels on one axle, the widest first, names as tie break."""
    wheels = find_wheels(lumped)
    by_child = {joint.child: joint for joint in lumped.joints}
    by_name = {joint.name: joint for joint in lumped.joints}
    upright = _list_upright_joints(lumped)
    found = [(one, two) for one, two in combinations(wheels, 2) if _is_pair(one, two)]
    found.sort(key=lambda pair: (-abs(pair[0].centre[1] - pair[1].centre[1]), pair[0].joint))
    used: set[str] = set()
    pairs = []
    for one, two in found:
        if {one.joint, two.joint} & used:
            continue
        used |= {one.joint, two.joint}
        left, right = (one, two) if one.centre[1] > two.centre[1] else (two, one)
        swivels = [_find_swivel(by_name[end.joint], by_child, upright) for end in (left, right)]
        names = tuple(swivel.name for swivel in swivels if swivel is not None)
        is_steered = len(set(names)) == len(swivels)
        pairs.append(GuessedPair(left, right, (names[0], names[1]) if is_steered else None))
    return pairs


def _is_pair(one: MeasuredWheel, two: MeasuredWheel) -> bool:
    across = [a - b for a, b in zip(one.centre, two.centre, strict=True)]
    apart, radius = abs(across[1]), max(one.radius_m, two.radius_m)
    return (
        min(abs(one.axis[1]), abs(two.axis[1])) >= MIN_AXLE_Y
        and abs(one.radius_m - two.radius_m) <= SAME_RADIUS * radius
        and apart > radius
        and one.centre[1] * two.centre[1] < 0.0
        and math.hypot(across[0], across[2]) <= OFF_AXLE * radius
    )


def suggest_drive(lumped: LumpedModel) -> DriveOrder | None:
    """Suggest a drive for the wheels of a robot; None without a pair of wheels."""
    pairs = find_pairs(lumped)
    fixed = [pair for pair in pairs if pair.steering is None]
    steered = sorted((pair for pair in pairs if pair.steering is not None), key=lambda p: -p.x)
    if not fixed and len(steered) == STEERED_AXLES:
        wheels = [name for pair in steered for name in (pair.left.joint, pair.right.joint)]
        return DriveOrder("ackermann", (*wheels, *_list_steering(steered)))
    if not fixed:
        return None
    if steered:
        joints = (fixed[0].left.joint, fixed[0].right.joint, *_list_steering(steered[:1]))
        return DriveOrder("ackermann", joints)
    same = [pair for pair in fixed if _is_alike(pair, fixed[0])]
    same.sort(key=lambda pair: -pair.x)
    joints = tuple(wheel.joint for pair in same for wheel in (pair.left, pair.right))
    if len(same) == MECANUM_PAIRS and _is_mecanum(joints, lumped):
        return DriveOrder("mecanum", joints)
    return DriveOrder("diff", joints)


def _list_steering(pairs: Iterable[GuessedPair]) -> tuple[str, ...]:
    return tuple(name for pair in pairs for name in pair.steering or ())


def _is_alike(pair: GuessedPair, other: GuessedPair) -> bool:
    return abs(pair.left.radius_m - other.left.radius_m) <= SAME_RADIUS * other.left.radius_m


def _is_mecanum(joints: Sequence[str], lumped: LumpedModel) -> bool:
    links = (joint.child for joint in lumped.joints if joint.name in joints)
    return any(word in name.lower() for name in (*joints, *links) for word in MECANUM_WORDS)
