"""Drive of a robot: ordered by the request, of its controllers, or of its plug-ins."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec

from zensim.proto.messages.drive_messages import (
    PAIR_SIZE,
    DiffDrive,
    Drive,
    DriveOrder,
    OmniDrive,
    PlanarMove,
    RollerWheel,
    SteeringDrive,
    WheelPair,
)
from zensim.proto.messages.model_messages import JointStatePublisher
from zensim.sim_server.description.plugins.drive_controllers import (
    DRIVE_CONTROLLERS,
    MECANUM_WHEELS,
    complete_steering,
    complete_two_axles,
    find_steering_faults,
    make_mecanum_wheels,
    measure_reach,
    with_wheels,
)
from zensim.sim_server.description.plugins.drive_plugin import DrivePlugin, UnusableDrive
from zensim.sim_server.description.plugins.joint_controllers import is_joint_controller
from zensim.sim_server.description.plugins.plugin_registry import summarize_drive
from zensim.sim_server.description.plugins.plugin_tags import PluginTags, WrittenTags
from zensim.sim_server.description.plugins.wheel_guess import MIN_OMNI_WHEELS
from zensim.sim_server.description.plugins.wheel_measures import (
    MeasuredWheel,
    check_wheel_joints,
    find_base_link,
    find_grip_torque,
    measure_separation,
    measure_wheels,
    rolls_backward,
)
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.controller_files import Controller
    from zensim.sim_server.description.report import ParseReport

SUBJECT = "drive"
MIN_LENGTH_M, MAX_LENGTH_M = 1e-6, 1e6
MIN_AXLE_LENGTH_M = 1e-3
TWO_AXLES = 8
"""Joints of an Ackermann drive that steers two axles: four wheels, four steering joints."""
JOINT_STATE_CONTROLLERS = (
    "joint_state_broadcaster/JointStateBroadcaster",
    "joint_state_controller/JointStateController",
)
DEFAULT_JOINT_STATE_HZ = 100.0


def select_drive(
    model: Model,
    lumped: LumpedModel,
    *,
    controllers: Sequence[str],
    order: DriveOrder,
    report: ParseReport,
) -> Model:
    """Give a model its drive; the one of its plug-ins is used where nothing else is given.

    Args:
        model: As its description has it.
        lumped: Its links and joints, with the corners of meshes.
        controllers: Texts of controllers' files.
        order: Of the request.
        report: Gets what is unusual.

    Raises:
        ModelError: The order does not fit the robot, or a file is not valid.
    """
    found = _read_controlled(model, lumped, controllers, report) if controllers else model
    if order.kind:
        drive = _make_ordered(order, lumped, report)
        found = msgspec.structs.replace(found, drive=drive)
    if model.drive is not None and found.drive is not model.drive:
        report.ignored(SUBJECT, "the plug-in's drive is replaced")
    return _release_followers(found, report)


def _release_followers(model: Model, report: ParseReport) -> Model:
    """Let joints that the drive moves follow no other joint: a motor and a gear would fight."""
    driven = {one.joint for one in model.drive.actuators} if model.drive else set()
    followers = [one.name for one in model.joints if one.mimic and one.name in driven]
    if not followers:
        return model
    report.applied(SUBJECT, f"<mimic> of {', '.join(map(repr, followers))} gives way to the drive")
    joints = tuple(
        msgspec.structs.replace(one, mimic=None) if one.name in followers else one
        for one in model.joints
    )
    return msgspec.structs.replace(model, joints=joints)


def _read_controlled(
    model: Model, lumped: LumpedModel, files: Sequence[str], report: ParseReport
) -> Model:
    # Most robots have no such file, and yaml takes a while to import.
    from zensim.sim_server.description.plugins.controller_files import read_controllers

    drive: Drive | None = None
    publisher = model.joint_state
    for controller in read_controllers(files):
        kind = controller.type
        fitting = (one for one in DRIVE_CONTROLLERS if any(name in kind for name in one.filenames))
        plugin = next(fitting, None)
        subject = f"controller {controller.name[:80]!r}"
        if plugin is not None and drive is None:
            drive = _read_drive(controller, subject, plugin, lumped=lumped, report=report)
        elif plugin is not None:
            report.suspicious(subject, "a second drive; the first is used")
        elif any(kind in controller.type for kind in JOINT_STATE_CONTROLLERS):
            publisher = publisher or _make_publisher(controller, lumped, report)
        elif not is_joint_controller(controller):
            report.ignored(subject, f"{controller.type[:80]!r} does not drive the robot")
    return msgspec.structs.replace(model, drive=drive or model.drive, joint_state=publisher)


def _read_drive(
    controller: Controller,
    subject: str,
    plugin: DrivePlugin[Any],
    *,
    lumped: LumpedModel,
    report: ParseReport,
) -> Drive | None:
    written = WrittenTags(subject, controller.type, controller.texts)
    tags = PluginTags(written, slug="drive", aliases=plugin.aliases, report=report)
    drive: Drive | None = plugin.read(tags, lumped)
    if drive is not None:
        report.applied(subject, f"drive: {plugin.summarize(drive)}")
        plugin.check(drive, lumped, subject=subject, report=report)
        _report_bare_wheels(drive, lumped, report)
    return drive


def _report_bare_wheels(drive: Drive, lumped: LumpedModel, report: ParseReport) -> None:
    children = {joint.name: joint.child for joint in lumped.joints}
    touching = {link.name for link in lumped.links if link.collisions}
    driven = [one.joint for one in drive.actuators if one.joint in drive.wheel_joints]
    has_twist = any(one.mode == "twist" for one in drive.actuators)
    bare = [joint for joint in driven if children[joint] not in touching]
    if bare and not has_twist:
        named = ", ".join(map(repr, bare))
        report.suspicious(
            SUBJECT, f"wheels of {named} have no collision: they carry no load and move nothing"
        )


def _make_publisher(
    controller: Controller, lumped: LumpedModel, report: ParseReport
) -> JointStatePublisher | None:
    joints = tuple(joint.name for joint in lumped.joints)
    if not joints:
        return None
    subject = f"controller {controller.name[:80]!r}"
    tags = PluginTags(
        WrittenTags(subject, controller.type, controller.texts),
        slug="joint_state",
        aliases={},
        report=report,
    )
    rate = tags.number("publish_rate", tags.number("update_rate", DEFAULT_JOINT_STATE_HZ))
    report.applied(subject, f"joint states of {', '.join(joints)}")
    return JointStatePublisher(joints=joints, update_rate_hz=rate)


def _make_ordered(order: DriveOrder, lumped: LumpedModel, report: ParseReport) -> Drive | None:
    for length in (order.separation_m, order.diameter_m, order.wheelbase_m):
        if length != 0.0 and not MIN_LENGTH_M <= length <= MAX_LENGTH_M:
            raise _make_order_error(order, f"a length of {length:g} m is out of range")
    try:
        drive = make_drive(order, lumped)
    except UnusableDrive as fault:
        raise _make_order_error(order, str(fault)) from fault
    if drive is None:
        report.applied(SUBJECT, "none, as ordered")
        return None
    report.applied(SUBJECT, f"{order.kind}, as ordered: {summarize_drive(drive)}")
    if names := _list_reversed(drive):
        report.applied(SUBJECT, f"the axes of {names} point to the right: they turn backward")
    if isinstance(drive, SteeringDrive):
        for fault_text in find_steering_faults(drive, lumped):
            report.suspicious(SUBJECT, fault_text)
    _report_bare_wheels(drive, lumped, report)
    return drive


def _list_reversed(drive: Drive) -> str:
    if isinstance(drive, SteeringDrive):
        return ", ".join(map(repr, drive.reversed_wheels))
    pairs = drive.pairs if isinstance(drive, DiffDrive) else ()
    names = [pair.left_joint for pair in pairs if pair.is_left_reversed]
    names += [pair.right_joint for pair in pairs if pair.is_right_reversed]
    return ", ".join(map(repr, names))


def _make_order_error(order: DriveOrder, fault: str) -> ModelError:
    return ModelError(f"drive {order.kind}: {fault}", slug="drive.order")


def make_drive(order: DriveOrder, lumped: LumpedModel) -> Drive | None:
    """Make the drive of an order; None for `none`.

    Raises:
        UnusableDrive: Its joints or lengths do not fit the robot.
    """
    base = find_base_link(lumped)
    match order.kind:
        case "diff":
            return _order_pairs(order, lumped, base)
        case "mecanum":
            return _order_mecanum(order, lumped, base)
        case "omni":
            return _order_omni(order, lumped, base)
        case "planar":
            if order.joints:
                raise UnusableDrive("a planar drive moves the body; name no joints")
            return PlanarMove(robot_base_frame=base)
        case "ackermann" | "bicycle" | "tricycle":
            return _order_steering(order, lumped, base)
    return None


def _check_count(order: DriveOrder, *counts: int) -> None:
    if len(order.joints) not in counts:
        wanted = " or ".join(map(str, counts))
        raise UnusableDrive(f"{len(order.joints)} joints; name {wanted}")


def _choose(written: float, measured: float, what: str) -> float:
    length = written or measured
    if length < MIN_AXLE_LENGTH_M:
        raise UnusableDrive(f"the {what} cannot be measured; give it")
    return length


def _order_pairs(order: DriveOrder, lumped: LumpedModel, base: str) -> DiffDrive:
    if not order.joints or len(order.joints) % PAIR_SIZE:
        raise UnusableDrive(f"{len(order.joints)} joints; name left and right wheels")
    check_wheel_joints(order.joints, lumped)
    wheels = measure_wheels(order.joints, lumped)
    pairs = [
        WheelPair(
            left.joint,
            right.joint,
            _choose(order.separation_m, measure_separation(left, right), "distance of wheels"),
            _choose(order.diameter_m, 2.0 * left.radius_m, "diameter of wheels"),
            is_left_reversed=rolls_backward(left),
            is_right_reversed=rolls_backward(right),
        )
        for left, right in zip(wheels[::2], wheels[1::2], strict=True)
    ]
    radius = pairs[0].diameter_m / 2.0
    return DiffDrive(
        pairs=tuple(pairs),
        odometry_source="encoder",
        robot_base_frame=base,
        publish_odom=True,
        publish_odom_tf=True,
        max_torque_nm=find_grip_torque(
            lumped, radius_m=radius, wheels=len(pairs), joints=order.joints
        ),
    )


def _order_mecanum(order: DriveOrder, lumped: LumpedModel, base: str) -> OmniDrive:
    _check_count(order, len(MECANUM_WHEELS))
    check_wheel_joints(order.joints, lumped)
    wheels = measure_wheels(order.joints, lumped)
    length, width = measure_reach(wheels)
    reach = (
        _choose(order.wheelbase_m, length, "distance of axles")
        + _choose(order.separation_m, width, "distance of wheels")
    ) / 2.0
    radius = _choose(order.diameter_m, 2.0 * wheels[0].radius_m, "diameter of wheels") / 2.0
    rollers = make_mecanum_wheels(order.joints, radius_m=radius, reach_m=reach)
    return with_wheels(_make_base(base), rollers, lumped)


def _order_omni(order: DriveOrder, lumped: LumpedModel, base: str) -> OmniDrive:
    if len(order.joints) < MIN_OMNI_WHEELS:
        raise UnusableDrive(f"{len(order.joints)} joints; name {MIN_OMNI_WHEELS} wheels or more")
    check_wheel_joints(order.joints, lumped)
    rollers = tuple(_roll_about(one, order) for one in measure_wheels(order.joints, lumped))
    return with_wheels(_make_base(base), rollers, lumped)


def _roll_about(wheel: MeasuredWheel, order: DriveOrder) -> RollerWheel:
    """Find the speed of a wheel about its axle, whose rollers slide along the axle."""
    radius = _choose(order.diameter_m, 2.0 * wheel.radius_m, "diameter of wheels") / 2.0
    (x, y, _), (ax, ay, _) = wheel.centre, wheel.axis
    length = math.hypot(ax, ay)
    if length < MIN_AXLE_LENGTH_M:
        raise UnusableDrive(f"the axis of {wheel.joint!r} is upright")
    # Direction in which the wheel rolls at positive speed.
    ahead, left = ay / length, -ax / length
    return RollerWheel(wheel.joint, ahead / radius, left / radius, (x * left - y * ahead) / radius)


def _make_base(base: str) -> OmniDrive:
    return OmniDrive(robot_base_frame=base, publish_odom=True, publish_odom_tf=True)


def _order_steering(order: DriveOrder, lumped: LumpedModel, base: str) -> SteeringDrive:
    counts = {"ackermann": (4, TWO_AXLES), "bicycle": (2,), "tricycle": (2, 3)}[order.kind]
    _check_count(order, *counts)
    driven = 2 if order.kind == "ackermann" else len(order.joints) - 1

    def choose(name: str, measured: float) -> float:
        return _choose(written[name], measured, name.replace("_", " "))

    written = {
        "traction_wheels_radius": order.diameter_m / 2.0,
        "wheelbase": order.wheelbase_m,
        "traction_track_width": order.separation_m,
        "steering_track_width": order.separation_m,
    }
    drive = SteeringDrive(
        robot_base_frame=base,
        publish_odom=True,
        publish_odom_tf=True,
        is_traction_steered=order.kind == "tricycle" and driven == 1,
    )
    if len(order.joints) == TWO_AXLES:
        names = [
            order.joints[start : start + PAIR_SIZE] for start in range(0, TWO_AXLES, PAIR_SIZE)
        ]
        return _reverse_wheels(
            complete_two_axles(drive, names[:2], names[2:], lumped=lumped, choose=choose), lumped
        )
    completed = complete_steering(
        drive, order.joints[:driven], order.joints[driven:], lumped=lumped, choose=choose
    )
    return _reverse_wheels(completed, lumped)


def _reverse_wheels(drive: SteeringDrive, lumped: LumpedModel) -> SteeringDrive:
    wheels = measure_wheels(drive.traction, lumped)
    names = tuple(wheel.joint for wheel in wheels if rolls_backward(wheel))
    return msgspec.structs.replace(drive, reversed_wheels=names)
