"""CDR against an independent implementation, in both directions."""

import math
import tracemalloc
from contextlib import suppress

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from tests.proto.ros_oracle import knows, rewritten_by_ros, ros_bytes
from tests.proto.strategies import messages_of
from tests.proto.widest import Widest
from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_reader import MalformedPayload
from zensim.proto.messages.entity_messages import Bounds, GetEntitiesRequest, GetEntitiesResponse
from zensim.proto.messages.simulation_messages import (
    GetSimulationStateRequest,
    StepSimulationRequest,
)
from zensim.proto.messages.spawn_messages import (
    SpawnEntityOrder,
    SpawnEntityReport,
    SpawnEntityRequest,
    SpawnEntityResponse,
)
from zensim.proto.messages.standard_messages import (
    Clock,
    Header,
    JointState,
    Odometry,
    PoseWithCovariance,
    String,
    TFMessage,
    Time,
    TransformStamped,
    Twist,
    Vector3,
)
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import list_messages

HEADER = bytes.fromhex("00 01 00 00")
HUGE = b"\xff\xff\xff\xff"
EXAMPLE = cdr.encode(make_sample_message(Widest))
MIB = 1 << 20


def test_decode_reads_what_encode_wrote() -> None:
    assert cdr.decode(Widest, EXAMPLE) == make_sample_message(Widest)


@pytest.mark.parametrize("length", range(len(EXAMPLE)))
def test_decode_refuses_a_message_that_ends_early(length: int) -> None:
    with pytest.raises(MalformedPayload):
        cdr.decode(Widest, EXAMPLE[:length])


@given(place=st.integers(0, len(EXAMPLE) - 1), byte=st.integers(0, 255))
def test_decode_reads_or_refuses_when_a_byte_is_changed(place: int, byte: int) -> None:
    payload = EXAMPLE[:place] + bytes([byte]) + EXAMPLE[place + 1 :]

    with suppress(MalformedPayload):
        assert isinstance(cdr.decode(Widest, payload), Widest)


def test_decode_tolerates_an_empty_string_without_its_nul() -> None:
    assert cdr.decode(String, HEADER + bytes(4)) == String("")


@pytest.mark.parametrize(
    "text",
    [
        b"\x02\x00\x00\x00ab",
        b"\x03\x00\x00\x00\xff\xfe\x00",
        b"\x04\x00\x00\x00\xed\xa0\x80\x00",
        HUGE,
    ],
    ids=["no NUL", "not UTF-8", "surrogate", "length beyond the payload"],
)
def test_decode_refuses_a_bad_string(text: bytes) -> None:
    with pytest.raises(MalformedPayload):
        cdr.decode(String, HEADER + text)


def test_decode_refuses_a_boolean_that_is_neither_0_nor_1() -> None:
    payload = bytearray(cdr.encode(SpawnEntityRequest()))
    payload[9] = 2

    with pytest.raises(MalformedPayload, match="2"):
        cdr.decode(SpawnEntityRequest, bytes(payload))


@pytest.mark.parametrize(
    ("kind", "before"),
    [
        (GetEntitiesResponse, "01 00 00 00 00 00 00 00"),
        (GetEntitiesRequest, "00 00 00 00"),
        (JointState, "00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"),
    ],
    ids=["strings", "messages", "numbers"],
)
@pytest.mark.parametrize("count", [HUGE, b"\x00\x00\x00\x10"])
def test_decode_allocates_nothing_for_a_length_beyond_the_payload(
    kind: type[JointState], before: str, count: bytes
) -> None:
    payload = HEADER + bytes.fromhex(before) + count + bytes(100)
    tracemalloc.start()

    with pytest.raises(MalformedPayload):
        cdr.decode(kind, payload)

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MIB


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

    with pytest.raises(ValueError, match=f"Widest.{field}") as refusal:
        cdr.encode(message)

    assert repr(bad) in str(refusal.value)
    assert works in str(refusal.value)


def test_encode_names_a_value_that_does_not_fit_a_message_of_one_field() -> None:
    with pytest.raises(ValueError, match=r"StepSimulationRequest\.steps"):
        cdr.encode(StepSimulationRequest(steps=-1))


def test_encode_refuses_a_fixed_array_of_another_length() -> None:
    with pytest.raises(ValueError, match=r"PoseWithCovariance\.covariance.*36"):
        cdr.encode(PoseWithCovariance(covariance=(0.0, 1.0)))


def test_encode_truncates_a_long_value_in_its_error() -> None:
    with pytest.raises(ValueError, match=r"Bounds\.type") as refusal:
        cdr.encode(Bounds(type=10**500))

    assert len(str(refusal.value)) < 200


def test_encode_refuses_text_that_is_not_unicode() -> None:
    with pytest.raises(UnicodeEncodeError):
        cdr.encode(String("\ud800"))


