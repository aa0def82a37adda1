"""What rmw_zenoh asks of a publisher, judged by an implementation that is not ours.

A sample whose attachment is wrong is dropped by it; a token that does not parse is no endpoint;
data come on the key that the endpoint's name, type and hash make.
"""

import struct
from dataclasses import dataclass

import xxhash
import zenoh
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.keyexpr import ADMIN_SPACE, topic_keyexpr
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
from zenoh_ros2_sdk.utils import dds_to_ros_type, demangle_name

from tests.integration.ros_interfaces import OF_HUMBLE
from tests.proto.ros_hashes import hash_of_message
from tests.proto.ros_oracle import HUMBLE

ATTACHMENT_BYTES = 33
TOKEN_PARTS = 13


class BrokenRule(AssertionError):
    """rmw_zenoh would not take it."""


@dataclass(frozen=True)
class Heard:
    """One sample, as it came."""

    key: str
    payload: bytes
    attachment: bytes


@dataclass(frozen=True)
class Announced:
    """A publisher, as its token tells it."""

    node: str
    name: str
    ros_type: str
    key: str
    is_latched: bool


def to_received_sample(sample: zenoh.Sample) -> Heard:
    attachment = sample.attachment.to_bytes() if sample.attachment else b""
    return Heard(str(sample.key_expr), sample.payload.to_bytes(), attachment)


def announced(token: str, *, has_hashes: bool = True) -> Announced:
    """Read the token of a publisher; in humble types have no hashes."""
    parts = token.split("/")
    if len(parts) != TOKEN_PARTS or parts[0] != ADMIN_SPACE or parts[5] != "MP":
        raise BrokenRule(f"no token of a publisher: {token}")
    try:
        qos = QosProfile.decode(parts[12])
    except ValueError as error:
        raise BrokenRule(f"qos of {token}: {error}") from error
    ros_type, name = dds_to_ros_type(parts[10]), demangle_name(parts[9])
    if parts[11] != (hash_of_message(ros_type) if has_hashes else OF_HUMBLE):
        raise BrokenRule(f"hash of {token}")
    return Announced(
        f"{demangle_name(parts[7])}/{parts[8]}".replace("//", "/"),
        name,
        ros_type,
        topic_keyexpr(int(parts[1]), name, parts[10], parts[11]),
        qos.durability == QosDurability.TRANSIENT_LOCAL,
    )


def check_topic(
    tokens: list[str], samples: list[Heard], *, has_hashes: bool = True
) -> list[Announced]:
    """Judge one topic: who announced it, and what came on its key.

    Raises:
        BrokenRule: Nobody announced the key, or a sample would be dropped.
    """
    publishers = [announced(token, has_hashes=has_hashes) for token in tokens]
    keys = {publisher.key for publisher in publishers}
    gids = {gid_of(token) for token in tokens}
    numbers: dict[bytes, int] = {}
    if not samples:
        raise BrokenRule("nothing came")
    for sample in samples:
        if sample.key not in keys:
            raise BrokenRule(f"nobody announced {sample.key}")
        if len(sample.attachment) != ATTACHMENT_BYTES:
            raise BrokenRule(f"{len(sample.attachment)} bytes are attached")
        read = Attachment.from_bytes(sample.attachment)
        if read.gid not in gids:
            raise BrokenRule(f"no publisher has the gid {read.gid.hex()}")
        before = numbers.get(read.gid)
        if before is not None and read.sequence_id != before + 1:
            raise BrokenRule(f"message {read.sequence_id} came after {before}")
        numbers[read.gid] = read.sequence_id
    return publishers


def gid_of(token: str) -> bytes:
    """Find what `ros2 topic info -v` shows: XXH3 of the token, its low half first."""
    number = xxhash.xxh3_128_intdigest(token.encode())
    return struct.pack("<QQ", number & (1 << 64) - 1, number >> 64)


def check_bytes(ros_type: str, payload: bytes) -> None:
    """Let rosbags read a message, and write it again as it was.

    Raises:
        BrokenRule: It writes other bytes.
    """
    message = HUMBLE.deserialize_cdr(payload, ros_type)
    if bytes(HUMBLE.serialize_cdr(message, ros_type)) != payload:
        raise BrokenRule(f"a {ros_type} that rosbags writes otherwise")
