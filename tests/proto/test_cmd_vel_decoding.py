"""Velocity commands, stamped or not, in every format."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import Format, MalformedPayload, encode, make_encoding
from zensim.proto.messages.standard_messages import (
    Accel,
    Header,
    Time,
    Twist,
    TwistStamped,
    Vector3,
)

TWIST = Twist(Vector3(0.5), Vector3(z=-0.25))
STAMPED = TwistStamped(Header(Time(1, 2), "base_link"), TWIST)
MESSAGES = [TWIST, STAMPED, TwistStamped(twist=TWIST)]


@pytest.mark.parametrize("format_", Format)
@pytest.mark.parametrize("message", MESSAGES, ids=["plain", "stamped", "stamped without frame"])
def test_decode_twist_reads_both_types_with_and_without_an_encoding(
    message: Twist | TwistStamped, format_: Format
) -> None:
    payload = encode(message, format_)

    assert decode_twist(payload, make_encoding(message, format_)) == TWIST
    assert decode_twist(payload, format_.value) == TWIST
    assert decode_twist(payload) == TWIST


@given(frame_id=st.text(st.characters(exclude_categories=["Cs"]), max_size=40))
def test_decode_twist_distinguishes_the_types_by_length(frame_id: str) -> None:
    payload = encode(TwistStamped(Header(frame_id=frame_id), TWIST), Format.CDR)

    assert decode_twist(payload) == TWIST


@pytest.mark.parametrize(
    ("text", "twist"),
    [
        (b"{}", Twist()),
        (b'{"linear": {"x": 1}}', Twist(Vector3(1.0))),
        (b'{"angular": {"z": 1}}', Twist(angular=Vector3(z=1.0))),
        (b'{"twist": {"linear": {"x": 1}}}', Twist(Vector3(1.0))),
        (b'{"header": {}, "twist": {"linear": {"x": 1}}}', Twist(Vector3(1.0))),
        (b'{"header": {"frame_id": "base_link"}}', Twist()),
    ],
)
def test_decode_twist_distinguishes_the_types_by_their_keys(text: bytes, twist: Twist) -> None:
    read = decode_twist(text)

    assert read == twist
    assert type(read) is Twist


def test_field_of_neither_type_is_refused() -> None:
    with pytest.raises(MalformedPayload, match="speed"):
        decode_twist(b'{"speed": 3}')


def test_decode_twist_reads_no_bytes_as_a_stop() -> None:
    assert decode_twist(b"") == Twist()


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("format_", [Format.CDR, Format.MSGPACK])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_decode_twist_refuses_numbers_that_are_not_finite(
    number: float, format_: Format, axis: str
) -> None:
    linear = encode(Twist(linear=Vector3(**{axis: number})), format_)
    angular = encode(TwistStamped(twist=Twist(angular=Vector3(**{axis: number}))), format_)

    for payload in (linear, angular):
        with pytest.raises(MalformedPayload):
            decode_twist(payload)


@pytest.mark.parametrize(
    "text", [b'{"linear": {"x": null}}', b'{"linear": 1}', b'{"twist": 1}', b'{"header": 1}']
)
def test_decode_twist_refuses_fields_of_another_type(text: bytes) -> None:
    with pytest.raises(MalformedPayload):
        decode_twist(text)


def test_decode_twist_refuses_an_encoding_that_names_another_type() -> None:
    payload, encoding = encode(Accel(), Format.CDR), make_encoding(Accel, Format.CDR)

    with pytest.raises(MalformedPayload, match="geometry_msgs/msg/Accel"):
        decode_twist(payload, encoding)


def test_decode_twist_refuses_a_twist_that_ends_early() -> None:
    payload = encode(TWIST, Format.CDR)[:-1]

    with pytest.raises(MalformedPayload):
        decode_twist(payload)


@given(payload=st.binary(max_size=120))
def test_decode_twist_reads_or_refuses_random_bytes(payload: bytes) -> None:
    for first in (b"", b"\x00\x01\x00\x00", b"\x82", b"{"):
        try:
            read = decode_twist(first + payload)
        except MalformedPayload:
            continue
        assert all(map(math.isfinite, (read.linear.x, read.angular.z)))
