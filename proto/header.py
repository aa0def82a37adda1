"""Stamps and headers: builtin_interfaces and std_msgs."""

from typing import ClassVar

import msgspec

from zensim.proto.widths import Int32, UInt32

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
    """When and in which frame. Source: std_msgs/msg/Header."""

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
