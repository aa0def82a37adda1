"""Sample messages: filled, valid and the same on every run."""

from datetime import timedelta

import msgspec
import pytest

from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.agent_messages import Claim, ClaimEntityRequest, DriveState
from zensim.proto.messages.standard_messages import Header, PoseWithCovariance, Time
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import list_messages


@pytest.mark.parametrize("kind", list_messages().values(), ids=list_messages().keys())
def test_example_is_a_valid_message_and_always_the_same(kind: type[msgspec.Struct]) -> None:
    example = make_sample_message(kind)

    assert example == make_sample_message(kind)
    assert decode(kind, encode(example, Format.MSGPACK)) == example
    assert decode(kind, encode(example, Format.JSON)) == example


def test_example_fills_fields_with_values_that_differ() -> None:
    assert make_sample_message(Header) == Header(Time(1, 2), "frame_id")


def test_example_fills_every_kind_of_field() -> None:
    covariance = make_sample_message(PoseWithCovariance).covariance

    assert len(set(covariance)) == len(covariance) == 36
    assert make_sample_message(ClaimEntityRequest).entities == ("entities_0", "entities_1")
    assert make_sample_message(ClaimEntityRequest).on_release in {"stop", "keep", "delete"}
    assert make_sample_message(DriveState).claims == b"\x04\x05"
    assert make_sample_message(Claim).model.drive is not None
    assert set(make_sample_message(Stats).ready_s) == {"ready_s_0", "ready_s_1"}


def test_sample_refuses_a_field_of_unknown_type() -> None:
    class Odd(msgspec.Struct):
        when: timedelta

    with pytest.raises(TypeError, match="'when'"):
        make_sample_message(Odd)
