"""Messages encoded once as CDR, whose numbers and stamps are filled in, and the paths of those."""

import struct
from collections.abc import Sequence
from itertools import pairwise

import msgspec

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_layout import find_offsets
from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Header,
    JointState,
    Odometry,
    TFMessage,
    Time,
)
from zensim.robot_agent.base_controller import get_drive
from zensim.robot_agent.odometry import BaseMotion, OdometryHeader, make_covariance
from zensim.robot_agent.robot_frames import (
    find_base_frame,
    list_moving_joints,
    make_moving_transforms,
    make_odometry_edge,
)

FLOAT_BYTES = 8
STAMP_STRUCT = struct.Struct("<iI")


class CdrTemplate:
    """One message, each byte as `zensim.proto.codec.cdr.encode` writes it; made at a tenth of the cost."""

    def __init__(
        self, template: msgspec.Struct, *, numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        """Write the message.

        Args:
            template: As it is but for what changes.
            numbers: Paths of its float64 numbers that change; see `zensim.proto.codec.cdr_layout`.
            stamps: Paths of its `Time`s.
        """
        self._buffer = bytearray(cdr.encode(template))
        places = find_offsets(template)
        self._runs = _find_runs([places[path] for path in numbers])
        self._stamps = tuple(places[f"{path}.sec"] for path in stamps)

    def payload(self, time_ns: int, numbers: Sequence[float]) -> bytes:
        """Fill in a moment of simulation time and the numbers; return the whole message."""
        moment = divmod(time_ns, NANOSECONDS)
        for place in self._stamps:
            STAMP_STRUCT.pack_into(self._buffer, place, *moment)
        for run, place, where in self._runs:
            run.pack_into(self._buffer, place, *numbers[where])
        return bytes(self._buffer)


def _find_runs(places: Sequence[int]) -> tuple[tuple[struct.Struct, int, slice], ...]:
    """Find the numbers that follow one another, so that each run is written in one go."""
    gaps = [at for at, (one, next_) in enumerate(pairwise(places), 1) if next_ != one + FLOAT_BYTES]
    bounds = [0, *gaps, len(places)]
    return tuple(
        (struct.Struct(f"<{end - start}d"), places[start], slice(start, end))
        for start, end in pairwise(bounds)
        if end > start
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
    """Write the odometry of a robot that has not moved."""
    drive = get_drive(model)
    frames = OdometryHeader(
        drive.odometry_frame, find_base_frame(model).name, make_covariance(drive)
    )
    return frames.message(BaseMotion(), Time())


def make_tf_template(model: Model) -> TFMessage:
    """Write the transforms of a robot that has not moved."""
    drive, joints = get_drive(model), list_moving_joints(model)
    told = make_moving_transforms(joints, [0.0] * len(model.joints), Time())
    if not drive.publish_odom_tf:
        return TFMessage(told)
    edge = make_odometry_edge(drive.odometry_frame, find_base_frame(model).name, BaseMotion())
    return TFMessage((edge.to_message(Time()), *told))


def count_transforms(drive: Drive, joints: Sequence[int]) -> int:
    """Count the transforms of such a message."""
    return len(joints) + (1 if drive.publish_odom_tf else 0)


def list_tf_paths(count: int) -> tuple[str, ...]:
    """List where the numbers of so many transforms go."""
    return tuple(
        f"transforms[{number}].transform.{part}"
        for number in range(count)
        for part in (
            *(f"translation.{axis}" for axis in POSITION_AXES),
            *(f"rotation.{axis}" for axis in QUATERNION_AXES),
        )
    )


def list_tf_stamps(count: int) -> tuple[str, ...]:
    """List where the stamps of so many transforms go."""
    return tuple(f"transforms[{number}].header.stamp" for number in range(count))


def list_joint_paths(count: int) -> tuple[str, ...]:
    """List where the numbers of so many joints go: positions, then velocities."""
    return tuple(f"{array}[{item}]" for array in ("position", "velocity") for item in range(count))


def make_joint_states_template(model: Model, joints: Sequence[int]) -> JointState:
    """Write the joint states of a robot whose joints are all at 0."""
    zeros = (0.0,) * len(joints)
    names = tuple(model.joints[joint].name for joint in joints)
    return JointState(Header(), names, zeros, zeros)
