"""Transforms of all robots in one message, without decoding them. Pure."""

import struct
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Final

from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.messages.standard_messages import TFMessage

LITTLE_ENDIAN: Final = b"\0\1\0\0"
"""Header of CDR; offsets of fields count from behind it."""
HEADER_BYTES: Final = len(LITTLE_ENDIAN)
STAMP_BYTES: Final = 8
TRANSFORM_BYTES: Final = 7 * 8
MOST_NAME_BYTES: Final = 1024
_COUNT: Final = struct.Struct("<I")


Transform = tuple[bytes, bytes]
"""Stamp and names of a transform, and its numbers."""


def collect_transforms(payloads: Iterable[bytes]) -> list[Transform]:
    """List the transforms of messages in CDR; malformed ones are left out."""
    found: list[Transform] = []
    for payload in payloads:
        with suppress(struct.error, MalformedPayload):
            found += list_transforms(_to_little_endian(payload))
    return found


def join_transforms(transforms: Sequence[Transform]) -> bytes:
    """Make a TFMessage in little-endian CDR."""
    body = bytearray(LITTLE_ENDIAN + _COUNT.pack(len(transforms)))
    for names, numbers in transforms:
        body += names
        body += b"\0" * (-(len(body) - HEADER_BYTES) % 8)
        body += numbers
    return bytes(body)


def list_transforms(payload: bytes) -> list[Transform]:
    """Split a TFMessage in little-endian CDR: stamp and names, then numbers, of each transform.

    Raises:
        MalformedPayload: It ends too early.
        struct.error: The same.
    """
    (count,) = _COUNT.unpack_from(payload, HEADER_BYTES)
    found = []
    start = HEADER_BYTES + _COUNT.size
    for _ in range(count):
        end = _skip_text(payload, start + STAMP_BYTES)
        end = _skip_text(payload, end)
        numbers = end + (-(end - HEADER_BYTES) % 8)
        after = numbers + TRANSFORM_BYTES
        if after > len(payload):
            raise MalformedPayload("not tf2_msgs/msg/TFMessage in CDR: it ends too early")
        # The next stamp is at a multiple of four, as the numbers end at one of eight.
        found.append((payload[start:end], payload[numbers:after]))
        start = after
    return found


def prefix_frames(names: bytes, prefix: bytes) -> bytes:
    """Prefix both frames of a transform, behind its stamp, unless they start with it.

    Args:
        names: Two texts of CDR, the first at a multiple of four.
        prefix: Such as `r1/`.
    """
    made = bytearray()
    start = 0
    for _ in range(2):
        start += -start % 4
        (length,) = _COUNT.unpack_from(names, start)
        text = names[start + _COUNT.size : start + _COUNT.size + length]
        start += _COUNT.size + length
        text = text if text.startswith(prefix) else prefix + text
        made += b"\0" * (-len(made) % 4) + _COUNT.pack(len(text)) + text
    return bytes(made)


def make_transform(parent: str, child: str, pose: Sequence[float]) -> Transform:
    """Make a transform stamped 0.

    Args:
        parent: Frame.
        child: Frame.
        pose: x y z [m], then the quaternion x y z w.
    """
    texts = bytearray(b"\0" * STAMP_BYTES)
    for frame in (parent, child):
        text = frame.encode() + b"\0"
        texts += b"\0" * (-len(texts) % 4) + _COUNT.pack(len(text)) + text
    return bytes(texts), struct.pack("<7d", *pose)


def _skip_text(payload: bytes, start: int) -> int:
    start += -start % 4
    (length,) = _COUNT.unpack_from(payload, start)
    if length > MOST_NAME_BYTES:
        raise MalformedPayload("not tf2_msgs/msg/TFMessage in CDR: a name is too long")
    return start + _COUNT.size + int(length)


def _to_little_endian(payload: bytes) -> bytes:
    if payload[:2] == LITTLE_ENDIAN[:2]:
        return payload
    return encode(decode(TFMessage, payload), Format.CDR)
