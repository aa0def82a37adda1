"""`zensim drive`, `echo` and `hz`, and the decoding of payloads."""

import json
import math
import subprocess
import threading

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.deploy.cli.commands import NOWHERE, assert_failed, run, run_at
from tests.integration.processes import Server, eventually, running
from tests.sim_server.fakes import floats
from zensim.deploy.cli.driven_robots import wait_for_subscriber
from zensim.deploy.cli.topic_commands import app, to_plain, to_yaml_lines
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Odometry, String, Twist, Vector3
from zensim.proto.messages.telemetry_messages import Event, Snapshot, Stats, WorldClock
from zensim.proto.network_protocols import Sample

CRATE = """<robot name="crate"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>"""
FORWARD = Twist(Vector3(x=0.2), Vector3(z=-0.5))


def drive_and_receive(
    server: Server, *arguments: str, key: str = "r1/cmd_vel", least: int = 1
) -> list[Twist]:
    """Drive with a subscriber, and return the received commands, of which some come late."""
    subscription = server.bus.subscribe(key, 1000)
    found: list[Twist] = []

    def has_enough() -> bool:
        found.extend(decode(Twist, one.payload, one.encoding) for one in subscription.take())
        return len(found) >= least

    try:
        done = run_at(server, app, "drive", *arguments)
        assert done.status == ExitCode.OK
        eventually(has_enough, 20.0, "the commands")
    finally:
        subscription.close()
    return found


def test_drive_once_publishes_one_command(server: Server) -> None:
    assert drive_and_receive(server, "r1", "0.2", "-0.5", "--once") == [FORWARD]


def test_drive_publishes_for_a_duration_and_stops_the_robot(server: Server) -> None:
    options = ("--rate", "50", "--duration", "0.2")
    received = drive_and_receive(server, "r1", "0.2", "-0.5", *options, least=11)

    assert received == [*[FORWARD] * 10, Twist()]


def test_drive_accepts_negative_velocities(server: Server) -> None:
    assert drive_and_receive(server, "r1", "-0.2", "--once") == [Twist(Vector3(x=-0.2))]


@pytest.mark.parametrize("robot", ["team/r1", "/team/r1", "team/r1/"])
def test_drive_strips_slashes_of_a_namespace(server: Server, robot: str) -> None:
    received = drive_and_receive(server, robot, "0.2", "-0.5", "--once", key="team/r1/cmd_vel")

    assert received == [FORWARD]


def test_drive_fails_without_a_subscriber(server: Server) -> None:
    done = run_at(server, app, "drive", "r9", "0.2", "--once")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim drive: ", "'r9'")


def test_drive_advises_an_agent_only_for_a_robot_without_one(two: Server) -> None:
    two.client.spawn(make_static_order("crate"))

    without_agent = run_at(two, app, "drive", "r1", "0.2", "--once")
    by_name = run_at(two, app, "drive", "r2", "0.2", "--once")
    crate = run_at(two, app, "drive", "crate", "0.2", "--once")

    assert_failed(without_agent, ExitCode.FAILED, "zensim drive: ", "zensim agent r1")
    assert_failed(by_name, ExitCode.FAILED, "zensim drive: ", "zensim drive team/r2")
    assert_failed(crate, ExitCode.FAILED, "zensim drive: ", "'crate' is not a robot", "r1")
    assert "zensim agent" not in crate.err


def test_drive_is_not_misled_by_a_subscription_with_wildcards(two: Server) -> None:
    recorder = two.bus.subscribe("**/cmd_vel/**")

    without_agent = run_at(two, app, "drive", "r1", "0.2", "--once")
    unknown = run_at(two, app, "drive", "r7", "0.2", "--once")
    recorder.close()

    assert_failed(without_agent, ExitCode.FAILED, "zensim drive: ", "zensim agent r1")
    assert_failed(unknown, ExitCode.NOT_FOUND, "zensim drive: ", "'r7'", "r1")


@pytest.mark.parametrize("verb", ["echo", "hz"])
def test_a_topic_that_is_not_there_is_named_with_similar_ones(two: Server, verb: str) -> None:
    limit = ("--timeout", "1", "--once") if verb == "echo" else ("--duration", "1")

    absent = run_at(two, app, verb, "sim/default/clokc", *limit)
    present = run_at(two, app, verb, "sim/default/clock", *limit)

    assert "'sim/default/clokc'" in absent.err
    assert "sim/default/clock" in absent.err
    assert "there is no topic" not in present.err


def make_static_order(name: str) -> SpawnEntityOrder:
    return SpawnEntityOrder(name, entity_resource=Resource(resource_string=CRATE))


