"""Report entries on a robot that will not drive as commanded: what it does, and why.

Each entry compares the prediction with the drive's own sizes; the cause is what makes the
deviation at least half as large when it is taken away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zensim.proto.messages.drive_messages import DiffDrive, SteeringDrive
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.ground_friction import GroundFriction, GroundMotion
from zensim.sim_server.description.model_geometry import (
    FALL,
    NO_MESHES,
    falls_without_end,
    find_link_poses,
    list_joints_above,
    turns_freely,
)
from zensim.sim_server.description.motion_prediction import (
    STRAIGHT,
    PredictedMotion,
    find_drive_targets,
    find_middle,
    is_moved_by_twist,
    limit_position,
    make_joint_targets,
    predict_motion,
    turn_command,
)
from zensim.sim_server.description.plugins.wheel_measures import MAX_BACKWARD_AXIS_Y
from zensim.sim_server.description.rest_pose import MAX_TILT_RAD

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from zensim.proto.drives.measured_joints import PlanarTwist
    from zensim.proto.messages.drive_messages import Drive
    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.description.ground_friction import GroundContact
    from zensim.sim_server.description.model_geometry import FindCorners
    from zensim.sim_server.description.rest_pose import RestPose

TOLERANCE = 0.02
"""Share by which a robot may deviate without an entry."""
DRIFT_RAD_S = 0.01
"""Turn by which a robot that is commanded straight may deviate without an entry."""
MIN_TILT_RAD = math.radians(1.0)
MAX_BLOCKED_RAD = 0.01
"""Range of a joint below which it does not turn."""
MIN_CLEARANCE_M, MIN_BURIED_M = 1e-5, 0.05
"""Height of a wheel over the ground, and depth of a centre of mass in it, worth a word."""
NO_LOAD_SHARE = 0.005
"""Share of the weight below which a driven wheel counts as without load."""
STANDS_SHARE = 0.02
"""Share of the command below which a robot counts as standing."""
SAME_RATIO = 0.005
"""Difference of the ratios of speed and turn up to which they share an entry."""
AXLE_SHARE = 0.02
"""Distance along the robot, relative to that across, from which wheels are on two axles."""
DRAG_SHARE = 0.25
"""Share of what driven wheels can transmit, from which a robot's friction is simulated exactly.

