"""Poses, twists and transforms: geometry_msgs, with its field names and order."""

from typing import ClassVar

import msgspec

from zensim.proto.header import Header
from zensim.proto.widths import ZERO_MATRIX6, Matrix6


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
    """An orientation, identity unless told. Source: geometry_msgs/msg/Quaternion."""

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
    """A pose with the frame it is given in. Source: geometry_msgs/msg/PoseStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PoseStamped"

    header: Header = Header()
    pose: Pose = Pose()


class PoseWithCovariance(msgspec.Struct, frozen=True):
    """A pose and how sure it is. Source: geometry_msgs/msg/PoseWithCovariance."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/PoseWithCovariance"

    pose: Pose = Pose()
    covariance: Matrix6 = ZERO_MATRIX6


class Twist(msgspec.Struct, frozen=True):
    """Linear [m/s] and angular [rad/s] velocity. Source: geometry_msgs/msg/Twist."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/Twist"

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


class TwistStamped(msgspec.Struct, frozen=True):
    """A twist with its frame and time. Source: geometry_msgs/msg/TwistStamped."""

    ros_type: ClassVar[str] = "geometry_msgs/msg/TwistStamped"

    header: Header = Header()
    twist: Twist = Twist()


class TwistWithCovariance(msgspec.Struct, frozen=True):
    """A twist and how sure it is. Source: geometry_msgs/msg/TwistWithCovariance."""

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