@pytest.mark.parametrize("key", ["sim/default/events", "sim/**", "**"])
def test_echo_prints_no_reply_of_a_service(server: Server, key: str) -> None:
    with running("echo", key, "--once", "--json", "--connect", server.endpoint) as echo:
        eventually(lambda: spawn_and_delete(server, echo), 30.0, "an event")
        line, _ = echo.communicate(timeout=120.0)

    printed = json.loads(line)
    assert isinstance(printed["message"], dict)
    assert printed["key"].startswith("sim/default/")


def spawn_and_delete(server: Server, echo: "subprocess.Popen[str]") -> bool:
    server.zensim("spawn", "box_bot", "--name", "r1")
    server.zensim("delete", "r1")
    return echo.poll() is not None


def test_echo_of_the_key_of_a_service_does_not_call_it(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    server.client.step(5)

    done = run_at(server, app, "echo", "sim/default/reset_simulation", "--timeout", "0.2")

    assert_failed(done, ExitCode.TIMEOUT, "zensim echo: ")
    assert server.steps() == 5


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (("r1", "nan"), "nan"),
        (("r1", "0.2", "inf"), "inf"),
        (("r1", "0.2", "--rate", "0"), "--rate"),
        (("", "0.2"), "'/cmd_vel'"),
        (("a//b", "0.2"), "'a//b/cmd_vel'"),
    ],
    ids=str,
)
def test_drive_refuses_invalid_arguments(
    server: Server, arguments: tuple[str, ...], value: str
) -> None:
    done = run_at(server, app, "drive", *arguments)

    assert_failed(done, ExitCode.USAGE, "zensim drive: ", value)


def test_echo_prints_yaml(server: Server) -> None:
    done = run_at(server, app, "echo", "sim/default/clock", "--once")

    lines = done.out.splitlines()
    assert done.status == ExitCode.OK
    assert lines[0] == "# sim/default/clock"
    assert "clock:" in lines
    assert lines[-1] == "---"


def test_echo_prints_json_lines(server: Server) -> None:
    done = run_at(server, app, "echo", "sim/*/stats", "--count", "2", "--json")

    first, second = (json.loads(line) for line in done.out.splitlines())
    assert first["key"] == second["key"] == "sim/default/stats"
    assert first["message"]["state"] == "paused"


def test_echo_prints_a_latched_value(server: Server) -> None:
    queue = server.bus.serve("r1/robot_description")
    payload, encoding = encode(String("<robot/>"), Format.CDR), make_encoding(String, Format.CDR)
    arguments = ("echo", "r1/robot_description", "--once", "--connect", server.endpoint)
    try:
        with running(*arguments) as echo:
            for call in eventually(lambda: queue.take() or None, 20.0, "a query"):
                call.reply(payload, encoding)
            output, _ = echo.communicate(timeout=120.0)
    finally:
        queue.close()

    assert output.splitlines() == ["# r1/robot_description", 'data: "<robot/>"', "---"]


@pytest.mark.parametrize("key", ["r9/odom", "/r9/odom/"])
def test_echo_fails_after_its_timeout(server: Server, key: str) -> None:
    done = run_at(server, app, "echo", key, "--once", "--timeout", "0.05")

    assert_failed(done, ExitCode.TIMEOUT, "zensim echo: ")


@pytest.mark.parametrize("verb", ["echo", "hz"])
@pytest.mark.parametrize("key", ["", "a//b", "a b#", "a*"])
def test_invalid_key_is_refused(server: Server, verb: str, key: str) -> None:
    done = run_at(server, app, verb, key)

    assert_failed(done, ExitCode.USAGE, f"zensim {verb}: ")


def test_hz_says_that_no_more_messages_come(server: Server) -> None:
    publisher = server.bus.advertise("r1/imu", "")

    def publish() -> None:
        wait_for_subscriber(publisher)
        for _ in range(3):
            publisher.send(b"{}")

    thread = threading.Thread(target=publish)
    thread.start()
    done = run_at(server, app, "hz", "r1/imu", "--duration", "3", "--json")
    thread.join()

    assert [json.loads(line)["window"] for line in done.out.splitlines()] == [3]
    assert "no new messages" in done.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("drive", "r1", "0.2", "--duration", "-1"),
        ("echo", "r1/odom", "--count", "-1"),
        ("hz", "r1/odom", "--duration", "-1"),
    ],
    ids=" ".join,
)
def test_negative_limits_are_refused(server: Server, arguments: tuple[str, ...]) -> None:
    assert run_at(server, app, *arguments).status == ExitCode.USAGE


def test_hz_measures_the_rate_of_a_topic(server: Server) -> None:
    server.client.set_simulation_state(State.PLAYING)

    done = run_at(server, app, "hz", "sim/default/clock", "--duration", "1", "--json")

    figures = json.loads(done.out)
    # The server of a busy machine may publish less, and a pause of ours is made up for.
    assert 10.0 < figures["rate_hz"] < 200.0
    assert figures["min_s"] <= figures["max_s"]
    assert figures["window"] > 10


