"""`zensim topic`: list, info, bw, delay and pub on a server with an agent."""

import json
from collections.abc import Iterator
from functools import partial

import pytest

from tests.deploy.cli.commands import NOWHERE, assert_failed, run, run_at
from tests.integration.processes import Server, eventually, running_agents, serving, zensim
from zensim.deploy.cli.topic_commands import app as short_app
from zensim.deploy.cli.topic_group_commands import app, make_message
from zensim.proto.codec.message_codec import decode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import Twist

SERVER_TOPICS = {"sim/default/clock", "sim/default/stats", "sim/default/snapshot"}
ROBOT_TOPICS = {"r1/cmd_vel", "r1/odom", "r1/tf", "r1/tf_static", "r1/joint_states"}


def read_last_line(output: str) -> dict[str, float]:
    found = json.loads(output.splitlines()[-1])
    assert isinstance(found, dict)
    return found


@pytest.fixture(scope="module", params=["0", "off"])
def driven(request: pytest.FixtureRequest) -> Iterator[Server]:
    """A robot with an agent, with and without ROS 2 endpoints."""
    domain = ("--ros-domain", request.param)
    with serving(*domain, "--engine", "mujoco") as server:
        server.zensim("spawn", "box_bot", "--name", "r1")
        with running_agents(server, "r1", options=domain):
            yield server


def test_list_has_the_topics_of_server_and_robots(driven: Server) -> None:
    done = run_at(driven, app, "list", "--quiet")

    assert set(done.out.split()) >= SERVER_TOPICS | ROBOT_TOPICS


@pytest.mark.parametrize("verb", ["bw", "delay"])
def test_note_on_a_topic_that_is_not_there_names_the_command(driven: Server, verb: str) -> None:
    absent = run_at(driven, app, verb, "sim/default/clokc", "--duration", "1")

    assert f"zensim topic {verb}: note: there is no topic 'sim/default/clokc' yet" in absent.err


def test_list_selects_by_a_part_of_the_name(driven: Server) -> None:
    found = run_at(driven, app, "list", "odom", "--json").json()

    assert [(one["key"], one["ros_type"]) for one in found] == [
        ("r1/odom", "nav_msgs/msg/Odometry")
    ]


def test_info_shows_the_type_and_counts(driven: Server) -> None:
    done = run_at(driven, app, "info", "/r1/cmd_vel", "-v")
    of_clock = run_at(driven, app, "info", "sim/default/clock", "--json").json()

    assert "geometry_msgs/msg/Twist" in done.out
    assert len(of_clock["publishers"]) == 1


def test_info_fails_for_an_unknown_topic(driven: Server) -> None:
    done = run_at(driven, app, "info", "r1/nothing")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim topic info: ", "r1/nothing")


@pytest.mark.parametrize("verb", ["hz", "bw", "delay"])
def test_measurement_prints_figures_of_odometry(driven: Server, verb: str) -> None:
    done = run_at(driven, app, verb, "r1/odom", "--duration", "1.3", "--json")

    figures = done.out.splitlines()
    assert figures, done.err
    printed = run_at(driven, app, verb, "r1/odom", "--duration", "1.3")
    assert printed.out
    assert "window" in figures[-1]


def test_delay_is_small_and_not_negative_by_more_than_a_period(driven: Server) -> None:
    done = run_at(driven, app, "delay", "r1/odom", "--duration", "1.3", "--json")

    last = read_last_line(done.out)
    assert -0.05 <= last["mean_s"] <= 1.0


def test_bandwidth_is_that_of_the_messages(driven: Server) -> None:
    last = read_last_line(run_at(driven, app, "bw", "r1/odom", "--duration", "1.3", "--json").out)

    assert last["min_bytes"] == last["max_bytes"] > 600
    assert last["bytes_per_s"] > 0


def test_delay_fails_for_messages_without_a_stamp(driven: Server) -> None:
    done = run_at(driven, app, "delay", "r1/tf", "--duration", "5")

    assert_failed(done, ExitCode.FAILED, "zensim topic delay: ", "r1/tf")


def test_pub_drives_a_robot(driven: Server) -> None:
    received = driven.bus.subscribe("r1/cmd_vel", 10)

    done = run_at(driven, app, "pub", "--once", "r1/cmd_vel", "{linear: {x: 0.25}}")

    sample = eventually(received.newest, 10.0, "a command")
    received.close()
    assert done.status == ExitCode.OK
    assert decode(Twist, sample.payload, sample.encoding).linear.x == 0.25


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (("r1/cmd_vel", "geometry_msgs/msg/Twist", "{linear: {speed: 1}}"), "speed"),
        (("tf", "tf2_msgs/msg/TFMessage", "{transforms: [{child: a}]}"), "child_frame_id"),
        (("r1/cmd_vel", "geometry_msgs/msg/Twist", "{linear: [}"), "linear"),
        (("r1/cmd_vel", "geometry_msgs/msg/Twist", "{linear: fast}"), "Twist"),
        (("r1/odd", "{data: 1}"), "type"),
        (("r1/cmd_vel", "Twist"), "'Twist'"),
        (("r1/cmd_vel", "{}", "--rate", "0"), "--rate"),
        (("*/cmd_vel", "{}"), "'*/cmd_vel'"),
    ],
    ids=str,
)
def test_pub_refuses_what_is_no_message(
    driven: Server, arguments: tuple[str, ...], value: str
) -> None:
    done = run_at(driven, app, "pub", "--once", *arguments)

    assert_failed(done, ExitCode.USAGE, "zensim topic pub: ", value)


def test_message_is_made_from_yaml_of_a_known_type() -> None:
    message = make_message("a/b", "geometry_msgs/msg/Twist", "{angular: {z: 1}}")

    assert isinstance(message, Twist)
    assert message.angular.z == 1.0


@pytest.mark.parametrize(("given", "turn"), [("", 0.0), ("{angular: {z: 1}}", 1.0)])
def test_type_of_a_topic_of_a_robot_may_be_left_out(given: str, turn: float) -> None:
    message = make_message("r1/cmd_vel", given, "")

    assert isinstance(message, Twist)
    assert message.angular.z == turn


@pytest.mark.parametrize("verb", ["list", "info"])
def test_topic_fails_without_a_server(verb: str) -> None:
    done = run(app, verb, *(("r1/odom",) if verb == "info" else ()), "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, f"zensim topic {verb}: ")


def test_short_forms_are_the_same_commands() -> None:
    names = {command.callback for command in app.registered_commands}
    short = {c.callback for c in short_app.registered_commands if c.callback is not None}

    assert len(names & short) == 2


def test_shell_completes_robots_and_topics(driven: Server) -> None:
    for line, word, expected in (
        (f"zensim drive --connect {driven.endpoint} ", "4", "r1"),
        (f"zensim echo --connect {driven.endpoint} r1/o", "4", "r1/odom"),
    ):
        assert eventually(partial(completes, line, word, expected), 60.0, "a completion")


def completes(line: str, word: str, expected: str) -> bool:
    """Whether a shell gets the completion; a busy host exceeds the short timeout now and then."""
    variables = {"_ZENSIM_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": word}
    prefix = ("env", *(f"{name}={value}" for name, value in variables.items()))
    return expected in zensim(prefix=prefix).stdout.splitlines()
