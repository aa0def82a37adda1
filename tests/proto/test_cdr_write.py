"""Writing every form of field, and what is said of a value that does not fit."""

import pytest
from hypothesis import given
from msgspec.structs import replace

from tests.proto.ros_oracle import ros_bytes
from tests.proto.strategies import messages_of
from tests.proto.widest import Widest
from zensim.proto import cdr
from zensim.proto.geometry import PoseWithCovariance
from zensim.proto.services import Bounds, StepSimulationRequest
from zensim.proto.topics import String


@given(message=messages_of(Widest))
def test_encode_writes_every_form_of_field_as_ros_does(message: Widest) -> None:
    payload = cdr.encode(message)

    assert payload == ros_bytes(message, Widest.ros_type)
    assert cdr.decode(Widest, payload) == message


@pytest.mark.parametrize(
    ("field", "value", "works"),
    [
        ("octet", 256, "an integer from 0 to 255"),
        ("tiny", -129, "an integer from -128 to 127"),
        ("wide", 2**64, "an integer from 0 to 18446744073709551615"),
        ("signed_wide", 2**63, "an integer from -9223372036854775808 to 9223372036854775807"),
        ("shorts", (1, 70000), "an integer from 0 to 65535"),
        ("many_shorts", (1, 70000), "an integer from 0 to 65535"),
        ("many_ratios", (1.0, 1e39), "a number of 32 bits"),
        ("ratio", 1e39, "a number of 32 bits"),
        ("number", "1.0", "a number of 64 bits"),
    ],
)
def test_encode_names_a_value_that_does_not_fit(field: str, value: object, works: str) -> None:
    message = replace(Widest(), **{field: value})
    bad = value[1] if isinstance(value, tuple) else value

    with pytest.raises(ValueError, match="does not fit") as refusal:
        cdr.encode(message)

    assert str(refusal.value) == f"Widest.{field} is {bad!r}, which does not fit; use {works}"


def test_encode_names_a_value_that_does_not_fit_a_message_of_one_field() -> None:
    with pytest.raises(ValueError, match=r"^StepSimulationRequest.steps is -1, which does not fit"):
        cdr.encode(StepSimulationRequest(steps=-1))


def test_encode_refuses_a_fixed_array_of_another_length() -> None:
    with pytest.raises(ValueError, match=r"^PoseWithCovariance.covariance has 2 numbers; use 36$"):
        cdr.encode(PoseWithCovariance(covariance=(0.0, 1.0)))


def test_encode_clips_a_long_value_in_what_it_says() -> None:
    with pytest.raises(ValueError, match="does not fit") as refusal:
        cdr.encode(Bounds(type=10**500))

    assert len(str(refusal.value)) < 200


def test_encode_refuses_text_that_is_not_unicode() -> None:
    with pytest.raises(ValueError, match="surrogates not allowed"):
        cdr.encode(String("\ud800"))