Below, PyBullet's friction is within 1 % of Coulomb's without carriers of wheels.
"""
SINKS = "it sinks"
MAX_NAMED = 3
"""Joints that one entry names."""
COST = ReportEntry(
    "predicted",
    "cost",
    "its wheels slide or drag what slides: in PyBullet it takes 1.2 to 2 times as long to step",
)


class DrivingNotes(NamedTuple):
    """What the prediction says about a robot.

    Attributes:
        entries: Where it will not drive as commanded, and what it costs.
        drags: See `Model.drags`.
    """

    entries: tuple[ReportEntry, ...]
    drags: bool


def describe_driving(model: Model, corners: FindCorners = NO_MESHES) -> DrivingNotes:
    """Describe where a robot will not drive as commanded, on level ground of friction 1.

    Args:
        model: The robot; nothing is said without a drive.
        corners: Needed for meshes.
    """
    if model.drive is None or model.is_static:
        return DrivingNotes((), drags=False)
    drags = False
    try:
        # A description may have any numbers up to 1e12.
        with np.errstate(all="ignore"):
            friction = GroundFriction(model, corners)
            motions = tuple(_predict_motions(model, model.drive, friction))
            lines = tuple(_list_lines(_Case(model, friction), motions))
            drags = any(_find_drag_share(model, one) > DRAG_SHARE for one in motions)
    except (ArithmeticError, np.linalg.LinAlgError):
        lines = ("not predicted: its sizes and masses differ too much",)
    entries = tuple(ReportEntry("predicted", FALL.subject, one) for one in lines)
    return DrivingNotes((*entries, COST) if drags else entries, drags)


def _predict_motions(
    model: Model, drive: Drive, friction: GroundFriction
) -> Iterator[PredictedMotion]:
    """Predict driving straight, and turning if it stands."""
    yield (straight := predict_motion(model, STRAIGHT, friction))
    if straight.ground.rest.is_stable:
        yield predict_motion(model, turn_command(drive), friction)


def _list_lines(case: _Case, motions: tuple[PredictedMotion, ...]) -> Iterator[str]:
    straight, *turns = motions
    yield from _describe_rest(case, straight.ground)
    if all(one.ground.motion.is_converged for one in motions):
        for turn in turns:
            if line := _describe_reversed(case.model):
                yield line
            else:
                yield from _describe_motions(case, straight, turn)
    elif turns:
        where = _describe_dragged(case.model, straight.ground)
        yield (
            "its motion is not predicted: what drives it and what drags are nearly equal"
            + (f"; {where}" if where else "")
        )


def _find_drag_share(model: Model, motion: PredictedMotion) -> float:
    """Find the power of friction over the most that the driven wheels can transmit."""
    if is_moved_by_twist(model) or not motion.ground.motion.is_converged:
        return 0.0
    speeds = make_joint_targets(model, find_drive_targets(model, motion.command)).speeds
    most = sum(
        one.load_n * max(one.friction) * abs(speeds[one.wheel]) * one.radius_m
        for one in motion.ground.contacts
        if one.wheel in speeds
    )
    return motion.ground.motion.power_w / most if most > 0.0 else 0.0


def _describe_rest(case: _Case, ground: GroundMotion) -> Iterator[str]:
    model, rest = case.model, ground.rest
    if falls_without_end(model):
        yield FALL.reason
        return
    if not rest.is_stable and (loose := _list_loose_joints(case)):
        borne = "its wheels" if _carry_wheels(model, loose) else "parts that touch the ground"
        yield f"{SINKS}: nothing holds {_name_some(loose)}, and {borne} are on them"
        return
    if not rest.is_stable:
        yield from _describe_fall(model, rest)
        return
    yield from _describe_buried_masses(model, rest)
    if rest.tilt_rad > MIN_TILT_RAD:
        yield f"it rests tilted by {math.degrees(rest.tilt_rad):.1f} degrees"
    if idle := _list_idle_wheels(model, ground):
        yield f"driven wheels carry no load: {', '.join(idle)}"


def _describe_fall(model: Model, rest: RestPose) -> Iterator[str]:
    wheels = {joint.child for joint in model.joints if joint.name in _driven_wheels(model)}
    bare = [one.name for one in model.links if one.name in wheels and not one.collisions]
    if rest.tilt_rad > MAX_TILT_RAD:
        yield "it falls over: its centre of mass is not above its supports"
    elif bare:
        yield f"it falls over: it finds no rest without collisions of {_name_some(bare)}"


def _describe_buried_masses(model: Model, rest: RestPose) -> Iterator[str]:
    """Describe the link whose centre of mass is deepest in the ground."""
    com = np.array([link.inertial.com_in_link for link in model.links])
    depths = -rest.frames.points(np.arange(len(com)), com)[:, 2]
    depths[[not link.collisions for link in model.links]] = 0.0
    name, depth = model.links[depths.argmax()].name, depths.max()
    if depth > MIN_BURIED_M:
        yield f"it swings: the centre of mass of {name!r} is {depth:.2g} m below the ground"


def _list_loose_joints(case: _Case) -> list[str]:
    """List the joints that carry supports about level axes, without motor or spring."""
    joints = (case.model.joints[i] for i in case.friction.rest.free)
    return [one.name for one in joints if one.kind != "prismatic" and not one.spring_stiffness]


def _carry_wheels(model: Model, names: Sequence[str]) -> bool:
    """Whether a joint with one of these names is above a joint that turns without limits."""
    wheels = filter(turns_freely, model.joints)
    return any(name in names for wheel in wheels for name in list_joints_above(model, wheel))


def _name_some(names: Sequence[str]) -> str:
    named = ", ".join(map(repr, names[:MAX_NAMED]))
    more = len(names) - MAX_NAMED
    return f"{named} and {more} more" if more > 0 else named


def _list_idle_wheels(model: Model, ground: GroundMotion) -> list[str]:
    """List the driven wheels, by joint, that do not carry, with their heights over the ground."""
    least = NO_LOAD_SHARE * float(ground.rest.loads.sum())
    loads = dict.fromkeys(_driven_wheels(model), 0.0)
    for one in ground.contacts:
        joint = model.joints[one.link - 1].name if one.link else ""
        if joint in loads:
            loads[joint] += one.load_n
    clearances = {
        model.joints[link - 1].name: height
        for link, height in ground.rest.clearances.items()
        if link and height > MIN_CLEARANCE_M
    }
    return [
        f"{joint!r} (it ends {1e3 * clearances[joint]:.2g} mm above the ground)"
        if joint in clearances
        else repr(joint)
        for joint, load in sorted(loads.items())
        if load < least
    ]


def _driven_wheels(model: Model) -> set[str]:
    return _driven_joints(model).intersection(model.drive.wheel_joints if model.drive else ())


@dataclass(frozen=True)
class _Case:
    """A model, and its friction for questions of what if."""

    model: Model
    friction: GroundFriction

    def move(
        self, command: PlanarTwist[float], *, smooth: Iterable[int] = (), is_strong: bool = False
    ) -> PlanarTwist[float]:
        """Find the twist with some links smooth, or with motors of any torque."""
        targets = make_joint_targets(self.model, find_drive_targets(self.model, command))
        if is_strong:
            targets = replace(targets, efforts=dict.fromkeys(targets.efforts, math.inf))
        return self.friction.move(targets, smooth=frozenset(smooth)).twist


def _describe_motions(
    case: _Case, straight: PredictedMotion, turn: PredictedMotion
) -> Iterator[str]:
    speed = _ratio(straight.twist[0], straight.nominal[0])
    rate = _ratio(turn.twist[2], turn.nominal[2])
    is_fast, is_slow = abs(speed - 1.0) > TOLERANCE, abs(rate - 1.0) > TOLERANCE
    if is_fast and is_slow and abs(speed - rate) < SAME_RATIO:
        yield f"{_say(speed, 'drives and turns', 'speed')}: {_find_cause(case, straight, 0)}"
    else:
        if is_fast:
            yield f"{_say(speed, 'drives', 'speed')}: {_find_cause(case, straight, 0)}"
        if is_slow:
            yield f"{_say(rate, 'turns', 'rate')}: {_find_cause(case, turn, 2)}"
    drift = straight.twist[2]
    if abs(drift) > DRIFT_RAD_S and abs(speed) > STANDS_SHARE:
        radius = abs(straight.twist[0] / drift)
        yield (
            f"it drives a circle of radius {radius:.2g} m when it is commanded straight: "
            f"{_find_cause(case, straight, 2)}"
        )


def _describe_reversed(model: Model) -> str:
    """Describe wheels that roll backward at positive speed, where the drive does not know it."""
    if not isinstance(model.drive, DiffDrive):
        return ""
    pairs, joints = model.drive.pairs, {joint.name: joint for joint in model.joints}
    poses = find_link_poses(model.links[0].name, model.joints)

    def rolls_backward(name: str) -> bool:
        joint = joints[name]
        return rotate(poses[joint.child].orientation, joint.axis)[1] < MAX_BACKWARD_AXIS_Y

    left = [p.left_joint for p in pairs if rolls_backward(p.left_joint) != p.is_left_reversed]
    right = [p.right_joint for p in pairs if rolls_backward(p.right_joint) != p.is_right_reversed]
    wrong = [*left, *right]
    if not wrong:
        return ""
    axis = " ".join(f"{0.0 - part:g}" for part in joints[wrong[0]].axis)
    named = ", ".join(map(repr, wrong))
    if len(left) == len(right) == len(pairs):
        return f"it drives backward, as {named} are reversed; use axis {axis} for each"
    verb = "is" if len(wrong) == 1 else "are"
    return f"it turns when told to go straight, as {named} {verb} reversed; use axis {axis}"


def _ratio(found: float, nominal: float) -> float:
    return found / nominal if nominal else 1.0


def _say(ratio: float, verb: str, what: str) -> str:
    if abs(ratio) < STANDS_SHARE:
        stays = {"drives": "does not drive", "turns": "does not turn on the spot"}
        return f"it {stays.get(verb, 'does not move')}"
    return f"it {verb} at about {ratio:.2f} of the commanded {what}"


def _find_cause(case: _Case, motion: PredictedMotion, column: int) -> str:
    """Name what makes a component of a motion deviate."""
    nominal, ground = motion.nominal[column], motion.ground
    missing = abs(motion.twist[column] - nominal)

    def explains(twist: PlanarTwist[float]) -> bool:
        return abs(twist[column] - nominal) < missing / 2.0

    if explains(case.move(motion.command, is_strong=True)):
        return "its motors are too weak for the friction"
    dragged = _list_dragged(ground)
    if dragged and explains(case.move(motion.command, smooth=dragged)):
        return _describe_dragged(case.model, ground)
    share = _ratio(motion.twist[column], nominal)
    return (
        _describe_steering_limits(case.model, motion)
        or _describe_sizes(case.model, ground, column)
        or _describe_wheelbase(case.model, column)
        or _describe_axles(case.model, ground, share)
        or "friction of its wheels holds it"
    )


def _list_dragged(ground: GroundMotion) -> set[int]:
    """List the links that touch the ground and are no wheels."""
    return {one.link for one in ground.contacts if one.wheel < 0 and max(one.friction) > 0.0}


def _describe_dragged(model: Model, ground: GroundMotion) -> str:
    links, weight = _list_dragged(ground), sum(one.load_n for one in ground.contacts)
    dragged = [one for one in ground.contacts if one.link in links]
    if not dragged:
        return ""
    worst = max(dragged, key=lambda one: one.load_n * max(one.friction))
    name = model.links[worst.link].name
    x, y = worst.place
    cure = _describe_blocked_wheel(model, worst.link) or "lower it (mu1, mu2)"
    return (
        f"friction {max(worst.friction):.3g} of {name!r} at x {x:.2f}, y {y:.2f} m under "
        f"{100.0 * worst.load_n / weight:.0f} % of the weight; {cure}"
    )


def _describe_blocked_wheel(model: Model, link: int) -> str:
    """Describe the joint of a wheel that its limits keep from turning."""
    joint = model.joints[link - 1] if link else None
    if joint is None or joint.kind != "revolute" or joint.lower > joint.upper:
        return ""
    if joint.upper - joint.lower > MAX_BLOCKED_RAD:
        return ""
    return (
        f"its joint {joint.name!r} cannot turn, between the limits {joint.lower:.3g} and "
        f"{joint.upper:.3g} rad"
    )


def _describe_steering_limits(model: Model, motion: PredictedMotion) -> str:
    """Describe a steering joint that its limits keep from the angle of a command."""
    steering = model.drive.steering_joints if model.drive else ()
    if not steering:
        return ""
    joints = {joint.name: joint for joint in model.joints}
    targets = find_drive_targets(model, motion.command)
    for actuator, wanted in zip(model.drive_actuators, targets, strict=True):
        if actuator.mode != "position" or actuator.joint not in steering:
            continue
        if (found := limit_position(joints[actuator.joint], wanted)) != wanted:
            return (
                f"the limits of its steering joint {actuator.joint!r} end at {found:.3g} rad, "
                f"and this turn takes {wanted:.3g} rad"
            )
    return ""


def _describe_sizes(model: Model, ground: GroundMotion, column: int) -> str:
    """Name wheels whose sizes are not those of the drive."""
    drive = model.drive
    if not isinstance(drive, DiffDrive):
        return ""
    by_joint = {model.joints[one.wheel].name: one for one in ground.contacts if one.wheel >= 0}
    for pair in drive.pairs:
        left, right = by_joint.get(pair.left_joint), by_joint.get(pair.right_joint)
        if left is None or right is None:
            continue
        for one in (left, right):
            if _differs(2.0 * one.radius_m, pair.diameter_m):
                return (
                    f"its wheels measure {2.0 * one.radius_m:.3g} m, the drive's wheel_diameter "
                    f"is {pair.diameter_m:.3g} m"
                )
        if left.place[1] < right.place[1]:
            return (
                f"{pair.left_joint!r}, its left wheel, is on the right; swap left and right joints"
            )
        track = math.dist(left.place, right.place)
        if column and _differs(track, pair.separation_m):
            return (
                f"its wheels are {track:.3g} m apart, the drive's wheel_separation is "
                f"{pair.separation_m:.3g} m"
            )
    return ""


def _describe_wheelbase(model: Model, column: int) -> str:
    """Name a wheelbase that is not that of the links."""
    drive = model.drive
    if not isinstance(drive, SteeringDrive) or drive.is_traction_steered or column == 0:
        return ""
    unsteered, written = find_middle(model, drive.traction)[0], abs(drive.wheelbase_m)
    apart = abs(find_middle(model, drive.steering)[0] - unsteered)
    if not _differs(apart, written):
        return ""
    return f"its axles are {apart:.3g} m apart, the drive's wheelbase is {written:.3g} m"


def _differs(measured: float, written: float) -> bool:
    return abs(measured - written) > TOLERANCE / 2.0 * written


def _describe_axles(model: Model, ground: GroundMotion, share: float) -> str:
    """Describe skid steering: unsteered wheels on several axles, and what corrects the turn."""
    wheels = [one for one in ground.contacts if one.wheel >= 0 and not one.is_trailing]
    if not _are_apart(wheels):
        return ""
    driven = [one for one in wheels if model.joints[one.wheel].name in _driven_joints(model)]
    cause = "skid steering" if _are_apart(driven) else "wheels on a second axle do not steer"
    drive = model.drive
    if not isinstance(drive, DiffDrive) or share < STANDS_SHARE:
        return cause
    separation = drive.pairs[0].separation_m / share
    return (
        f"{cause}; set wheel_separation_multiplier {1.0 / share:.3g}, or wheel_separation "
        f"{separation:.3g} m"
    )


def _driven_joints(model: Model) -> set[str]:
    return {actuator.joint for actuator in model.actuators if actuator.mode == "velocity"}


def _are_apart(wheels: list[GroundContact]) -> bool:
    if not wheels:
        return False
    ahead, aside = zip(*(one.place for one in wheels), strict=True)
    return bool(max(ahead) - min(ahead) > AXLE_SHARE * (max(aside) - min(aside)))
