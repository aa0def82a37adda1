"""Examples of messages: filled, valid and the same on every run."""

from datetime import timedelta

import msgspec
import pytest

from zensim.proto.claims import Claim, ClaimEntityRequest, DriveState
from zensim.proto.codec import Format, decode, encode
from zensim.proto.example import example_of
from zensim.proto.geometry import PoseWithCovariance
from zensim.proto.header import Header, Time
from zensim.proto.schema import messages
from zensim.proto.telemetry import Stats


@pytest.mark.parametrize("kind", messages().values(), ids=messages().keys())
def test_example_is_a_valid_message_and_always_the_same(kind: type[msgspec.Struct]) -> None:
    example = example_of(kind)

    assert example == example_of(kind)
    assert decode(kind, encode(example, Format.MSGPACK)) == example
    assert decode(kind, encode(example, Format.JSON)) == example


def test_example_fills_fields_with_values_that_differ() -> None:
    assert example_of(Header) == Header(Time(1, 2), "frame_id")


def test_example_fills_every_kind_of_field() -> None:
    covariance = example_of(PoseWithCovariance).covariance

    assert len(set(covariance)) == len(covariance) == 36
    assert example_of(ClaimEntityRequest).entities == ("entities_0", "entities_1")
    assert example_of(ClaimEntityRequest).on_release in {"stop", "keep", "delete"}
    assert example_of(DriveState).claims == b"\x04\x05"
    assert example_of(Claim).model.drive is not None
    assert set(example_of(Stats).ready_s) == {"ready_s_0", "ready_s_1"}


def test_example_says_when_it_cannot_fill_a_field() -> None:
    class Odd(msgspec.Struct):
        when: timedelta

    with pytest.raises(
        TypeError, match=r"field 'when' is a TimeDeltaType; say in proto.example"
    ):
        example_of(Odd)
