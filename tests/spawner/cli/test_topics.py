"""`zensim drive`, `echo` and `hz` on a real network."""

import json

import pytest

from tests.integration.processes import Server, eventually, running
from tests.spawner.cli.commands import NOWHERE, assert_failed, run, run_at
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import String, Twist, Vector3
from zensim.spawner.cli.topics import app

FORWARD = Twist(Vector3(x=0.2), Vector3(z=-0.5))


def heard_after(server: Server, *arguments: str, key: str = "r1/cmd_vel") -> list[Twist]:
    """Drive while somebody listens, and tell what was heard."""
    listener = server.bus.subscribe(key, 1000)
    try:
        done = run_at(server, app, "drive", *arguments)
        assert done.status == ExitCode.OK
        return [decode(Twist, one.payload, one.encoding) for one in listener.take()]
    finally:
        listener.close()


def test_drive_sends_one_command_when_told_once(server: Server) -> None:
    assert heard_after(server, "r1", "0.2", "-0.5", "--once") == [FORWARD]


def test_drive_sends_commands_for_a_while_and_then_stops_the_robot(server: Server) -> None:
    heard = heard_after(server, "r1", "0.2", "-0.5", "--rate", "50", "--duration", "0.2")

    assert heard == [*[FORWARD] * 10, Twist()]


def test_drive_takes_negative_speeds(server: Server) -> None:
    assert heard_after(server, "r1", "-0.2", "--once") == [Twist(Vector3(x=-0.2))]


@pytest.mark.parametrize("robot", ["team/r1", "/team/r1", "team/r1/"])
def test_drive_takes_a_namespace_as_people_write_it(server: Server, robot: str) -> None:
    heard = heard_after(server, robot, "0.2", "-0.5", "--once", key="team/r1/cmd_vel")

    assert heard == [FORWARD]


def test_drive_says_so_when_nobody_listens(server: Server) -> None:
    done = run_at(server, app, "drive", "r9", "0.2", "--once")

    assert_failed(done, ExitCode.FAILED, "zensim drive: FAILED (1): nobody listens on r9/cmd_vel")
    assert "'zensim agent r9'" in done.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("r1", "nan"), "cannot be driven; use finite numbers"),
        (("r1", "0.2", "inf"), "cannot be driven; use finite numbers"),
        (("r1", "0.2", "--rate", "0"), "--rate 0 is no rate; use more than 0"),
        (("", "0.2"), "key '/cmd_vel' is not valid; use names joined by '/'"),
        (("a//b", "0.2"), "key 'a//b/cmd_vel' is not valid"),
    ],
    ids=str,
)
def test_drive_is_refused_in_one_line_when_it_is_mistyped(
    server: Server, arguments: tuple[str, ...], message: str
) -> None:
    done = run_at(server, app, "drive", *arguments)

    assert_failed(done, ExitCode.USAGE, "zensim drive: USAGE (2): ")
    assert message in done.err


def test_echo_shows_telemetry_as_people_read_it(server: Server) -> None:
    done = run_at(server, app, "echo", "sim/default/clock", "--once")

    lines = done.out.splitlines()
    assert done.status == ExitCode.OK
    assert lines[0] == "# sim/default/clock"
    assert "clock:" in lines
    assert lines[-1] == "---"


def test_echo_shows_telemetry_as_programs_read_it(server: Server) -> None:
    done = run_at(server, app, "echo", "sim/*/stats", "--count", "2", "--json")

    first, second = (json.loads(line) for line in done.out.splitlines())
    assert first["key"] == second["key"] == "sim/default/stats"
    assert first["message"]["state"] == "paused"


def test_echo_shows_a_last_value_that_was_put_before_it_came(server: Server) -> None:
    queue = server.bus.serve("r1/robot_description")
    payload, encoding = encode(String("<robot/>"), Format.CDR), make_encoding(String, Format.CDR)
    arguments = ("echo", "r1/robot_description", "--once", "--connect", server.endpoint)
    try:
        with running(*arguments) as echo:
            for call in eventually(lambda: queue.take() or None, 20.0, "a question"):
                call.reply(payload, encoding)
            said, _ = echo.communicate(timeout=20.0)
    finally:
        queue.close()

    assert said.splitlines() == ["# r1/robot_description", 'data: "<robot/>"', "---"]


@pytest.mark.parametrize("key", ["r9/odom", "/r9/odom/"])
def test_echo_gives_up_when_nothing_comes(server: Server, key: str) -> None:
    done = run_at(server, app, "echo", key, "--once", "--timeout", "0.05")

    assert_failed(
        done, ExitCode.TIMEOUT, f"zensim echo: TIMEOUT (5): nothing came on {key} within 0.05"
    )


@pytest.mark.parametrize("verb", ["echo", "hz"])
@pytest.mark.parametrize("key", ["", "a//b", "a b#", "a*"])
def test_key_is_refused_in_one_line_when_it_is_mistyped(
    server: Server, verb: str, key: str
) -> None:
    done = run_at(server, app, verb, key)

    assert_failed(done, ExitCode.USAGE, f"zensim {verb}: USAGE (2): key {key!r} is not valid; use")


def test_hz_measures_the_rate_of_a_topic(server: Server) -> None:
    server.client.set_simulation_state(State.PLAYING)

    done = run_at(server, app, "hz", "sim/default/clock", "--duration", "1", "--json")

    figures = json.loads(done.out)
    assert figures["rate_hz"] == pytest.approx(100.0, rel=0.2)
    assert figures["min_s"] <= figures["max_s"]
    assert figures["window"] > 50


def test_hz_says_so_when_nothing_comes(server: Server) -> None:
    done = run_at(server, app, "hz", "r9/odom", "--duration", "0.1")

    assert (done.status, done.out) == (ExitCode.OK, "")
    assert done.err == "zensim hz: no new messages\n"


def test_command_says_so_when_nobody_listens_at_its_endpoint() -> None:
    done = run(app, "echo", "r1/odom", "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, "zensim echo: UNREACHABLE (4): nobody listens at")
