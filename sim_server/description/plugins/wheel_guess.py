"""Guess the wheels of a robot by geometry, and the drives that would fit them, the likeliest first.

Which of the drives moves the robot is tried elsewhere (`drive_suggestion`).
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import ZERO, Link, Model
from zensim.proto.rigid_transforms import rotate, transform_point
from zensim.sim_server.description.model_geometry import (
    NO_MESHES,
    find_ground_clearance,
    find_link_poses,
    turns_freely,
)
from zensim.sim_server.description.plugins.wheel_measures import MeasuredWheel, measure_wheels

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from zensim.proto.messages.model_messages import Joint, Vec3
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
MIN_ROLLERS = 4
"""Rollers of a wheel, each on a joint of its own."""
OBLIQUE = (0.3, 0.95)
"""|cos| of the angle of fdir1 and the axle of a mecanum wheel, about 0.71."""
MIN_OMNI_WHEELS = 3
OMNI_OFF_CENTRE = 0.3
"""|sin| of the angle up to which the axle of an omni wheel points to the middle."""
STEERED_AXLES = 2


class GuessedPair(NamedTuple):
    """Left and right wheel on one axle."""

    left: MeasuredWheel
    right: MeasuredWheel
    steering: tuple[str, str] | None
    """Joints that steer the wheels; None = not steered."""

    @property
    def x(self) -> float:
        """Place of the axle [m] in the root link."""
        return (self.left.centre[0] + self.right.centre[0]) / 2.0


def find_wheels(lumped: LumpedModel) -> list[MeasuredWheel]:
    """Find the wheels that touch the ground; those of casters, and motors of legs, are left out."""
    upright = _list_upright_joints(lumped)
    free = [
        joint.name
        for joint in _list_rolling_joints(lumped)
        if not _is_caster(joint, lumped.joints, upright)
        and not _is_carried_freely(joint, lumped.joints, upright)
    ]
    return _keep_grounded(free, lumped)


def has_wheels(lumped: LumpedModel) -> bool:
    """Whether wheels touch the ground, also such that no drive turns; casters do not count."""
    upright = _list_upright_joints(lumped)
    by_child = {joint.child: joint for joint in lumped.joints}
    grounded = _keep_grounded([joint.name for joint in _list_rolling_joints(lumped)], lumped)
    by_name = {joint.name: joint for joint in lumped.joints}
    swivels = [_find_swivel(by_name[wheel.joint], by_child, upright) for wheel in grounded]
    poses = find_link_poses(lumped.links[0].name, lumped.joints)
    return any(
        swivel is None
        or swivels.count(swivel) > 1
        or not _trails(wheel, poses[swivel.child].position)
        for wheel, swivel in zip(grounded, swivels, strict=True)
    )


def _trails(wheel: MeasuredWheel, pivot: Vec3) -> bool:
    """Whether a wheel is off the upright axis that it turns about, as that of a caster."""
    x, y, _ = (a - b for a, b in zip(wheel.centre, pivot, strict=True))
    return math.hypot(x, y) > OFF_AXLE * wheel.radius_m


def _list_rolling_joints(lumped: LumpedModel) -> list[Joint]:
    """List the joints that turn freely and carry nothing but rollers."""
    rims = _find_rollers(lumped)
    carriers = {joint.parent for joint in lumped.joints if joint.kind != "fixed"} - set(rims)
    return [
        joint
        for joint in lumped.joints
        if turns_freely(joint) and joint.child not in carriers and joint.parent not in rims
    ]


def _find_rollers(lumped: LumpedModel) -> dict[str, list[Joint]]:
    """Find the rollers of mecanum and omni wheels, by the link of the wheel."""
    carried: dict[str, list[Joint]] = {}
    for joint in lumped.joints:
        if joint.kind != "fixed":
            carried.setdefault(joint.parent, []).append(joint)
    turning = {joint.child for joint in lumped.joints if turns_freely(joint)}
    return {
        link: joints
        for link, joints in carried.items()
        if link in turning
        and len(joints) >= MIN_ROLLERS
        and all(turns_freely(one) and one.child not in carried for one in joints)
    }


def _keep_grounded(names: Sequence[str], lumped: LumpedModel) -> list[MeasuredWheel]:
    wheels = [
        wheel
        for wheel in _measure_with_rollers(names, lumped)
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


def _measure_with_rollers(names: Sequence[str], lumped: LumpedModel) -> list[MeasuredWheel]:
    """Measure wheels; those with rollers reach to the outside of these."""
    rims, children = _find_rollers(lumped), {one.name: one.child for one in lumped.joints}
    found = []
    for wheel in measure_wheels(names, lumped):
        rollers = rims.get(children[wheel.joint], [])
        reach = [
            math.dist(one.centre, wheel.centre) + one.radius_m
            for one in measure_wheels([roller.name for roller in rollers], lumped)
        ]
        radius = max((wheel.radius_m, *reach))
        found.append(
            msgspec.structs.replace(wheel, radius_m=radius, off_axle_m=0.0) if reach else wheel
        )
    return found


def lower_suspensions(lumped: LumpedModel) -> LumpedModel:
    """Lower wheels on sliding joints to the ground, as far as their limits let gravity pull them.

    At joints of zero, wheels with springs often hang above the ground that the body rests on.
    """
    poses = find_link_poses(lumped.links[0].name, lumped.joints)
    ground = _find_ground(lumped)
    slides = {joint.child: joint for joint in lumped.joints if joint.kind == "prismatic"}
    moved: dict[str, Joint] = {}
    rolling = {joint.name: joint for joint in _list_rolling_joints(lumped)}
    for wheel in _measure_with_rollers(list(rolling), lumped):
        slide = slides.get(rolling[wheel.joint].parent)
        gap = wheel.centre[2] - wheel.radius_m - ground
        if slide is None or gap <= 0.0:
            continue
        axis = rotate(poses[slide.child].orientation, slide.axis)
        travel = -slide.lower if axis[2] > 0.0 else slide.upper
        if abs(axis[2]) < UPRIGHT_AXIS_Z or travel <= 0.0:
            continue
        down = tuple(part * -math.copysign(min(gap, travel), axis[2]) for part in slide.axis)
        place = transform_point(slide.origin, (down[0], down[1], down[2]))
        origin = msgspec.structs.replace(slide.origin, position=place)
        moved[slide.name] = msgspec.structs.replace(slide, origin=origin)
    joints = tuple(moved.get(joint.name, joint) for joint in lumped.joints)
    return msgspec.structs.replace(lumped, joints=joints)


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
    if swivel is None:
        return False
    reach = swivel.upper - swivel.lower
    # Cars are written with limits, also where the kind of their joints makes these void.
    is_steered = 0.0 < reach < FULL_TURN_RAD
    is_wide = swivel.kind == "revolute" and reach >= FULL_TURN_RAD
    return (swivel.kind == "continuous" or is_wide) and not is_steered


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


def list_drives(lumped: LumpedModel, name: str = "") -> list[DriveOrder]:
    """List drives for the wheels of a robot, the likeliest first; none without wheels that fit.

    Args:
        lumped: Links and joints, with suspensions where they rest.
        name: Of the robot.
    """
    pairs = find_pairs(lumped)
    fixed = [pair for pair in pairs if pair.steering is None]
    steered = sorted((pair for pair in pairs if pair.steering is not None), key=lambda p: -p.x)
    orders = [*_list_roller_drives(lumped, fixed, name)]
    if not fixed and len(steered) == STEERED_AXLES:
        wheels = [joint for pair in steered for joint in (pair.left.joint, pair.right.joint)]
        orders.append(DriveOrder("ackermann", (*wheels, *_list_steering(steered))))
    orders += [
        DriveOrder("ackermann", (pair.left.joint, pair.right.joint, *_list_steering([ahead])))
        for ahead in steered
        for pair in fixed
    ]
    orders += _list_tricycles(lumped, fixed)
    orders += _list_skid_drives(fixed)
    return list(dict.fromkeys(orders))


def _list_skid_drives(fixed: Sequence[GuessedPair]) -> Iterator[DriveOrder]:
    """List drives of all pairs of one size, and of each pair alone."""
    groups = [[pair for pair in fixed if _is_alike(pair, first)] for first in fixed]
    for pairs in (*groups, *([pair] for pair in fixed)):
        ordered = sorted(pairs, key=lambda pair: -pair.x)
        yield DriveOrder(
            "diff", tuple(end.joint for pair in ordered for end in (pair.left, pair.right))
        )


def _list_tricycles(lumped: LumpedModel, fixed: Sequence[GuessedPair]) -> Iterator[DriveOrder]:
    """List drives for one steered wheel before or behind a pair."""
    upright = _list_upright_joints(lumped)
    by_child = {joint.child: joint for joint in lumped.joints}
    by_name = {joint.name: joint for joint in lumped.joints}
    paired = {end.joint for pair in find_pairs(lumped) for end in (pair.left, pair.right)}
    single = [wheel for wheel in find_wheels(lumped) if wheel.joint not in paired]
    if not fixed or len(single) != 1:
        return
    swivel = _find_swivel(by_name[single[0].joint], by_child, upright)
    if swivel is not None:
        yield DriveOrder("tricycle", (single[0].joint, swivel.name))
        ends = (fixed[0].left.joint, fixed[0].right.joint)
        yield DriveOrder("tricycle", (*ends, swivel.name))


def _list_roller_drives(
    lumped: LumpedModel, fixed: Sequence[GuessedPair], name: str
) -> Iterator[DriveOrder]:
    """List drives of wheels with rollers: names, rollers, fdir1 or their directions say it."""
    wheels = find_wheels(lumped)
    rims = _find_rollers(lumped)
    joints = tuple(end.joint for pair in fixed for end in (pair.left, pair.right))
    children = {joint.name: joint.child for joint in lumped.joints}
    rolled = [wheel for wheel in wheels if children[wheel.joint] in rims]
    diameter = 2.0 * max(wheel.radius_m for wheel in rolled) if rolled else 0.0
    if len(fixed) == MECANUM_PAIRS and len(wheels) == len(joints):
        front, rear = sorted(fixed, key=lambda pair: -pair.x)
        ends = (front.left, front.right, rear.left, rear.right)
        places = tuple(wheel.joint for wheel in ends)
        if rolled or _is_mecanum(places, lumped, name):
            yield DriveOrder("mecanum", places, diameter_m=diameter)
    elif len(wheels) >= MIN_OMNI_WHEELS and _point_apart(wheels):
        places = tuple(wheel.joint for wheel in wheels)
        yield DriveOrder("omni", places, diameter_m=diameter)


def _point_apart(wheels: Sequence[MeasuredWheel]) -> bool:
    """Whether axles point in different directions, and each about to the middle of all."""
    x = sum(wheel.centre[0] for wheel in wheels) / len(wheels)
    y = sum(wheel.centre[1] for wheel in wheels) / len(wheels)
    first = wheels[0].axis
    across = [abs(first[0] * one.axis[1] - first[1] * one.axis[0]) for one in wheels[1:]]
    turned = []
    for wheel in wheels:
        arm = (wheel.centre[0] - x, wheel.centre[1] - y)
        off = abs(arm[0] * wheel.axis[1] - arm[1] * wheel.axis[0])
        turned.append(off <= OMNI_OFF_CENTRE * math.hypot(*arm))
    return max(across) > OMNI_OFF_CENTRE and all(turned)


def _list_steering(pairs: Iterable[GuessedPair]) -> tuple[str, ...]:
    return tuple(name for pair in pairs for name in pair.steering or ())


def _is_alike(pair: GuessedPair, other: GuessedPair) -> bool:
    return abs(pair.left.radius_m - other.left.radius_m) <= SAME_RADIUS * other.left.radius_m


def _is_mecanum(joints: Sequence[str], lumped: LumpedModel, name: str) -> bool:
    found = [joint for joint in lumped.joints if joint.name in joints]
    links = {joint.child: joint for joint in found}
    words = (name, *joints, *links)
    if any(word in one.lower() for one in words for word in MECANUM_WORDS):
        return True
    return all(
        any(
            _is_oblique(shape.contact.direction, links[link.name].axis) for shape in link.collisions
        )
        for link in lumped.links
        if link.name in links
    )


def _is_oblique(direction: Vec3, axis: Vec3) -> bool:
    """Whether friction (fdir1) acts neither along nor across an axle, as that of rollers."""
    along = abs(sum(a * b for a, b in zip(direction, axis, strict=True)))
    return OBLIQUE[0] < along / math.dist(axis, ZERO) < OBLIQUE[1]
