"""Standard messages of ROS 2: builtin_interfaces, std_msgs, geometry_msgs, nav_msgs and others."""

from typing import ClassVar

import msgspec

from zensim.proto.messages.scalar_types import ZERO_MATRIX6, Int32, Matrix6, UInt32

NANOSECONDS = 1_000_000_000


class Time(msgspec.Struct, frozen=True):
    """A moment of simulation time. Source: builtin_interfaces/msg/Time."""

    ros_type: ClassVar[str] = "builtin_interfaces/msg/Time"

    sec: Int32 = 0
    nanosec: UInt32 = 0


class Duration(msgspec.Struct, frozen=True):
    """A span of simulation time. Source: builtin_interfaces/msg/Duration."""

    ros_type: ClassVar[str] = "builtin_interfaces/msg/Duration"

    sec: Int32 = 0
    nanosec: UInt32 = 0


class Header(msgspec.Struct, frozen=True):
    """Time and frame of a message. Source: std_msgs/msg/Header."""

    ros_type: ClassVar[str] = "std_msgs/msg/Header"

    stamp: Time = Time()
    frame_id: str = ""


def time_from_ns(time_ns: int) -> Time:
    """Split simulation time [ns] into the ROS pair."""
    sec, nanosec = divmod(time_ns, NANOSECONDS)
    return Time(sec, nanosec)


def ns_from_time(time: Time | Duration) -> int:
    """Join the ROS pair into simulation time [ns]; a span may be negative."""
    return time.sec * NANOSECONDS + time.nanosec


class Vector3(msgspec.Struct, frozen=True):
    """Three components along x, y, z. Source: geometry_msgs/msg/Vector3."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Vector3"

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Point(msgspec.Struct, frozen=True):
    """A position [m]. Source: geometry_msgs/msg/Point."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Point"

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Quaternion(msgspec.Struct, frozen=True):
    """An orientation; defaults to identity. Source: geometry_msgs/msg/Quaternion."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Quaternion"

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Pose(msgspec.Struct, frozen=True):
    """Position and orientation. Source: geometry_msgs/msg/Pose."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Pose"

    position: Point = Point()
    orientation: Quaternion = Quaternion()


class PoseStamped(msgspec.Struct, frozen=True):
    """A pose in a frame, at a time. Source: geometry_msgs/msg/PoseStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PoseStamped"

    header: Header = Header()
    pose: Pose = Pose()


class PoseWithCovariance(msgspec.Struct, frozen=True):
    """A pose and its covariance. Source: geometry_msgs/msg/PoseWithCovariance."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PoseWithCovariance"

    pose: Pose = Pose()
    covariance: Matrix6 = ZERO_MATRIX6


class Twist(msgspec.Struct, frozen=True):
    """Linear [m/s] and angular [rad/s] velocity. Source: geometry_msgs/msg/Twist."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Twist"

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


class TwistStamped(msgspec.Struct, frozen=True):
    """A twist in a frame, at a time. Source: geometry_msgs/msg/TwistStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/TwistStamped"

    header: Header = Header()
    twist: Twist = Twist()


class TwistWithCovariance(msgspec.Struct, frozen=True):
    """A twist and its covariance. Source: geometry_msgs/msg/TwistWithCovariance."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/TwistWithCovariance"

    twist: Twist = Twist()
    covariance: Matrix6 = ZERO_MATRIX6


class Accel(msgspec.Struct, frozen=True):
    """Linear [m/s^2] and angular [rad/s^2] acceleration. Source: geometry_msgs/msg/Accel."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Accel"

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


class Wrench(msgspec.Struct, frozen=True):
    """Force [N] and torque [N m]. Source: geometry_msgs/msg/Wrench."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Wrench"

    force: Vector3 = Vector3()
    torque: Vector3 = Vector3()


class Transform(msgspec.Struct, frozen=True):
    """Translation [m] and rotation. Source: geometry_msgs/msg/Transform."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Transform"

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


class TransformStamped(msgspec.Struct, frozen=True):
    """Pose of child_frame_id in header.frame_id. Source: geometry_msgs/msg/TransformStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/TransformStamped"

    header: Header = Header()
    child_frame_id: str = ""
    transform: Transform = Transform()


class Odometry(msgspec.Struct, frozen=True):
    """Pose in header.frame_id, twist in child_frame_id. Source: nav_msgs/msg/Odometry."""

    ros_type: ClassVar[str] = "nav_msgs/msg/Odometry"

    header: Header = Header()
    child_frame_id: str = ""
    pose: PoseWithCovariance = PoseWithCovariance()
    twist: TwistWithCovariance = TwistWithCovariance()


class TFMessage(msgspec.Struct, frozen=True):
    """Transforms. Source: tf2_msgs/msg/TFMessage."""

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