def test_hz_prints_a_note_without_messages(server: Server) -> None:
    done = run_at(server, app, "hz", "r9/odom", "--duration", "0.1")

    assert (done.status, done.out) == (ExitCode.OK, "")
    assert done.err.startswith("zensim hz: ")


def test_command_fails_when_nothing_listens() -> None:
    done = run(app, "echo", "r1/odom", "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, "zensim echo: ")


ENCODINGS = [
    "",
    "application/cdr",
    "application/cdr;nav_msgs/msg/Odometry",
    "application/cdr;x/y",
    "application/json",
    "application/msgpack",
]
KEYS = ["r1/odom", "sim/default/snapshot", "sim/default/drive/a/command", "sim/x", ""]


def make_sample(message: msgspec.Struct, format_: Format, key: str = "r1/topic") -> Sample:
    return Sample(key, encode(message, format_), make_encoding(message, format_))


def format_lines(plain: object) -> list[str]:
    return list(to_yaml_lines(plain))


def test_cdr_is_decoded_by_the_type_in_its_encoding() -> None:
    plain = to_plain(make_sample(Twist(Vector3(x=0.5)), Format.CDR))

    assert plain == {
        "linear": {"x": 0.5, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
    }


def test_cdr_of_an_unknown_type_is_described() -> None:
    plain = to_plain(
        Sample("r1/scan", b"\0\1\0\0abcd", "application/cdr;sensor_msgs/msg/LaserScan")
    )

    assert isinstance(plain, str)
    assert plain.startswith("8 bytes")
    assert "LaserScan" in plain


@pytest.mark.parametrize("format_", [Format.MSGPACK, Format.JSON])
@pytest.mark.parametrize("message", [WorldClock(step=3), Event("spawned", "r1"), Stats(world="w")])
def test_telemetry_is_decoded_by_its_key(message: msgspec.Struct, format_: Format) -> None:
    topic = {WorldClock: "clock", Event: "events", Stats: "stats"}[type(message)]

    plain = to_plain(make_sample(message, format_, f"sim/w/{topic}"))

    assert plain == msgspec.to_builtins(message)


def test_arrays_are_decoded_to_numbers() -> None:
    snapshot = Snapshot(1, 2, 3, 4, ("r",), floats([1.0, 2.0]), floats([0.5]))
    command = DriveCommand(1, 2, b"\1\0\0\0\2\0\0\0", floats([3.0]))

    state = to_plain(make_sample(snapshot, Format.MSGPACK, "sim/w/snapshot"))
    targets = to_plain(make_sample(command, Format.MSGPACK, "sim/w/drive/a/command"))

    assert isinstance(state, dict)
    assert isinstance(targets, dict)
    assert (state["base"], state["joint_positions"]) == ([1.0, 2.0], [0.5])
    assert (targets["claims"], targets["targets"]) == ([1, 2], [3.0])


@pytest.mark.parametrize("field", ["base", "joint_positions"])
def test_arrays_of_an_odd_length_are_described(field: str) -> None:
    snapshot = Snapshot(1, 2, 3, 4, (), b"", b"")
    broken = msgspec.structs.replace(snapshot, **{field: b"12345"})

    plain = to_plain(make_sample(broken, Format.MSGPACK, "sim/w/snapshot"))

    assert isinstance(plain, str)
    assert plain.startswith(f"{len(encode(broken, Format.MSGPACK))} bytes")


def test_any_json_is_decoded() -> None:
    assert to_plain(Sample("a/b", b'{"n": [1, null]}', "")) == {"n": [1, None]}


def test_lines_are_yaml() -> None:
    plain = {
        "name": "r1",
        "pose": {"x": 1.0, "frames": []},
        "numbers": [1, 2.5],
        "links": [{"a": True}, "text"],
        "none": None,
        "empty": {},
    }

    assert format_lines(plain) == [
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
def test_lines_format_numbers_as_yaml(number: float, shown: str) -> None:
    assert format_lines({"x": number}) == [f"x: {shown}"]


def test_lines_quote_text() -> None:
    assert format_lines({"a": "true", "b": "x: y\nz"}) == ['a: "true"', 'b: "x: y\\nz"']


def test_odometry_and_text_are_formatted() -> None:
    odometry = to_plain(make_sample(Odometry(), Format.CDR))
    text = to_plain(make_sample(String("hello"), Format.CDR))

    assert "pose:" in format_lines(odometry)
    assert format_lines(text) == ['data: "hello"']


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
    plain = to_plain(Sample(key, payload, encoding))

    assert all(isinstance(line, str) for line in to_yaml_lines(plain))
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
    plain = to_plain(Sample(key, payload, ""))

    assert format_lines(plain)
    assert msgspec.json.encode({"message": plain})
