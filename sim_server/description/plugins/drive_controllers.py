"""Drive controllers of ros2_controllers and ros_control: parameters and the drive they give.

Source: parameter files of ros2_controllers (Humble to Rolling) and ros_controllers (Noetic).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import (
    PAIR_SIZE,
    DiffDrive,
    Limits,
    OmniDrive,
    RollerWheel,
    SteeringDrive,
    WheelPair,
)
from zensim.sim_server.description.plugins.diff_drive_plugins import (
    find_pair_faults,
    summarize_pairs,
)
from zensim.sim_server.description.plugins.drive_plugin import (
    FLAG,
    NUMBER,
    SUBSTITUTION,
    DriveParameter,
    DrivePlugin,
    UnusableDrive,
    read_frame,
)
from zensim.sim_server.description.plugins.wheel_guess import MIN_OMNI_WHEELS, find_wheels
from zensim.sim_server.description.plugins.wheel_measures import (
    MeasuredWheel,
    check_lengths,
    check_sides,
    check_wheel_joints,
    find_diameter_faults,
    find_distance_faults,
    find_grip_torque,
    measure_separation,
    measure_wheels,
)
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

    ChooseLength = Callable[[str, float], float]

DEFAULT_RATE_HZ = 50.0
DIAGONAL = 6
MIN_LENGTH_M = 1e-3
MECANUM_WHEELS = ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")
MECANUM_LEFT = (-1.0, 1.0, 1.0, -1.0)
"""Direction of each of `MECANUM_WHEELS` by vy."""
_TIMEOUT = "the agent has its own timeout"
_JERK = "jerk is not limited"
_FEEDBACK = "odometry is from the positions of the wheels, or true"
UNUSED = {
    "cmd_vel_timeout": _TIMEOUT,
    "reference_timeout": _TIMEOUT,
    "use_stamped_vel": "cmd_vel may be stamped or not",
    "open_loop": _FEEDBACK,
    "position_feedback": _FEEDBACK,
    "wheels_per_side": "the names of the wheels say their number",
    "velocity_rolling_window_size": "velocities are not averaged",
    "use_sim_time": "robots have the time of the simulation",
    "tf_frame_prefix": "frames have the prefix of the robot's namespace",
    "tf_frame_prefix_enable": "frames have the prefix of the robot's namespace",
    "allow_multiple_cmd_vel_publishers": "the newest command is used",
    "preserve_turning_radius": "each velocity has its own limit",
    "interface_name": "wheels have commanded speeds",
    "command_joint_names": "the other names are used",
    "reduce_wheel_speed_until_steering_reached": "wheels do not wait for the steering",
    "odom_only_twist": "odometry has pose and twist",
    "k_l": "not used",
    "k_r": "not used",
    **dict.fromkeys(
        (
            "publish_limited_velocity", "publish_cmd", "publish_wheel_data",
            "publish_wheel_joint_controller_state", "publish_ackermann_command",
        ),
        "not published",
    ),
    **dict.fromkeys(
        (
            "traction_joints_state_names", "steering_joints_state_names",
            *(f"{place}_state_joint_name" for place in MECANUM_WHEELS),
        ),
        "states are of the commanded joints",
    ),
    **{
        f"{axis}.{name}": _JERK
        for axis in ("linear.x", "linear.y", "angular.z", "traction", "steering")
        for name in ("has_jerk_limits", "min_jerk", "max_jerk")
    },
    **dict.fromkeys(
        (
            *(f"traction.{name}_{what}" for name in ("min", "max") for what in (
                "acceleration", "deceleration")),
            *(f"steering.{name}_{what}" for name in ("min", "max") for what in (
                "acceleration", "velocity")),
            "traction.min_velocity", "steering.min_position",
        ),
        "not limited",
    ),
}  # fmt: skip
RADIUS, WHEELBASE = "traction_wheels_radius", "wheelbase"
TRACTION_TRACK, STEERING_TRACK = "traction_track_width", "steering_track_width"


def _read_diagonal(tags: PluginTags, tag: str, default: tuple[float, ...]) -> tuple[float, ...]:
    values = tuple(tags.numbers(tag))
    if len(values) == DIAGONAL and min(values) >= 0.0:
        return values
    if values:
        tags.report.suspicious(tags.label(tag), f"not {DIAGONAL} numbers >= 0; not used")
    return default


COMMON = (
    DriveParameter("update_rate", NUMBER, "update_rate_hz"),
    DriveParameter("publish_rate", NUMBER, "odometry_rate_hz"),
    DriveParameter("odom_frame_id", read_frame, "odometry_frame"),
    DriveParameter("base_frame_id", read_frame, "robot_base_frame"),
    DriveParameter("enable_odom_tf", FLAG, "publish_odom_tf"),
    DriveParameter("pose_covariance_diagonal", _read_diagonal, "pose_covariance"),
    DriveParameter("twist_covariance_diagonal", _read_diagonal, "twist_covariance"),
)
ALIASES = {
    "diagonal_covariance.pose": "pose_covariance_diagonal",
    "diagonal_covariance.twist": "twist_covariance_diagonal",
    "open_loop_": "open_loop",
}
SETTINGS = {
    "odometry_rate_hz": DEFAULT_RATE_HZ,
    "robot_base_frame": "base_link",
    "publish_odom": True,
    "publish_odom_tf": True,
}
"""Defaults of all these controllers."""


def resolve_joint(tags: PluginTags, text: str, lumped: LumpedModel) -> str:
    """Find the joint of a name; one with an argument of a launch file is found by its end."""
    ending = SUBSTITUTION.sub("", text)
    if ending == text:
        return text
    found = [joint.name for joint in lumped.joints if joint.name.endswith(ending)]
    if len(found) != 1:
        raise UnusableDrive(f"{text[:80]!r} has an argument of a launch file; write the joint")
    tags.report.suspicious(tags.subject, f"{text[:80]!r} is read as {found[0]!r}")
    return found[0]


def _read_joints(tags: PluginTags, tag: str, lumped: LumpedModel) -> list[str]:
    return [resolve_joint(tags, text, lumped) for text in tags.texts(tag) if text]


def _choose_length(tags: PluginTags, tag: str, measured: float, what: str) -> float:
    """Read a length [m]; where it is missing or 0, it is measured from the links."""
    written = [number for number in tags.numbers(tag)[:1] if number != 0.0]
    if not written:
        if measured < MIN_LENGTH_M:
            raise UnusableDrive(f"{tag} is missing, and the {what} cannot be measured; write it")
        tags.report.applied(tags.label(tag), f"measured from the links: {measured:g} m")
        return measured
    check_lengths(tags, tag, written)
    return written[0]


def _multiply(tags: PluginTags, *names: str) -> float:
    """Read multipliers, and average them."""
    factors = [(tags.numbers(name) or [1.0])[0] for name in names]
    if min(factors) <= 0.0:
        raise ModelError(
            f"{tags.subject}: a multiplier is not positive; write a number > 0",
            slug="drive.multiplier",
        )
    if len(set(factors)) > 1:
        tags.report.suspicious(tags.subject, f"{' and '.join(names)} differ; their mean is used")
    return sum(factors) / len(factors)


def _read_limits(tags: PluginTags, axis: str) -> Limits:
    """Read limits; `has_*_limits` of older releases switch them, NaN of newer ones."""

    def signed(name: str) -> float | None:
        return tags.signed(f"{axis}.{name}")

    lowest, highest = signed("min_velocity"), signed("max_velocity")
    slower = [signed(n) for n in ("min_acceleration", "max_acceleration_reverse")]
    faster, brake = signed("max_acceleration"), signed("max_deceleration")
    down = next((one for one in (*slower, brake) if one is not None), None)
    if brake is not None and faster is not None and abs(brake) != abs(faster):
        tags.report.suspicious(
            tags.label(f"{axis}.max_deceleration"), "braking has the limit of speeding up"
        )
    signed("max_deceleration_reverse")  # as that of the other direction
    has_speed = tags.flag(f"{axis}.has_velocity_limits", default=True)
    has_pull = tags.flag(f"{axis}.has_acceleration_limits", default=True)
    speeds = _mirror(lowest, highest) if has_speed else (None, None)
    pulls = _mirror(down, faster) if has_pull else (None, None)
    return Limits(*speeds, *pulls)


def _mirror(lowest: float | None, highest: float | None) -> tuple[float | None, float | None]:
    """Make both bounds of one, as the controllers do: a bound is at 0 or beyond."""
    if highest is None:
        highest = None if lowest is None else -lowest
    if lowest is None:
        lowest = None if highest is None else -highest
    return (None if lowest is None else -abs(lowest), None if highest is None else abs(highest))


def _make_diff(*_: object) -> DiffDrive:
    return DiffDrive(odometry_source="encoder", **SETTINGS)  # type: ignore[arg-type]


def _read_diff(drive: DiffDrive, tags: PluginTags, lumped: LumpedModel) -> DiffDrive:
    left = _read_joints(tags, "left_wheel_names", lumped)
    right = _read_joints(tags, "right_wheel_names", lumped)
    check_sides(left, right)
    check_wheel_joints((*left, *right), lumped)
    lefts, rights = measure_wheels(left, lumped), measure_wheels(right, lumped)
    apart = _choose_length(
        tags, "wheel_separation", measure_separation(lefts[0], rights[0]), "distance of the wheels"
    )
    radius = _choose_length(tags, "wheel_radius", lefts[0].radius_m, "radius of the wheels")
    # Multipliers differ from the links on purpose.
    for names in zip(left, right, strict=True):
        nominal = DiffDrive(pairs=(WheelPair(*names, apart, 2.0 * radius),))
        for fault in find_pair_faults(nominal, lumped):
            tags.report.suspicious(tags.subject, fault)
    separation = apart * _multiply(tags, "wheel_separation_multiplier")
    radius *= _multiply(tags, "left_wheel_radius_multiplier", "right_wheel_radius_multiplier")
    radius *= _multiply(tags, "wheel_radius_multiplier")
    pairs = tuple(
        WheelPair(*names, separation, 2.0 * radius) for names in zip(left, right, strict=True)
    )
    return msgspec.structs.replace(
        drive,
        pairs=pairs,
        max_torque_nm=find_grip_torque(
            lumped, radius_m=radius, wheels=len(left), joints=(*left, *right)
        ),
        linear_limits=_read_limits(tags, "linear.x"),
        angular_limits=_read_limits(tags, "angular.z"),
    )


def make_mecanum_wheels(
    joints: Sequence[str], *, radius_m: float, reach_m: float
) -> tuple[RollerWheel, ...]:
    """Make mecanum wheels: front left, front right, rear left, rear right.

    Args:
        joints: In this order.
        radius_m: Of the wheels.
        reach_m: Half the distance of the axles plus half that of the sides.
    """
    turns = (-reach_m, reach_m, -reach_m, reach_m)
    return tuple(
        RollerWheel(joint, 1.0 / radius_m, left / radius_m, turn / radius_m)
        for joint, left, turn in zip(joints, MECANUM_LEFT, turns, strict=True)
    )


def measure_reach(wheels: Sequence[MeasuredWheel]) -> tuple[float, float]:
    """Measure the distances [m] of the axles and of the sides of four wheels."""
    front_left, front_right, rear_left, _ = (wheel.centre for wheel in wheels)
    return abs(front_left[0] - rear_left[0]), abs(front_left[1] - front_right[1])


def _make_omni(*_: object) -> OmniDrive:
    return OmniDrive(**SETTINGS)  # type: ignore[arg-type]


def _read_mecanum(drive: OmniDrive, tags: PluginTags, lumped: LumpedModel) -> OmniDrive:
    joints = [name for place in MECANUM_WHEELS for name in _read_joints(tags, place, lumped)[:1]]
    if len(joints) != len(MECANUM_WHEELS):
        raise UnusableDrive(f"{len(joints)} wheels; name front and rear, left and right")
    check_wheel_joints(joints, lumped)
    wheels = measure_wheels(joints, lumped)
    radius = _choose_length(tags, "wheel_radius", wheels[0].radius_m, "radius of the wheels")
    radius *= _multiply(tags, "wheel_radius_multiplier")
    length, width = measure_reach(wheels)
    if tags.has("kinematics.sum_of_robot_center_projection_on_X_Y_axis"):
        reach = _choose_length(
            tags, "kinematics.sum_of_robot_center_projection_on_X_Y_axis", 0.0, "distance"
        )
    else:
        length = _choose_length(tags, "wheel_separation_x", length, "distance of the axles")
        width = _choose_length(tags, "wheel_separation_y", width, "distance of the wheels")
        reach = (length * _multiply(tags, "wheel_separation_x_multiplier")) / 2.0
        reach += (width * _multiply(tags, "wheel_separation_y_multiplier")) / 2.0
    reach *= _multiply(tags, "wheel_separation_multiplier")
    return _complete_omni(
        drive, make_mecanum_wheels(joints, radius_m=radius, reach_m=reach), tags, lumped
    )


def _complete_omni(
    drive: OmniDrive, wheels: tuple[RollerWheel, ...], tags: PluginTags, lumped: LumpedModel
) -> OmniDrive:
    return with_wheels(
        msgspec.structs.replace(
            drive,
            linear_limits=_read_limits(tags, "linear.x"),
            lateral_limits=_read_limits(tags, "linear.y"),
            angular_limits=_read_limits(tags, "angular.z"),
        ),
        wheels,
        lumped,
    )


def with_wheels(
    drive: OmniDrive, wheels: tuple[RollerWheel, ...], lumped: LumpedModel
) -> OmniDrive:
    """Set the wheels of a drive, and their torque."""
    joints = [wheel.joint for wheel in wheels]
    radius = max((wheel.radius_m for wheel in measure_wheels(joints, lumped)), default=0.0)
    torque = find_grip_torque(
        lumped, radius_m=radius or MIN_LENGTH_M, wheels=len(joints), joints=joints
    )
    return msgspec.structs.replace(drive, wheels=wheels, max_torque_nm=torque)


def _read_omni(drive: OmniDrive, tags: PluginTags, lumped: LumpedModel) -> OmniDrive:
    joints = _read_joints(tags, "wheel_names", lumped)
    if len(joints) < MIN_OMNI_WHEELS:
        raise UnusableDrive(f"{len(joints)} wheels; name {MIN_OMNI_WHEELS} or more")
    check_wheel_joints(joints, lumped)
    measured = measure_wheels(joints, lumped)
    first = measured[0]
    radius = _choose_length(tags, "wheel_radius", first.radius_m, "radius of the wheels")
    robot = _choose_length(
        tags, "robot_radius", math.hypot(*first.centre[:2]), "distance of the wheels"
    )
    offset = (tags.numbers("wheel_offset") or [math.atan2(first.centre[1], first.centre[0])])[0]
    wheels = tuple(
        RollerWheel(
            joint,
            math.sin(offset + 2.0 * math.pi * place / len(joints)) / radius,
            -math.cos(offset + 2.0 * math.pi * place / len(joints)) / radius,
            -robot / radius,
        )
        for place, joint in enumerate(joints)
    )
    return _complete_omni(drive, wheels, tags, lumped)


def summarize_omni(drive: OmniDrive) -> str:
    """Describe the drive in one line."""
    return (
        f"{', '.join(drive.wheel_joints)} turn as commanded, and the twist is applied to the body, "
        "sideways too"
    )


def _make_steering(*_: object) -> SteeringDrive:
    return SteeringDrive(odometry_source="encoder", **SETTINGS)  # type: ignore[arg-type]


def _make_tricycle(*_: object) -> SteeringDrive:
    return msgspec.structs.replace(_make_steering(), publish_odom_tf=False)


def _read_steering(drive: SteeringDrive, tags: PluginTags, lumped: LumpedModel) -> SteeringDrive:
    rear, front = _read_joints(tags, "rear", lumped), _read_joints(tags, "front", lumped)
    if not tags.flag("front_steering", default=True):
        rear, front = front, rear
    traction = _read_joints(tags, "traction_joints_names", lumped) or rear
    steering = _read_joints(tags, "steering_joints_names", lumped) or front
    traction = _replace_virtual(traction, tags, lumped)
    steering = _replace_virtual(steering, tags, lumped)
    return complete_steering(drive, traction, steering, lumped=lumped, choose=_choose_by_tags(tags))


def _read_four_wheel(drive: SteeringDrive, tags: PluginTags, lumped: LumpedModel) -> SteeringDrive:
    names = [
        _read_joints(tags, tag, lumped)
        for tag in ("front_wheel", "rear_wheel", "front_steering", "rear_steering")
    ]
    factors = {
        RADIUS: _multiply(tags, "wheel_radius_multiplier"),
        TRACTION_TRACK: _multiply(tags, "wheel_separation_multiplier"),
    }
    offset = (tags.numbers("wheel_steering_y_offset") or [0.0])[0]

    def choose(name: str, measured: float) -> float:
        if name == STEERING_TRACK and tags.has("wheel_steering_y_offset"):
            return max(choose(TRACTION_TRACK, 0.0) - 2.0 * offset, MIN_LENGTH_M)
        return _choose_by_tags(tags)(name, measured) * factors.get(name, 1.0)

    return complete_two_axles(drive, names[:2], names[2:], lumped=lumped, choose=choose)


def _read_tricycle(drive: SteeringDrive, tags: PluginTags, lumped: LumpedModel) -> SteeringDrive:
    traction = _read_joints(tags, "traction_joint_name", lumped)
    steering = _read_joints(tags, "steering_joint_name", lumped)
    found = complete_steering(
        msgspec.structs.replace(drive, is_traction_steered=True),
        traction,
        steering,
        lumped=lumped,
        choose=_choose_by_tags(tags),
    )
    fastest, widest = tags.signed("traction.max_velocity"), tags.signed("steering.max_position")
    return msgspec.structs.replace(
        found,
        # Of the rim speed as that controller compares it: in rad/s of the wheel.
        max_speed=found.max_speed if fastest is None else abs(fastest) * found.wheel_radius_m,
        max_steer=found.max_steer if widest is None else min(abs(widest), found.max_steer),
    )


def _replace_virtual(names: Sequence[str], tags: PluginTags, lumped: LumpedModel) -> list[str]:
    """Replace a joint that moves nothing but joints that mimic it by these joints."""
    touching = {link.name for link in lumped.links if link.collisions}
    parents = {joint.parent for joint in lumped.joints}
    found: list[str] = []
    for name in names:
        leader = next((joint for joint in lumped.joints if joint.name == name), None)
        followers = [
            joint.name for joint in lumped.joints if joint.mimic and joint.mimic.joint == name
        ]
        is_bare = leader is not None and leader.child not in {*touching, *parents}
        if is_bare and followers:
            named = " and ".join(map(repr, followers))
            tags.report.applied(
                tags.subject, f"{name!r} moves no collision: {named}, which mimic it, are driven"
            )
        found += followers if is_bare and followers else [name]
    return found


def _choose_by_tags(tags: PluginTags) -> ChooseLength:
    def choose(name: str, measured: float) -> float:
        return _choose_length(tags, name, measured, name.replace("_", " "))

    return choose


def complete_steering(
    drive: SteeringDrive,
    traction: Sequence[str],
    steering: Sequence[str],
    *,
    lumped: LumpedModel,
    choose: ChooseLength,
) -> SteeringDrive:
    """Set joints and lengths of a steered vehicle.

    Args:
        drive: Has the other settings.
        traction: Joints of driven wheels.
        steering: Steering joints.
        lumped: The robot.
        choose: Chooses a length by its name and its measured value, 0 if that is unknown.

    Raises:
        UnusableDrive: The joints do not fit, or a length is neither written nor measurable.
    """
    _check_counts(traction, steering)
    check_wheel_joints((*traction, *steering), lumped)
    driven = _sort_sides(measure_wheels(traction, lumped))
    turned = _sort_sides(measure_wheels(steering, lumped))
    others = _list_passive(lumped, (*traction, *steering))
    axle = others if drive.is_traction_steered else driven
    apart = _mean_x(turned) - _mean_x(axle) if axle else 0.0
    wheelbase = choose(WHEELBASE, abs(apart))
    measured = msgspec.structs.replace(
        drive,
        traction=tuple(wheel.joint for wheel in driven),
        steering=tuple(wheel.joint for wheel in turned),
        passive=tuple(wheel.joint for wheel in others),
        wheel_radius_m=choose(RADIUS, driven[0].radius_m),
        wheelbase_m=math.copysign(wheelbase, apart) if apart else wheelbase,
        traction_track_m=_choose_track(TRACTION_TRACK, driven, choose) or drive.traction_track_m,
        steering_track_m=_choose_track(STEERING_TRACK, turned, choose) or drive.steering_track_m,
        odometry_source="encoder" if len(driven) == PAIR_SIZE else "world",
    )
    return _limit_steering(measured, lumped)


def _list_passive(lumped: LumpedModel, moved: Sequence[str]) -> list[MeasuredWheel]:
    """List the wheels that roll along; a virtual one without a collision does not."""
    return [one for one in find_wheels(lumped) if one.joint not in moved and one.has_collision]


def complete_two_axles(
    drive: SteeringDrive,
    wheels: Sequence[Sequence[str]],
    steering: Sequence[Sequence[str]],
    *,
    lumped: LumpedModel,
    choose: ChooseLength,
) -> SteeringDrive:
    """Set joints and lengths of a vehicle with four driven wheels, two axles of which steer.

    Args:
        drive: Has the other settings.
        wheels: Joints of the wheels of each axle.
        steering: Steering joints of each axle.
        lumped: The robot.
        choose: As in `complete_steering`.

    Raises:
        UnusableDrive: The joints do not fit, or a length is neither written nor measurable.
    """
    if any(len(names) != PAIR_SIZE for names in (*wheels, *steering)):
        raise UnusableDrive("name two wheels and two steering joints for each of two axles")
    check_wheel_joints((name for names in (*wheels, *steering) for name in names), lumped)
    front, rear = (_sort_sides(measure_wheels(names, lumped)) for names in wheels)
    ahead, behind = (_sort_sides(measure_wheels(names, lumped)) for names in steering)
    apart = _mean_x(front) - _mean_x(rear)
    measured = msgspec.structs.replace(
        drive,
        traction=tuple(wheel.joint for wheel in (*front, *rear)),
        steering=tuple(wheel.joint for wheel in ahead),
        counter_steering=tuple(wheel.joint for wheel in behind),
        wheel_radius_m=choose(RADIUS, front[0].radius_m),
        wheelbase_m=math.copysign(choose(WHEELBASE, abs(apart)) / 2.0, apart),
        traction_track_m=_choose_track(TRACTION_TRACK, front, choose),
        steering_track_m=_choose_track(STEERING_TRACK, ahead, choose),
        odometry_source="world",
    )
    return _limit_steering(measured, lumped)


def _check_counts(traction: Sequence[str], steering: Sequence[str]) -> None:
    for names, what in ((traction, "driven wheels"), (steering, "steering joints")):
        if not 1 <= len(names) <= PAIR_SIZE:
            raise UnusableDrive(f"{len(names)} {what}; name one or two")


def _choose_track(name: str, wheels: Sequence[MeasuredWheel], choose: ChooseLength) -> float:
    if len(wheels) < PAIR_SIZE:
        return 0.0
    return choose(name, abs(wheels[0].centre[1] - wheels[1].centre[1]))


def _limit_steering(drive: SteeringDrive, lumped: LumpedModel) -> SteeringDrive:
    """Set the torques, and the largest angle of the joints."""
    radius = drive.wheel_radius_m
    joints = [joint for joint in lumped.joints if joint.name in drive.steering_joints]
    limits = [max(abs(one.lower), abs(one.upper)) for one in joints if one.kind == "revolute"]
    return msgspec.structs.replace(
        drive,
        max_steer=min((drive.max_steer, *(limit for limit in limits if limit > 0.0))),
        wheel_effort_nm=find_grip_torque(
            lumped, radius_m=radius, wheels=len(drive.traction), joints=drive.traction
        ),
        steering_effort_nm=find_grip_torque(
            lumped, radius_m=radius, wheels=1, joints=drive.steering_joints
        ),
    )


def _sort_sides(wheels: list[MeasuredWheel]) -> list[MeasuredWheel]:
    return sorted(wheels, key=lambda wheel: -wheel.centre[1])


def _mean_x(wheels: Sequence[MeasuredWheel]) -> float:
    return sum(wheel.centre[0] for wheel in wheels) / len(wheels)


def summarize_steering(drive: SteeringDrive) -> str:
    """Describe the drive in one line."""
    return (
        f"{' and '.join(drive.traction)} driven, {' and '.join(drive.steering_joints)} steered, "
        f"wheelbase {drive.wheelbase_m:g} m, wheel radius {drive.wheel_radius_m:g} m"
    )


def find_steering_faults(drive: SteeringDrive, lumped: LumpedModel) -> list[str]:
    """Compare the wheels with the links."""
    driven = measure_wheels(drive.traction, lumped)
    faults = find_diameter_faults(
        f"twice {RADIUS}", 2.0 * drive.wheel_radius_m, [w for w in driven if w.radius_m]
    )
    if len(driven) == PAIR_SIZE:
        faults += find_distance_faults(TRACTION_TRACK, drive.traction_track_m, *driven)
    carriers = {joint.parent for joint in lumped.joints}
    stiff = [
        wheel.joint
        for wheel in measure_wheels(drive.steering_joints, lumped)
        if wheel.has_collision
        and wheel.joint in {joint.name for joint in lumped.joints if joint.child not in carriers}
    ]
    if stiff:
        faults.append(
            f"{', '.join(map(repr, stiff))} steer wheels without an axle: they do not roll but drag"
        )
    return faults


_STEERING_ALIASES = ALIASES | {
    "rear_wheels_names": "rear",
    "rear_wheel_name": "rear",
    "rear_wheel": "rear",
    "front_wheels_names": "front",
    "front_steer": "front",
    "front_wheel_name": "front",
    "rear_wheels_radius": RADIUS,
    "rear_wheel_radius": RADIUS,
    "traction_wheel_radius": RADIUS,
    "wheel_radius": RADIUS,
    "rear_wheel_track": TRACTION_TRACK,
    "wheel_track": TRACTION_TRACK,
    "front_wheel_track": STEERING_TRACK,
    "wheel_separation_h": WHEELBASE,
}
_STEERING_UNUSED = UNUSED | {
    "front_wheels_radius": "the front wheels turn passively",
    "front_wheel_radius": "the front wheel turns passively",
}

DRIVE_CONTROLLERS = (
    DrivePlugin(
        filenames=("diff_drive_controller/DiffDriveController",),
        drive_type=DiffDrive,
        summarize=summarize_pairs,
        make=_make_diff,
        parameters=COMMON,
        complete=_read_diff,
        aliases=ALIASES | {"left_wheel": "left_wheel_names", "right_wheel": "right_wheel_names"},
        unused=UNUSED,
    ),
    DrivePlugin(
        # Clearpath has a copy of its own.
        filenames=("mecanum_drive_controller/MecanumDriveController",),
        drive_type=OmniDrive,
        summarize=summarize_omni,
        make=_make_omni,
        parameters=COMMON,
        complete=_read_mecanum,
        aliases=ALIASES
        | {
            "kinematics.wheels_radius": "wheel_radius",
            "wheel_separation_multiplier_x": "wheel_separation_x_multiplier",
            "wheel_separation_multiplier_y": "wheel_separation_y_multiplier",
            "back_left_wheel_joint": "rear_left_wheel",
            "back_right_wheel_joint": "rear_right_wheel",
        }
        | {
            f"{place}_{ending}": place
            for place in MECANUM_WHEELS
            for ending in ("joint", "name", "command_joint_name")
        },
        unused=UNUSED
        | {
            f"kinematics.base_frame_offset.{name}": "the twist is that of the root link"
            for name in ("x", "y", "theta")
        },
    ),
    DrivePlugin(
        filenames=("omni_wheel_drive_controller/OmniWheelDriveController",),
        drive_type=OmniDrive,
        summarize=summarize_omni,
        make=_make_omni,
        parameters=COMMON,
        complete=_read_omni,
        aliases=ALIASES,
        unused=UNUSED,
    ),
    DrivePlugin(
        filenames=("tricycle_controller/TricycleController",),
        drive_type=SteeringDrive,
        summarize=summarize_steering,
        make=_make_tricycle,
        parameters=COMMON,
        complete=_read_tricycle,
        find_faults=find_steering_faults,
        aliases=_STEERING_ALIASES,
        unused=_STEERING_UNUSED,
    ),
    DrivePlugin(
        filenames=(
            "ackermann_steering_controller/AckermannSteeringController",
            "bicycle_steering_controller/BicycleSteeringController",
            "tricycle_steering_controller/TricycleSteeringController",
        ),
        drive_type=SteeringDrive,
        summarize=summarize_steering,
        make=_make_steering,
        parameters=COMMON,
        complete=_read_steering,
        find_faults=find_steering_faults,
        aliases=_STEERING_ALIASES,
        unused=_STEERING_UNUSED,
    ),
    DrivePlugin(
        filenames=("four_wheel_steering_controller/FourWheelSteeringController",),
        drive_type=SteeringDrive,
        summarize=summarize_steering,
        make=_make_steering,
        parameters=COMMON,
        complete=_read_four_wheel,
        find_faults=find_steering_faults,
        aliases=ALIASES
        | {
            "wheel_separation_h": WHEELBASE,
            "wheel_separation_w": TRACTION_TRACK,
            "wheel_radius": RADIUS,
        },
        unused=UNUSED | {"enable_twist_cmd": "commands are twists"},
    ),
)
