"""Plug-ins of steered drives: Ackermann and tricycle."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import AckermannDrive, SteeringDrive, TricycleDrive
from zensim.sim_server.description.plugins.drive_controllers import (
    RADIUS,
    STEERING_TRACK,
    TRACTION_TRACK,
    WHEELBASE,
    complete_steering,
    find_steering_faults,
    summarize_steering,
)
from zensim.sim_server.description.plugins.drive_plugin import (
    FLAG,
    GZ_ODOMETRY_RATE_HZ,
    GZ_PARAMETERS,
    LENGTH,
    NUMBER,
    ROS_ALIASES,
    ROS_PARAMETERS,
    ROS_UNUSED,
    TEXT,
    DriveParameter,
    DrivePlugin,
    UnusableDrive,
)
from zensim.sim_server.description.plugins.wheel_measures import (
    check_lengths,
    check_sides,
    check_wheel_joints,
    find_base_link,
    find_diameter_faults,
    find_distance_faults,
    find_grip_torque,
    measure_wheels,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from zensim.proto.messages.model_messages import Vec3
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

MIN_AXLE_LENGTH_M = 1e-3
ROS1_TRICYCLE_TAGS = ("steering_joint", "actuated_wheel_joint", "wheel_separation")
"""Tags whose ROS 1 spelling says for which of the two a tricycle is written."""
_CONTROLLERS = dict.fromkeys(
    (
        "left_steering_pid_gain", "left_steering_i_range", "right_steering_pid_gain",
        "right_steering_i_range", "linear_velocity_pid_gain", "linear_velocity_i_range",
    ),
    "the engine's motors control speed and angle",
)  # fmt: skip


def _measure_ackermann(drive: AckermannDrive, _: PluginTags, lumped: LumpedModel) -> AckermannDrive:
    check_wheel_joints(drive.joints, lumped)
    rear_left, rear_right, front_left, front_right = measure_wheels(drive.wheel_joints, lumped)
    track = math.dist(front_left.centre, front_right.centre)
    front = _midpoint((front_left.centre, front_right.centre))
    wheelbase = math.dist(front, _midpoint((rear_left.centre, rear_right.centre)))
    radius = rear_right.radius_m
    if min(track, wheelbase, radius) < MIN_AXLE_LENGTH_M:
        raise UnusableDrive("rear wheels have no round collision, or two wheels are in one place")
    steering = (drive.left_steering_joint, drive.right_steering_joint)
    return msgspec.structs.replace(
        drive,
        wheel_radius_m=radius,
        wheelbase_m=wheelbase,
        track_m=track,
        wheel_effort_nm=find_grip_torque(
            lumped, radius_m=radius, wheels=2, joints=drive.wheel_joints[:2]
        ),
        steering_effort_nm=find_grip_torque(lumped, radius_m=radius, wheels=1, joints=steering),
    )


def _midpoint(points: Iterable[Vec3]) -> list[float]:
    return [sum(numbers) / 2.0 for numbers in zip(*points, strict=True)]


def _summarize_ackermann(drive: AckermannDrive) -> str:
    return (
        f"wheelbase {drive.wheelbase_m:g} m, track {drive.track_m:g} m, "
        f"wheel radius {drive.wheel_radius_m:g} m"
    )


def _find_ackermann_faults(drive: AckermannDrive, lumped: LumpedModel) -> list[str]:
    wheels = measure_wheels(drive.wheel_joints[:2], lumped)
    return find_diameter_faults("the diameter of the right one", 2.0 * drive.wheel_radius_m, wheels)


def _make_tricycle(tags: PluginTags, _: LumpedModel) -> TricycleDrive:
    # There, the odometry and its transform are always published.
    is_ros1 = any(tags.is_renamed(tag) for tag in ROS1_TRICYCLE_TAGS)
    if is_ros1:
        tags.report.suspicious(tags.subject, "written for ROS 1: odom and its tf are published")
    return TricycleDrive(publish_odom=is_ros1, publish_odom_tf=is_ros1)


def _find_tricycle_faults(drive: TricycleDrive, lumped: LumpedModel) -> list[str]:
    actuated, left, right = measure_wheels(drive.wheel_joints, lumped)
    return [
        *find_diameter_faults(
            "actuated_wheel_diameter", drive.actuated_wheel_diameter_m, (actuated,)
        ),
        *find_diameter_faults(
            "encoder_wheel_diameter", drive.encoder_wheel_diameter_m, (left, right)
        ),
        *find_distance_faults("wheel_separation", drive.wheel_separation_m, left, right),
    ]


def _measure_tricycle(drive: TricycleDrive, _: PluginTags, lumped: LumpedModel) -> TricycleDrive:
    check_wheel_joints(drive.joints, lumped)
    radius = drive.actuated_wheel_diameter_m / 2.0
    effort = find_grip_torque(lumped, radius_m=radius, wheels=1, joints=(drive.steering_joint,))
    return msgspec.structs.replace(drive, steering_effort_nm=effort)


def _summarize_tricycle(drive: TricycleDrive) -> str:
    return f"actuated wheel, diameter {drive.actuated_wheel_diameter_m:g} m"


GZ_LENGTHS = {
    RADIUS: ("wheel_radius", 0.2),
    WHEELBASE: ("wheel_base", 1.0),
    TRACTION_TRACK: ("wheel_separation", 1.0),
    STEERING_TRACK: ("kingpin_width", 0.8),
}
"""Tags of gz-sim's AckermannSteering, and their defaults [m]."""
GZ_MAX_STEER_RAD = 0.5
_GZ_LIMITS = (
    "min_velocity", "min_acceleration", "max_acceleration", "min_jerk", "max_jerk",
)  # fmt: skip


