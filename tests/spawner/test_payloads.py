"""Any payload becomes plain values that can be printed, or words that say why not."""

import json
import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.sim_server.fakes import floats
from zensim.proto.bus import Sample
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.standard_messages import Odometry, String, Twist, Vector3
from zensim.proto.messages.telemetry_messages import Event, Snapshot, Stats, WorldClock
from zensim.spawner.payloads import as_lines, as_plain

ENCODINGS = [
    "",
    "application/cdr",
    "application/cdr;nav_msgs/msg/Odometry",
    "application/cdr;x/y",
    "application/json",
    "application/msgpack",
]
KEYS = ["r1/odom", "sim/default/snapshot", "sim/default/drive/a/command", "sim/x", ""]


def a_sample(message: msgspec.Struct, format_: Format, key: str = "r1/topic") -> Sample:
    return Sample(key, encode(message, format_), make_encoding(message, format_))


def lines_of(plain: object) -> list[str]:
    return list(as_lines(plain))


def test_cdr_is_read_by_the_type_of_its_encoding() -> None:
    plain = as_plain(a_sample(Twist(Vector3(x=0.5)), Format.CDR))

    assert plain == {
        "linear": {"x": 0.5, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
    }


def test_cdr_of_unknown_type_is_said_in_words() -> None:
    plain = as_plain(
        Sample("r1/scan", b"\0\1\0\0abcd", "application/cdr;sensor_msgs/msg/LaserScan")
    )

    assert isinstance(plain, str)
    assert plain.startswith("8 bytes that cannot be read: CDR of unknown type")
    assert "LaserScan" in plain


@pytest.mark.parametrize("format_", [Format.MSGPACK, Format.JSON])
@pytest.mark.parametrize("message", [WorldClock(step=3), Event("spawned", "r1"), Stats(world="w")])
def test_telemetry_is_read_by_its_key(message: msgspec.Struct, format_: Format) -> None:
    topic = {WorldClock: "clock", Event: "events", Stats: "stats"}[type(message)]

    plain = as_plain(a_sample(message, format_, f"sim/w/{topic}"))

    assert plain == msgspec.to_builtins(message)


def test_arrays_are_told_as_numbers() -> None:
    snapshot = Snapshot(1, 2, 3, 4, ("r",), floats([1.0, 2.0]), floats([0.5]))
    command = DriveCommand(1, 2, b"\1\0\0\0\2\0\0\0", floats([3.0]))

    told = as_plain(a_sample(snapshot, Format.MSGPACK, "sim/w/snapshot"))
    taken = as_plain(a_sample(command, Format.MSGPACK, "sim/w/drive/a/command"))

    assert isinstance(told, dict)
    assert isinstance(taken, dict)
    assert (told["base"], told["joint_positions"]) == ([1.0, 2.0], [0.5])
    assert (taken["claims"], taken["targets"]) == ([1, 2], [3.0])


@pytest.mark.parametrize("field", ["base", "joint_positions"])
def test_arrays_of_an_odd_length_are_said_in_words(field: str) -> None:
    snapshot = Snapshot(1, 2, 3, 4, (), b"", b"")
    broken = msgspec.structs.replace(snapshot, **{field: b"12345"})

    plain = as_plain(a_sample(broken, Format.MSGPACK, "sim/w/snapshot"))

    assert isinstance(plain, str)
    assert "cannot be read" in plain


def test_json_of_any_kind_is_read() -> None:
    assert as_plain(Sample("a/b", b'{"n": [1, null]}', "")) == {"n": [1, None]}


def test_lines_are_laid_out_as_yaml() -> None:
    plain = {
        "name": "r1",
        "pose": {"x": 1.0, "frames": []},
        "numbers": [1, 2.5],
        "links": [{"a": True}, "text"],
        "none": None,
        "empty": {},
    }

    assert lines_of(plain) == [
        'name: "r1"',
        "pose:",
        "  x: 1",
        "  frames: []",
        "numbers: [1, 2.5]",
        "links:",
        "  -",
        "    a: true",
        '  - "text"',
        "none: null",
        "empty: {}",
    ]


@pytest.mark.parametrize(
    ("number", "shown"),
    [(math.inf, ".Inf"), (-math.inf, "-.Inf"), (math.nan, ".nan"), (1e-9, "1e-09"), (0.1, "0.1")],
)
def test_lines_tell_numbers_as_yaml_does(number: float, shown: str) -> None:
    assert lines_of({"x": number}) == [f"x: {shown}"]


def test_lines_quote_text_that_would_be_read_as_something_else() -> None:
    assert lines_of({"a": "true", "b": "x: y\nz"}) == ['a: "true"', 'b: "x: y\\nz"']


def test_odometry_and_text_are_laid_out() -> None:
    odometry = as_plain(a_sample(Odometry(), Format.CDR))
    text = as_plain(a_sample(String("hello"), Format.CDR))

    assert "pose:" in lines_of(odometry)
    assert lines_of(text) == ['data: "hello"']


@given(
    payload=st.one_of(
        st.binary(max_size=60),
        st.binary(max_size=60).map(lambda tail: b"\x81\xa1a" + tail),
        st.binary(max_size=60).map(lambda tail: b"\x87" + tail),
        st.binary(max_size=60).map(lambda tail: b"{" + tail),
        st.binary(max_size=60).map(lambda tail: b"\0\1\0\0" + tail),
        st.recursive(st.integers() | st.floats(), st.lists).map(
            lambda value: json.dumps({"v": value}).encode()
        ),
    ),
    encoding=st.sampled_from(ENCODINGS),
    key=st.sampled_from(KEYS),
)
def test_any_bytes_can_be_printed(payload: bytes, encoding: str, key: str) -> None:
    plain = as_plain(Sample(key, payload, encoding))

    assert all(isinstance(line, str) for line in as_lines(plain))
    assert msgspec.json.encode({"message": plain})


@pytest.mark.parametrize(
    "payload",
    [
        b'{"a":' * 100_000,
        b"\x81\xa1a" * 100_000,
        b"\x81\xa1a\xd4\x05\x00",  # an extension type
        b"\x81\xa1a\xd6\xff\x00\x00\x00\x00",  # a moment
        b"\x81\xc2\xc3",  # a boolean as a key
        b"\x81\x90\xc3",  # a list as a key
        b"\x81\xa1a\xc4\x02\xff\xfe",  # raw bytes
        b'{"a": 1e999, "b": 123456789012345678901234567890}',
        b'{"a":' * 400 + b"1" + b"}" * 400,
    ],
    ids=range(9),
)
@pytest.mark.parametrize("key", ["a/b", "sim/w/stats"])
def test_odd_bytes_can_be_printed(payload: bytes, key: str) -> None:
    plain = as_plain(Sample(key, payload, ""))

    assert lines_of(plain)
    assert msgspec.json.encode({"message": plain})
