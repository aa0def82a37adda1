"""Message templates of a robot's topics, and the paths of the numbers and stamps to fill in."""

from collections.abc import Sequence

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Header, JointState, Odometry, TFMessage, Time
from zensim.robot_agent.odometry import BaseMotion, OdometryHeader, make_covariances
from zensim.robot_agent.robot_frames import (
    find_base_frame,
    get_drive,
    list_moving_joints,
    make_moving_transforms,
    make_odometry_edge,
)

POSITION_AXES = ("x", "y", "z")
QUATERNION_AXES = ("x", "y", "z", "w")
ODOMETRY_PATHS = (
    *(f"pose.pose.position.{axis}" for axis in POSITION_AXES),
    *(f"pose.pose.orientation.{axis}" for axis in QUATERNION_AXES),
    "twist.twist.linear.x",
    "twist.twist.linear.y",
    "twist.twist.angular.z",
)
HEADER_STAMP = ("header.stamp",)


def make_odometry_template(model: Model) -> Odometry:
    """Make the odometry of a robot at its origin."""
    drive = get_drive(model)
    frames = OdometryHeader(
        drive.odometry_frame, find_base_frame(model).name, *make_covariances(drive)
    )
    return frames.message(BaseMotion(), Time())


def make_tf_template(model: Model) -> TFMessage:
    """Make the moving transforms of a robot at its origin."""
    drive, joints = get_drive(model), list_moving_joints(model)
    moving = make_moving_transforms(joints, [0.0] * len(model.joints), Time())
    if not drive.publish_odom_tf:
        return TFMessage(moving)
    edge = make_odometry_edge(drive.odometry_frame, find_base_frame(model).name, BaseMotion())
    return TFMessage((edge.to_message(Time()), *moving))


def count_transforms(drive: Drive, joints: Sequence[int]) -> int:
    """Count the moving transforms of a robot."""
    return len(joints) + (1 if drive.publish_odom_tf else 0)


def list_tf_paths(count: int) -> tuple[str, ...]:
    """List the paths of the numbers of `count` transforms."""
    return tuple(
        f"transforms[{number}].transform.{part}"
        for number in range(count)
        for part in (
            *(f"translation.{axis}" for axis in POSITION_AXES),
            *(f"rotation.{axis}" for axis in QUATERNION_AXES),
        )
    )


def list_tf_stamps(count: int) -> tuple[str, ...]:
    """List the paths of the stamps of `count` transforms."""
    return tuple(f"transforms[{number}].header.stamp" for number in range(count))


def list_joint_paths(count: int) -> tuple[str, ...]:
    """List the paths of the numbers of `count` joints: positions, velocities, then efforts."""
    arrays = ("position", "velocity", "effort")
    return tuple(f"{array}[{item}]" for array in arrays for item in range(count))


def make_joint_states_template(model: Model, joints: Sequence[int]) -> JointState:
    """Make the joint states of joints at 0."""
    zeros = (0.0,) * len(joints)
    names = tuple(model.joints[joint].name for joint in joints)
    return JointState(Header(), names, zeros, zeros, zeros)
