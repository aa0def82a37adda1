"""CDR against an independent implementation, in both directions."""

import math

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.proto.ros_oracle import knows, rewritten_by_ros, ros_bytes
from tests.proto.strategies import messages_of
from zensim.proto import cdr
from zensim.proto.cdr_read import MalformedPayload
from zensim.proto.example import example_of
from zensim.proto.geometry import TransformStamped, Twist, Vector3
from zensim.proto.header import Header, Time
from zensim.proto.schema import messages
from zensim.proto.services import (
    GetSimulationStateRequest,
    SpawnEntityOrder,
    SpawnEntityReport,
    SpawnEntityRequest,
    SpawnEntityResponse,
)
from zensim.proto.telemetry import WorldClock
from zensim.proto.topics import Clock, Odometry, TFMessage

EXPRESSIBLE = [
    pytest.param(kind, id=name)
    for name, kind in messages().items()
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
    example = example_of(kind)

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


def test_encode_leaves_out_what_a_subclass_adds() -> None:
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

    with pytest.raises(MalformedPayload, match="use '00 01 00 00'"):
        cdr.decode(Twist, payload if len(header) > 10 else payload[: len(header) // 3])


@pytest.mark.parametrize("padding", range(4))
def test_decode_tolerates_up_to_three_bytes_after_the_last_field(padding: int) -> None:
    payload = cdr.encode(Twist()) + bytes(padding)

    assert cdr.decode(Twist, payload) == Twist()


def test_decode_refuses_four_bytes_after_the_last_field() -> None:
    payload = cdr.encode(Twist()) + bytes(4)

    with pytest.raises(MalformedPayload, match=r"last field ends at byte 52, .* has 56 bytes"):
        cdr.decode(Twist, payload)
