"""Rules of rmw_zenoh for publishers, checked with an independent implementation.

rmw_zenoh drops samples with an invalid attachment, and ignores malformed tokens;
the key of data consists of the endpoint's name, type and hash.
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
    """A message or token that rmw_zenoh would reject; the text begins with a code."""


@dataclass(frozen=True)
class ReceivedSample:
    """A received sample."""

    key: str
    payload: bytes
    attachment: bytes


@dataclass(frozen=True)
class PublisherToken:
    """A publisher, described by its token."""

    node: str
    name: str
    ros_type: str
    key: str
    is_latched: bool


def to_received_sample(sample: zenoh.Sample) -> ReceivedSample:
    attachment = sample.attachment.to_bytes() if sample.attachment else b""
    return ReceivedSample(str(sample.key_expr), sample.payload.to_bytes(), attachment)


def parse_publisher_token(token: str, *, has_hashes: bool = True) -> PublisherToken:
    """Parse the token of a publisher; humble has no type hashes."""
    parts = token.split("/")
    if len(parts) != TOKEN_PARTS or parts[0] != ADMIN_SPACE or parts[5] != "MP":
        raise BrokenRule(f"invalid_token {token}")
    try:
        qos = QosProfile.decode(parts[12])
    except ValueError as error:
        raise BrokenRule(f"qos {token}: {error}") from error
    ros_type, name = dds_to_ros_type(parts[10]), demangle_name(parts[9])
    if parts[11] != (hash_of_message(ros_type) if has_hashes else OF_HUMBLE):
        raise BrokenRule(f"hash {token}")
    return PublisherToken(
        f"{demangle_name(parts[7])}/{parts[8]}".replace("//", "/"),
        name,
        ros_type,
        topic_keyexpr(int(parts[1]), name, parts[10], parts[11]),
        qos.durability == QosDurability.TRANSIENT_LOCAL,
    )


def check_topic(
    tokens: list[str], samples: list[ReceivedSample], *, has_hashes: bool = True
) -> list[PublisherToken]:
    """Check the publishers of a topic, and the samples on its key.

    Raises:
        BrokenRule: The key has no publisher, or a sample would be dropped.
    """
    publishers = [parse_publisher_token(token, has_hashes=has_hashes) for token in tokens]
    keys = {publisher.key for publisher in publishers}
    gids = {gid_of(token) for token in tokens}
    numbers: dict[bytes, int] = {}
    if not samples:
        raise BrokenRule("no_samples")
    for sample in samples:
        if sample.key not in keys:
            raise BrokenRule(f"unknown_key {sample.key}")
        if len(sample.attachment) != ATTACHMENT_BYTES:
            raise BrokenRule(f"attachment_size {len(sample.attachment)}")
        read = Attachment.from_bytes(sample.attachment)
        if read.gid not in gids:
            raise BrokenRule(f"unknown_gid {read.gid.hex()}")
        before = numbers.get(read.gid)
        if before is not None and read.sequence_id != before + 1:
            raise BrokenRule(f"sequence {read.sequence_id} after {before}")
        numbers[read.gid] = read.sequence_id
    return publishers


def gid_of(token: str) -> bytes:
    """Compute the gid shown by `ros2 topic info -v`: XXH3 of the token, low half first."""
    number = xxhash.xxh3_128_intdigest(token.encode())
    return struct.pack("<QQ", number & (1 << 64) - 1, number >> 64)


def check_bytes(ros_type: str, payload: bytes) -> None:
    """Check that rosbags decodes a message and encodes it to the same bytes.

    Raises:
        BrokenRule: The bytes differ.
    """
    message = HUMBLE.deserialize_cdr(payload, ros_type)
    if bytes(HUMBLE.serialize_cdr(message, ros_type)) != payload:
        raise BrokenRule(f"rosbags_bytes {ros_type}")