def _make_gz_car(_: PluginTags, lumped: LumpedModel) -> SteeringDrive:
    return SteeringDrive(
        update_rate_hz=0.0,
        odometry_rate_hz=GZ_ODOMETRY_RATE_HZ,
        robot_base_frame=find_base_link(lumped),
        publish_odom=True,
        publish_odom_tf=True,
        max_steer=GZ_MAX_STEER_RAD,
    )


def _read_gz_car(drive: SteeringDrive, tags: PluginTags, lumped: LumpedModel) -> SteeringDrive:
    for tag in ("steering_only", "use_actuator_msg"):
        if tags.flag(tag, default=False):
            raise UnusableDrive(f"<{tag}> commands an angle without a speed; remove it")
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    steering = [*tags.texts("left_steering_joint")[:1], *tags.texts("right_steering_joint")[:1]]
    check_sides(left, right)
    check_wheel_joints((*left, *right, *steering), lumped)
    pairs = list(zip(left, right, strict=True))
    traction = next((pair for pair in pairs if not _is_steered(pair, steering, lumped)), pairs[0])
    for pair in pairs:
        if pair != traction:
            tags.report.ignored(tags.subject, f"{' and '.join(pair)} turn along, not driven")

    def choose(name: str, _: float) -> float:
        tag, default = GZ_LENGTHS[name]
        length = tags.length(tag, default)
        check_lengths(tags, tag, (length,))
        return length

    fastest = tags.signed("max_velocity")
    return complete_steering(
        drive if fastest is None else msgspec.structs.replace(drive, max_speed=abs(fastest)),
        traction,
        steering,
        lumped=lumped,
        choose=choose,
    )


def _is_steered(wheels: Iterable[str], steering: Iterable[str], lumped: LumpedModel) -> bool:
    """Whether one of these wheels is moved by one of these steering joints."""
    by_name = {joint.name: joint for joint in lumped.joints}
    by_child = {joint.child: joint for joint in lumped.joints}
    knuckles = {by_name[name].child for name in steering}
    for name in wheels:
        parent = by_name[name].parent
        while parent not in knuckles and parent in by_child:
            parent = by_child[parent].parent
        if parent in knuckles:
            return True
    return False


