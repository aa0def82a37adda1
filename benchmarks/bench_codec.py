"""Codec

One message to bytes and back, in each format: CDR for ROS, MessagePack for services and drives,
JSON for all. Floor: rosbags, in the same run.
"""

import struct
from collections.abc import Iterable, Iterator

import msgspec

from benchmarks.timing import Timing, measure
from tests.proto.ros_oracle import HUMBLE, as_ros, message_name
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import STATE_COLUMNS, DriveState
from zensim.proto.messages.standard_messages import (
    Header,
    JointState,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)

REPEATS = 501
REPEATS_WHEN_SHORT = 11
INNER = 20
ROBOTS = 100
JOINTS = 4
HEADER = Header(Time(12, 345_678_901), "box_bot0/odom")
CHILD = "box_bot0/base_footprint"
COVARIANCE = tuple(1e-3 * place for place in range(36))
POSE = Pose(Point(1.25, -0.5, 0.1), Quaternion(z=0.6, w=0.8))
TWIST = Twist(Vector3(0.5), Vector3(z=-0.25))


class Row(msgspec.Struct, frozen=True):
    """One row of the table."""

    message: str
    format: str
    size_bytes: int
    encode: Timing
    decode: Timing


def samples() -> dict[str, msgspec.Struct]:
    """List the measured messages, filled as in use."""
    transform = Transform(Vector3(1.25, -0.5, 0.1), POSE.orientation)
    return {
        "Odometry": Odometry(
            HEADER, CHILD, PoseWithCovariance(POSE, COVARIANCE), TwistWithCovariance(TWIST)
        ),
        "TFMessage (1)": TFMessage((TransformStamped(HEADER, CHILD, transform),)),
        "Twist": TWIST,
        "JointState (2)": JointState(HEADER, ("left_wheel", "right_wheel"), (0.1, 0.2), (3.0, 4.0)),
        f"DriveState ({ROBOTS} robots)": DriveState(
            epoch=1,
            step=1000,
            time_ns=4_000_000_000,
            claims=struct.pack(f"<{ROBOTS}I", *range(ROBOTS)),
            base=_numbers(ROBOTS * STATE_COLUMNS),
            joint_positions=_numbers(ROBOTS * JOINTS),
            joint_velocities=_numbers(ROBOTS * JOINTS),
        ),
    }


def rows(*, is_short: bool) -> Iterator[Row]:
    """Measure each sample in each format, and with rosbags."""
    repeats = REPEATS_WHEN_SHORT if is_short else REPEATS
    for name, message in samples().items():
        for format_ in Format:
            yield _ours(name, message, format_, repeats)
        yield _rosbags(name, message, repeats)


def table(rows: Iterable[Row]) -> str:
    """Format measurements as a Markdown table."""
    lines = [
        f"Median of runs of {INNER} calls, {REPEATS} of them at full length, with p10 to p90.",
        "",
        "| message | format | bytes | encode [us] | decode [us] |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.message} | {row.format} | {row.size_bytes} | {row.encode} | {row.decode} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def _ours(name: str, message: msgspec.Struct, format_: Format, repeats: int) -> Row:
    payload, encoding = encode(message, format_), make_encoding(message, format_)
    return Row(
        name,
        format_.name,
        len(payload),
        measure(lambda: encode(message, format_), repeats, INNER),
        measure(lambda: decode(type(message), payload, encoding), repeats, INNER),
    )


def _rosbags(name: str, message: msgspec.Struct, repeats: int) -> Row:
    payload = encode(message, Format.CDR)
    ros_name = message_name(make_encoding(message, Format.CDR).partition(";")[2])
    built = as_ros(message, ros_name)
    return Row(
        name,
        "CDR by rosbags",
        len(payload),
        measure(lambda: HUMBLE.serialize_cdr(built, ros_name), repeats, INNER),
        measure(lambda: HUMBLE.deserialize_cdr(payload, ros_name), repeats, INNER),
    )


def _numbers(count: int) -> bytes:
    return struct.pack(f"<{count}d", *(0.001 * place for place in range(count)))
