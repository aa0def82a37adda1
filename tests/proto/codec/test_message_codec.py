"""Formats: detection, round trips and errors."""

import math
import subprocess
import sys
from itertools import permutations

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.proto.strategies import messages_of
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    detect_format,
    encode,
    make_encoding,
    parse_schema_name,
    supports_format,
)
from zensim.proto.messages.agent_messages import ClaimEntityRequest, DriveState
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import (
    GetSimulationStateRequest,
    StepSimulationRequest,
)
from zensim.proto.messages.spawn_messages import SpawnEntityReport
from zensim.proto.messages.standard_messages import Point, String, Twist, Vector3
from zensim.proto.schema import list_top_level_types

TWIST = Twist(Vector3(0.5), Vector3(z=-0.25))
SPOKEN = [pytest.param(kind, id=kind.__name__) for kind in list_top_level_types()]
SELF_DESCRIBING = [Format.MSGPACK, Format.JSON]
FEW = settings(max_examples=max(1, settings().max_examples // 10))


@pytest.mark.parametrize("format_", Format)
def test_decode_reads_what_encode_wrote(format_: Format) -> None:
    payload = encode(TWIST, format_)

    assert decode(Twist, payload) == TWIST
    assert decode(Twist, payload, make_encoding(TWIST, format_)) == TWIST
    assert decode(Twist, payload, "zenoh/bytes") == TWIST


@pytest.mark.parametrize("kind", SPOKEN)
@given(data=st.data())
@FEW
def test_self_describing_formats_give_back_every_message(
    kind: type[msgspec.Struct], data: st.DataObject
) -> None:
    message = data.draw(messages_of(kind))

    for format_ in SELF_DESCRIBING:
        assert decode(kind, encode(message, format_)) == message


@pytest.mark.parametrize(
    ("payload", "format_"),
    [
        (b"\x00\x01\x00\x00", Format.CDR),
        (b"\x80", Format.MSGPACK),
        (b"\x8f", Format.MSGPACK),
        (b"\xde\x00\x00", Format.MSGPACK),
        (b"\xdf\x00\x00\x00\x00", Format.MSGPACK),
        (b"{}", Format.JSON),
        (b"\r\n\t {}", Format.JSON),
        (b"", Format.MSGPACK),
    ],
)
@pytest.mark.parametrize("encoding", ["", "zenoh/bytes", "zenoh/string", "video/h264"])
def test_format_is_detected_by_the_first_byte_without_an_encoding(
    payload: bytes, format_: Format, encoding: str
) -> None:
    assert detect_format(payload, encoding) is format_


@pytest.mark.parametrize(
    ("encoding", "format_"),
    [
        ("application/cdr;geometry_msgs/msg/Twist", Format.CDR),
        ("application/cdr", Format.CDR),
        ("application/msgpack", Format.MSGPACK),
        ("application/json", Format.JSON),
        ("application/json;charset=utf-8", Format.JSON),
        ("text/json", Format.JSON),
    ],
)
def test_format_is_detected_by_the_encoding(encoding: str, format_: Format) -> None:
    payload = encode(TWIST, format_)

    assert detect_format(payload, encoding) is format_
    assert detect_format(b"", encoding) is format_
    assert decode(Twist, payload, encoding) == TWIST


@pytest.mark.parametrize(("declared", "actual"), [*permutations(Format, 2)])
def test_decode_refuses_bytes_of_another_format_than_the_encoding(
    declared: Format, actual: Format
) -> None:
    payload, encoding = encode(TWIST, actual), make_encoding(TWIST, declared)

    with pytest.raises(MalformedPayload, match=rf"{declared.value}.*{actual.name}"):
        decode(Twist, payload, encoding)


@pytest.mark.parametrize("first", [0x01, 0x31, 0x5B, 0x7F, 0x90, 0xC0, 0xFF])
def test_decode_refuses_bytes_that_begin_no_message(first: int) -> None:
    with pytest.raises(MalformedPayload, match=f"0x{first:02x}"):
        decode(Twist, bytes([first]), "")


def test_decode_refuses_cdr_whose_encoding_names_another_type() -> None:
    payload = encode(TWIST, Format.CDR)

    with pytest.raises(MalformedPayload, match="geometry_msgs/msg/Accel"):
        decode(Twist, payload, "application/cdr;geometry_msgs/msg/Accel")


def test_decode_refuses_cdr_of_an_inexpressible_type() -> None:
    with pytest.raises(MalformedPayload):
        decode(ClaimEntityRequest, b"\x00\x01\x00\x00")


def test_encode_refuses_cdr_of_an_inexpressible_type() -> None:
    with pytest.raises(TypeError, match="ClaimEntityRequest"):
        encode(ClaimEntityRequest(), Format.CDR)


def test_supports_format_is_false_for_cdr_of_inexpressible_types() -> None:
    assert supports_format(Twist, Format.CDR)
    assert not supports_format(Model, Format.CDR)
    assert all(supports_format(Model, format_) for format_ in SELF_DESCRIBING)


def test_encoding_names_the_ros_type_of_cdr() -> None:
    assert make_encoding(TWIST, Format.CDR) == "application/cdr;geometry_msgs/msg/Twist"
    assert make_encoding(Twist, Format.CDR) == make_encoding(TWIST, Format.CDR)
    assert make_encoding(SpawnEntityReport, Format.CDR).endswith(";" + SpawnEntityReport.ros_type)
    assert make_encoding(TWIST, Format.MSGPACK) == "application/msgpack"
    assert make_encoding(TWIST, Format.JSON) == "application/json"


def test_schema_is_the_ros_type_that_an_encoding_of_cdr_names() -> None:
    assert parse_schema_name("application/cdr;geometry_msgs/msg/Twist") == Twist.ros_type
    assert parse_schema_name("application/cdr") == ""
    assert parse_schema_name("application/json;charset=utf-8") == ""


@pytest.mark.parametrize("encoding", ["", "application/cdr", "application/json"])
def test_decode_reads_no_bytes_as_all_defaults(encoding: str) -> None:
    assert decode(GetSimulationStateRequest, b"", encoding) == GetSimulationStateRequest()


def test_decode_refuses_no_bytes_when_a_field_has_no_default() -> None:
    with pytest.raises(MalformedPayload):
        decode(DriveState, b"")


def test_decode_accepts_integers_for_numbers() -> None:
    assert decode(Point, b'{"x": 1, "y": -2}') == Point(1.0, -2.0)
    assert decode(Point, b"\x81\xa1x\x01") == Point(1.0)


def test_decode_ignores_unknown_fields_of_programs_and_refuses_those_of_people() -> None:
    assert decode(Point, b"\x82\xa1x\x01\xa6colour\x02") == Point(1.0)
    with pytest.raises(MalformedPayload, match="unknown field `colour`"):
        decode(Point, b'{"x": 1, "colour": {"r": [1]}}')


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_json_has_null_for_a_number_that_is_not_finite(number: float) -> None:
    payload = encode(Point(number), Format.JSON)

    assert payload == b'{"x":null,"y":0.0,"z":0.0}'
    with pytest.raises(MalformedPayload):
        decode(Point, payload)


@pytest.mark.parametrize(
    ("payload", "field"),
    [
        (b"{", ""),
        (b"{} {}", ""),
        (b'{"x": 1e999}', "\\$.x"),
        (b'{"x": "1"}', "\\$.x"),
        (b'{"x":\n\x00}', ""),
        (b"\x81\xa1x", ""),
        (b"\x81\xa1x\xa1a", "\\$.x"),
    ],
)
def test_decode_names_the_type_and_the_wrong_field(payload: bytes, field: str) -> None:
    with pytest.raises(MalformedPayload, match=f"geometry_msgs/msg/Point.*{field}"):
        decode(Point, payload)


@pytest.mark.parametrize("payload", [b'{"data":"\xff"}', b"\x81\xa4data\xa1\xff"])
def test_decode_refuses_text_that_is_not_utf_8(payload: bytes) -> None:
    with pytest.raises(MalformedPayload, match="0xff"):
        decode(String, payload)


def test_decode_error_is_one_line_of_bounded_length() -> None:
    payload = b'{"agent": "a", "on_release": "' + b"\\n" * 5000 + b'"}'

    with pytest.raises(MalformedPayload) as refusal:
        decode(ClaimEntityRequest, payload)

    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 300


def test_decode_refuses_integers_beyond_64_bits() -> None:
    assert decode(StepSimulationRequest, b'{"steps": 18446744073709551615}').steps == 2**64 - 1

    with pytest.raises(MalformedPayload):
        decode(StepSimulationRequest, b'{"steps": 18446744073709551616}')


@pytest.mark.parametrize("format_", [Format.CDR, Format.MSGPACK])
def test_encode_refuses_integers_beyond_64_bits(format_: Format) -> None:
    with pytest.raises(ValueError, match="StepSimulation"):
        encode(StepSimulationRequest(steps=2**64), format_)


def test_fields_of_a_subclass_are_in_all_formats_but_cdr() -> None:
    report = SpawnEntityReport(entity_name="r1", entity_namespace="team/r1")

    assert decode(SpawnEntityReport, encode(report, Format.MSGPACK)) == report
    assert decode(SpawnEntityReport, encode(report, Format.CDR)).entity_namespace == ""


TWO_THREADS = """
import sys
import threading
import msgspec
from zensim.proto.codec.message_codec import decode

def read(message_type):
    number = decode(message_type, msgspec.msgpack.encode({"inner": {"number": 1}})).inner.number
    sys.stdout.write(f"{number}\\n")  # in one piece, as both threads write

def read_in_another_thread():
    other = threading.Thread(target=read, args=(Other,))
    other.start()
    other.join(0.3)
    return int

class Inner(msgspec.Struct):
    number: "read_in_another_thread()"

class Outer(msgspec.Struct):
    inner: Inner

class Other(msgspec.Struct):
    inner: Inner

read(Outer)
"""


def test_two_threads_may_decode_a_type_for_the_first_time() -> None:
    done = subprocess.run(
        [sys.executable, "-c", TWO_THREADS], capture_output=True, text=True, timeout=60, check=False
    )

    assert (done.returncode, done.stdout) == (0, "1\n1\n")