PLUGINS = (
    DrivePlugin(
        filenames=("ackermann-steering-system",),
        drive_type=SteeringDrive,
        summarize=summarize_steering,
        make=_make_gz_car,
        parameters=(*GZ_PARAMETERS, DriveParameter("steering_limit", NUMBER, "max_steer")),
        complete=_read_gz_car,
        find_faults=find_steering_faults,
        unused={
            "tf_topic": "tf is on <namespace>/tf",
            "sub_topic": "cmd_vel is on <namespace>/cmd_vel",
            "steer_p_gain": "the engine's motors control the angle",
            "actuator_number": "used with actuator messages",
            **dict.fromkeys(_GZ_LIMITS, "not limited"),
        },
    ),
    DrivePlugin(
        filenames=("gazebo_ros_ackermann_drive",),
        drive_type=AckermannDrive,
        summarize=_summarize_ackermann,
        parameters=(
            *ROS_PARAMETERS,
            DriveParameter("rear_left_joint", TEXT),
            DriveParameter("rear_right_joint", TEXT),
            DriveParameter("front_left_joint", TEXT),
            DriveParameter("front_right_joint", TEXT),
            DriveParameter("left_steering_joint", TEXT),
            DriveParameter("right_steering_joint", TEXT),
            DriveParameter("steering_wheel_joint", TEXT),
            DriveParameter("max_speed", NUMBER),
            DriveParameter("max_steer", NUMBER),
            DriveParameter("max_steering_angle", NUMBER),
        ),
        complete=_measure_ackermann,
        find_faults=_find_ackermann_faults,
        aliases=ROS_ALIASES,
        unused=ROS_UNUSED
        | _CONTROLLERS
        | {
            "publish_distance": "distance is not published",
            "publish_steerangle": "steerangle is not published",
        },
    ),
    DrivePlugin(
        filenames=("gazebo_ros_tricycle_drive",),
        drive_type=TricycleDrive,
        summarize=_summarize_tricycle,
        make=_make_tricycle,
        parameters=(
            *ROS_PARAMETERS,
            # Gazebo sends the transform of its odometry whenever it sends the odometry.
            DriveParameter("publish_odom_tf", FLAG, default_field="publish_odom"),
            DriveParameter("steering_joint", TEXT),
            DriveParameter("actuated_wheel_joint", TEXT),
            DriveParameter("encoder_wheel_left_joint", TEXT),
            DriveParameter("encoder_wheel_right_joint", TEXT),
            DriveParameter("actuated_wheel_diameter", LENGTH, "actuated_wheel_diameter_m"),
            DriveParameter("encoder_wheel_diameter", LENGTH, "encoder_wheel_diameter_m"),
            DriveParameter("wheel_separation", LENGTH, "wheel_separation_m"),
            DriveParameter("max_wheel_torque", NUMBER, "max_torque_nm"),
            DriveParameter("max_wheel_acceleration", NUMBER, "max_acceleration"),
            DriveParameter(
                "max_wheel_deceleration", NUMBER, "max_deceleration", "max_acceleration"
            ),
            DriveParameter("max_wheel_speed_tolerance", NUMBER, "speed_tolerance"),
            DriveParameter("max_steering_speed", NUMBER),
            DriveParameter("max_steering_angle_tolerance", NUMBER, "angle_tolerance"),
        ),
        complete=_measure_tricycle,
        find_faults=_find_tricycle_faults,
        aliases=ROS_ALIASES
        | {
            "steeringJoint": "steering_joint",
            "actuatedWheelJoint": "actuated_wheel_joint",
            "encoderWheelLeftJoint": "encoder_wheel_left_joint",
            "encoderWheelRightJoint": "encoder_wheel_right_joint",
            "actuatedWheelDiameter": "actuated_wheel_diameter",
            "encoderWheelDiameter": "encoder_wheel_diameter",
            "encoderWheelSeparation": "wheel_separation",
            "wheelTorque": "max_wheel_torque",
            "wheelAcceleration": "max_wheel_acceleration",
            "wheelDeceleration": "max_wheel_deceleration",
            "wheelSpeedTolerance": "max_wheel_speed_tolerance",
            "steeringSpeed": "max_steering_speed",
            "steeringAngleTolerance": "max_steering_angle_tolerance",
        },
        unused=ROS_UNUSED | {"steeringTorque": "steering has the wheel's torque"},
    ),
)
