"""Message templates of a robot's topics, and the paths of the numbers of joints to fill in."""

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


def list_joint_paths(count: int) -> tuple[str, ...]:
    """List the paths of the numbers of `count` joints: positions, velocities, then efforts."""
    arrays = ("position", "velocity", "effort")
    return tuple(f"{array}[{item}]" for array in arrays for item in range(count))


def make_joint_states_template(model: Model, joints: Sequence[int]) -> JointState:
    """Make the joint states of joints at 0."""
    zeros = (0.0,) * len(joints)
    names = tuple(model.joints[joint].name for joint in joints)
    return JointState(Header(), names, zeros, zeros, zeros)
