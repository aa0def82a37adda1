"""What robots publish and hear besides geometry: odometry, tf, clock, joints, text."""

from typing import ClassVar

import msgspec

from zensim.proto.geometry import PoseWithCovariance, TransformStamped, TwistWithCovariance
from zensim.proto.header import Header, Time


class Odometry(msgspec.Struct, frozen=True):
    """Pose in header.frame_id, twist in child_frame_id. Source: nav_msgs/msg/Odometry."""

    ros_type: ClassVar[str] = "nav_msgs/msg/Odometry"

    header: Header = Header()
    child_frame_id: str = ""
    pose: PoseWithCovariance = PoseWithCovariance()
    twist: TwistWithCovariance = TwistWithCovariance()


class TFMessage(msgspec.Struct, frozen=True):
    """Transforms of one moment. Source: tf2_msgs/msg/TFMessage."""

    ros_type: ClassVar[str] = "tf2_msgs/msg/TFMessage"

    transforms: tuple[TransformStamped, ...] = ()


class Clock(msgspec.Struct, frozen=True):
    """Simulation time. Source: rosgraph_msgs/msg/Clock."""

    ros_type: ClassVar[str] = "rosgraph_msgs/msg/Clock"

    clock: Time = Time()


class JointState(msgspec.Struct, frozen=True):
    """Positions [rad or m], velocities, efforts by name. Source: sensor_msgs/msg/JointState."""

    ros_type: ClassVar[str] = "sensor_msgs/msg/JointState"

    header: Header = Header()
    name: tuple[str, ...] = ()
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()


class String(msgspec.Struct, frozen=True):
    """Text, such as a robot description. Source: std_msgs/msg/String."""

    ros_type: ClassVar[str] = "std_msgs/msg/String"

    data: str = ""
