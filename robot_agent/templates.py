"""Messages of robots with their names and frames, to be filled with numbers; and where those go."""

from collections.abc import Sequence

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Header, JointState, Odometry, TFMessage, Time
from zensim.robot_agent.driven_base import drive_of
from zensim.robot_agent.frames import base_of, moving_joints, moving_transforms, odometry_edge
from zensim.robot_agent.odometry import Motion, OdometryFrames, covariance_of

POSE = ("x", "y", "z")
TURN = ("x", "y", "z", "w")
ODOMETRY_PATHS = (
    *(f"pose.pose.position.{axis}" for axis in POSE),
    *(f"pose.pose.orientation.{axis}" for axis in TURN),
    "twist.twist.linear.x",
    "twist.twist.linear.y",
    "twist.twist.angular.z",
)
HEADER_STAMP = ("header.stamp",)


def odometry_template(model: Model) -> Odometry:
    """Write the odometry of a robot that has not moved."""
    drive = drive_of(model)
    frames = OdometryFrames(drive.odometry_frame, base_of(model).name, covariance_of(drive))
    return frames.message(Motion(), Time())


def tf_template(model: Model) -> TFMessage:
    """Write the transforms of a robot that has not moved."""
    drive, joints = drive_of(model), moving_joints(model)
    told = moving_transforms(joints, [0.0] * len(model.joints), Time())
    if not drive.publish_odom_tf:
        return TFMessage(told)
    edge = odometry_edge(drive.odometry_frame, base_of(model).name, Motion())
    return TFMessage((edge.stamped(Time()), *told))


def tf_count(drive: Drive, joints: Sequence[int]) -> int:
    """Count the transforms of such a message."""
    return len(joints) + (1 if drive.publish_odom_tf else 0)


def tf_paths(count: int) -> tuple[str, ...]:
    """List where the numbers of so many transforms go."""
    return tuple(
        f"transforms[{number}].transform.{part}"
        for number in range(count)
        for part in (
            *(f"translation.{axis}" for axis in POSE),
            *(f"rotation.{axis}" for axis in TURN),
        )
    )


def tf_stamps(count: int) -> tuple[str, ...]:
    """List where the stamps of so many transforms go."""
    return tuple(f"transforms[{number}].header.stamp" for number in range(count))


def joint_paths(count: int) -> tuple[str, ...]:
    """List where the numbers of so many joints go: positions, then velocities."""
    return tuple(f"{array}[{item}]" for array in ("position", "velocity") for item in range(count))


def joint_states_template(model: Model, joints: Sequence[int]) -> JointState:
    """Write the joint states of a robot whose joints are all at 0."""
    zeros = (0.0,) * len(joints)
    names = tuple(model.joints[joint].name for joint in joints)
    return JointState(Header(), names, zeros, zeros)
