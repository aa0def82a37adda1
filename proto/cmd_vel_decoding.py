"""Decode cmd_vel payloads: a Twist or a TwistStamped, in any format."""

from math import isfinite

from msgspec import UNSET, UnsetType

from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    detect_format,
    parse_schema_name,
)
from zensim.proto.messages.standard_messages import Header, Twist, TwistStamped

MIN_STAMPED_BYTES = 68
"""CDR size of a TwistStamped without frame_id; a Twist has 52 bytes."""


class _EitherTwist(Twist, frozen=True):
    """Union of the fields of both types."""

    header: Header | UnsetType = UNSET
    twist: Twist | UnsetType = UNSET


def decode_twist(payload: bytes, encoding: str = "") -> Twist:
    """Read a velocity command, stamped or not.

    CDR without a type in its Encoding is distinguished by its length, MessagePack and JSON by the
    keys `header` and `twist`.

    Raises:
        MalformedPayload: It is neither type, or a number is NaN or infinite.
    """
    if detect_format(payload, encoding) is Format.CDR:
        twist = _from_cdr(payload, encoding)
    else:
        twist = _from_keys(payload, encoding)
    linear, angular = twist.linear, twist.angular
    numbers = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    if all(map(isfinite, numbers)):
        return twist
    raise MalformedPayload(f"not a velocity command: a number is not finite in {numbers}")


def _from_cdr(payload: bytes, encoding: str) -> Twist:
    schema = parse_schema_name(encoding)
    is_stamped = schema == TwistStamped.ros_type or (
        not schema and len(payload) >= MIN_STAMPED_BYTES
    )
    if is_stamped:
        return decode(TwistStamped, payload, encoding).twist
    return decode(Twist, payload, encoding)


def _from_keys(payload: bytes, encoding: str) -> Twist:
    either = decode(_EitherTwist, payload, encoding)
    if either.twist is not UNSET:
        return either.twist
    if either.header is not UNSET:
        return Twist()
    return Twist(either.linear, either.angular)
