"""What a robot may be told on cmd_vel: a Twist or a TwistStamped, in any format."""

from math import isfinite

from msgspec import UNSET, UnsetType

from zensim.proto.codec import Format, MalformedPayload, decode, format_of, schema_of
from zensim.proto.geometry import Twist, TwistStamped
from zensim.proto.header import Header

LEAST_STAMPED_BYTES = 68
"""CDR of a TwistStamped without frame_id; that of a Twist is 52."""


class _EitherTwist(Twist, frozen=True):
    """The keys of both types; a stamped one tells itself by its own."""

    header: Header | UnsetType = UNSET
    twist: Twist | UnsetType = UNSET


def decode_twist(payload: bytes, encoding: str = "") -> Twist:
    """Read a velocity command, stamped or not.

    CDR without a type in its Encoding is told by its length, MessagePack and JSON by the keys
    `header` and `twist`.

    Raises:
        MalformedPayload: It is neither, or a number is NaN or infinite.
    """
    if format_of(payload, encoding) is Format.CDR:
        twist = _from_cdr(payload, encoding)
    else:
        twist = _from_keys(payload, encoding)
    linear, angular = twist.linear, twist.angular
    numbers = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    if all(map(isfinite, numbers)):
        return twist
    raise MalformedPayload(f"not a velocity command: a number is not finite in {numbers}")


def _from_cdr(payload: bytes, encoding: str) -> Twist:
    schema = schema_of(encoding)
    is_stamped = schema == TwistStamped.ros_type or (
        not schema and len(payload) >= LEAST_STAMPED_BYTES
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