EXPRESSIBLE = [
    pytest.param(kind, id=name)
    for name, kind in list_messages().items()
    if hasattr(kind, "ros_type") and cdr.is_expressible(kind)
]
LONGEST_NAME = 17
FEW = settings(max_examples=max(1, settings().max_examples // 10))


def ros_type_of(kind: type[msgspec.Struct]) -> str:
    return str(vars(kind).get("ros_type") or getattr(kind, "ros_type", ""))


def stamped(name_bytes: int) -> Odometry:
    return Odometry(Header(Time(1, 2), "f" * name_bytes), "c" * (name_bytes // 2))


@pytest.mark.parametrize("kind", EXPRESSIBLE)
def test_oracle_knows_every_type_that_cdr_expresses(kind: type[msgspec.Struct]) -> None:
    assert knows(ros_type_of(kind))


@pytest.mark.parametrize("kind", EXPRESSIBLE)
def test_encode_writes_what_ros_writes_for_the_example(kind: type[msgspec.Struct]) -> None:
    example = make_sample_message(kind)

    payload = cdr.encode(example)

    assert payload == ros_bytes(example, ros_type_of(kind))


@pytest.mark.parametrize("kind", EXPRESSIBLE)
@given(data=st.data())
@FEW
def test_encode_writes_what_ros_writes(kind: type[msgspec.Struct], data: st.DataObject) -> None:
    message = data.draw(messages_of(kind))

    payload = cdr.encode(message)

    assert payload == ros_bytes(message, ros_type_of(kind))
    assert payload == rewritten_by_ros(payload, ros_type_of(kind))


@pytest.mark.parametrize("kind", EXPRESSIBLE)
@pytest.mark.parametrize("little_endian", [True, False], ids=["little", "big"])
@given(data=st.data())
@FEW
def test_decode_reads_what_ros_writes(
    *, kind: type[msgspec.Struct], little_endian: bool, data: st.DataObject
) -> None:
    message = data.draw(messages_of(kind))
    payload = ros_bytes(message, ros_type_of(kind), little_endian=little_endian)

    read = cdr.decode(kind, payload)

    assert cdr.encode(read) == cdr.encode(message)
    assert type(read) is kind


@pytest.mark.parametrize("name_bytes", range(LONGEST_NAME))
def test_codec_aligns_after_a_name_of_any_length(name_bytes: int) -> None:
    message = stamped(name_bytes)

    payload = cdr.encode(message)

    assert payload == ros_bytes(message, Odometry.ros_type)
    assert cdr.decode(Odometry, payload) == message


@pytest.mark.parametrize("name_bytes", range(LONGEST_NAME))
def test_codec_aligns_each_item_of_a_sequence(name_bytes: int) -> None:
    items = [TransformStamped(child_frame_id="c" * (name_bytes + more)) for more in range(4)]
    message = TFMessage(tuple(items))

    payload = cdr.encode(message)

    assert payload == ros_bytes(message, TFMessage.ros_type)
    assert cdr.decode(TFMessage, payload) == message


def test_codec_keeps_numbers_that_are_not_finite() -> None:
    message = Twist(Vector3(math.inf, -math.inf, math.nan))

    payload = cdr.encode(message)

    assert payload == ros_bytes(message, Twist.ros_type)
    assert cdr.encode(cdr.decode(Twist, payload)) == payload


def test_encode_writes_one_byte_for_a_message_without_fields() -> None:
    payload = cdr.encode(GetSimulationStateRequest())

    assert payload == bytes.fromhex("00 01 00 00 00")
    assert cdr.decode(GetSimulationStateRequest, payload) == GetSimulationStateRequest()


def test_encode_omits_fields_of_a_subclass() -> None:
    order = SpawnEntityOrder(name="r1", snap_to_ground=True)
    report = SpawnEntityReport(entity_name="r1", entity_namespace="team/r1")

    assert cdr.encode(order) == cdr.encode(SpawnEntityRequest(name="r1"))
    assert cdr.encode(report) == cdr.encode(SpawnEntityResponse(entity_name="r1"))


def test_decode_gives_a_subclass_its_defaults() -> None:
    payload = cdr.encode(Clock(Time(3, 4)))

    read = cdr.decode(WorldClock, payload)

    assert read == WorldClock(Time(3, 4), step=0, epoch=0)


def test_decode_ignores_the_options_of_the_header() -> None:
    payload = bytes.fromhex("00 01 00 03") + cdr.encode(Twist())[4:]

    assert cdr.decode(Twist, payload) == Twist()


@pytest.mark.parametrize(
    "header", ["", "00 01 00", "00 02 00 00", "00 07 00 00", "01 00 00 00", "7b 7d 00 00"]
)
def test_decode_refuses_another_header(header: str) -> None:
    payload = bytes.fromhex(header) + bytes(48)

    with pytest.raises(MalformedPayload, match="00 01 00 00"):
        cdr.decode(Twist, payload if len(header) > 10 else payload[: len(header) // 3])


@pytest.mark.parametrize("padding", range(4))
def test_decode_tolerates_up_to_three_bytes_after_the_last_field(padding: int) -> None:
    payload = cdr.encode(Twist()) + bytes(padding)

    assert cdr.decode(Twist, payload) == Twist()


def test_decode_refuses_four_bytes_after_the_last_field() -> None:
    payload = cdr.encode(Twist()) + bytes(4)

    with pytest.raises(MalformedPayload, match=r"52.*56"):
        cdr.decode(Twist, payload)
