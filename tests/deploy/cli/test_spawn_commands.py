"""`zensim spawn` and `zensim fleet` against a real server."""

import math
from pathlib import Path

import pytest

from tests.deploy.cli.commands import NOWHERE, assert_failed, run, run_at
from tests.integration.processes import Server
from zensim.deploy.cli.spawn_commands import app
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.standard_messages import Point
from zensim.spawner.spawn.spawn_poses import make_pose

BALL = (
    '<robot name="ball"><link name="base"><collision><geometry><sphere radius="0.5"/></geometry>'
    "</collision></link></robot>"
)


@pytest.fixture
def ball(tmp_path: Path) -> str:
    """A description in a file."""
    file = tmp_path / "ball.urdf"
    file.write_text(BALL, encoding="utf-8")
    return str(file)


def find_position(server: Server, name: str) -> Point:
    return server.client.entity_state(name).pose.position


def find_namespace(server: Server, name: str) -> str:
    return server.client.entity_model(name).namespace


def test_spawn_places_a_built_in_model_on_the_ground(server: Server) -> None:
    done = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "1", "-y", "-2.5")

    assert (done.status, done.err) == (ExitCode.OK, "")
    assert done.out.startswith("spawned r1 under r1/\n")
    position = find_position(server, "r1")
    assert (position.x, position.y, position.z) == pytest.approx((1.0, -2.5, 0.06))


def test_spawn_uses_the_given_height(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-z", "2")

    assert find_position(server, "r1").z == pytest.approx(2.0)


def test_spawn_uses_the_given_angles(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-R", "0.1", "-P", "0.2", "--yaw", "0.3")

    q = server.client.entity_state("r1").pose.orientation
    expected = make_pose((0.0, 0.0, 0.0), (0.1, 0.2, 0.3)).orientation
    assert (q.x, q.y, q.z, q.w) == pytest.approx((expected.x, expected.y, expected.z, expected.w))


@pytest.mark.parametrize("flag", ["-urdf", "--robot_urdf"])
def test_spawn_accepts_the_file_option_of_tutorials(server: Server, ball: str, flag: str) -> None:
    done = run_at(server, app, "spawn", flag, ball, "--robot_name", "b1")

    assert done.out.startswith("spawned b1 under b1/\n")
    assert find_position(server, "b1").z == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("flags", "namespace"),
    [
        ((), "r1"),
        (("-ns", "team/a"), "team/a"),
        (("--robot_namespace", "/team/a"), "team/a"),
        (("-namespace", "True", "-ns", "team/a"), "team/a"),
        (("-namespace", "False", "-ns", "team/a"), "r1"),
        (("--namespace", "true"), "r1"),
        (("-namespace", "team/b"), "team/b"),
        (("-namespace", "team/b", "-ns", "team/a"), "team/b"),
    ],
    ids=str,
)
def test_spawn_accepts_the_namespace_options_of_tutorials(
    server: Server, flags: tuple[str, ...], namespace: str
) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", *flags)

    assert find_namespace(server, "r1") == namespace


def test_spawn_adds_the_namespace_to_the_drive(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-ns", "team/a")

    drive = server.client.models(("r1",)).models[0].drive
    assert drive is not None
    assert drive.ros.namespace == "team/a"
    assert drive.ros.remappings == ("/tf:=/team/a/tf",)


def test_spawn_numbers_default_names(server: Server) -> None:
    first = run_at(server, app, "spawn", "box_bot")
    second = run_at(server, app, "spawn", "box_bot", "-x", "1")

    assert first.out.startswith("spawned box_bot under box_bot/\n")
    assert second.out.startswith("spawned box_bot_1 under box_bot_1/\n")


def test_spawn_refuses_a_taken_name_without_allow_renaming(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1")

    refused = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "1")
    renamed = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "1", "--allow-renaming")

    assert_failed(refused, ExitCode.FAILED, "zensim spawn: ", "'r1'")
    assert renamed.out.startswith("spawned r1_1 ")


def test_spawn_uses_the_reference_frame(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "5", "-Y", str(math.pi / 2.0))

    done = run_at(server, app, "spawn", "box_bot", "-n", "r2", "-x", "1", "--frame", "r1")

    assert done.status == ExitCode.OK
    position = find_position(server, "r2")
    assert (position.x, position.y) == pytest.approx((5.0, 1.0))


def test_spawn_prints_its_report_as_json(server: Server) -> None:
    report = run_at(server, app, "spawn", "box_bot", "-n", "r1", "--json").json()

    assert report["result"]["result"] == 1
    assert (report["entity_name"], report["entity_namespace"]) == ("r1", "r1")
    assert {"applied"} <= {entry["status"] for entry in report["report"]}


def test_spawn_prints_suspicious_entries_as_warnings(server: Server) -> None:
    done = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-z", "0.01")

    assert done.status == ExitCode.OK
    assert "zensim spawn: warning: initial_pose: " in done.err


@pytest.mark.parametrize(
    ("arguments", "status", "value"),
    [
        ((), ExitCode.USAGE, "-file"),
        (("nowhere.urdf",), ExitCode.NOT_FOUND, "nowhere.urdf"),
        (("box_bot", "-n", "9 lives"), ExitCode.USAGE, "'9 lives'"),
        (("box_bot", "-ns", "a b"), ExitCode.USAGE, "'a b'"),
        (("box_bot", "-ns", "sim/a"), ExitCode.USAGE, "sim"),
        (("box_bot", "--timeout", "0"), ExitCode.USAGE, "--timeout"),
        (("box_bot", "--wait", "nan"), ExitCode.USAGE, "--wait"),
        (("box_bot", "--world-name", "a b"), ExitCode.USAGE, "'a b'"),
    ],
    ids=str,
)
def test_spawn_refuses_invalid_arguments_before_connecting(
    arguments: tuple[str, ...], status: ExitCode, value: str
) -> None:
    done = run(app, "spawn", *arguments, "--connect", NOWHERE)

    assert_failed(done, status, "zensim spawn: ", value)


def test_spawn_refuses_an_invalid_endpoint() -> None:
    done = run(app, "spawn", "box_bot", "--connect", "there")

    assert_failed(done, ExitCode.USAGE, "zensim spawn: ")


@pytest.mark.parametrize(
    ("arguments", "status", "value"),
    [
        (("tank",), ExitCode.NOT_FOUND, "box_bot"),
        (("box_bot", "-x", "nan"), ExitCode.USAGE, ""),
        (("box_bot", "-x", "1e9"), ExitCode.FAILED, ""),
        (("box_bot", "--frame", "r7"), ExitCode.NOT_FOUND, "'r7'"),
    ],
    ids=str,
)
def test_spawn_prints_a_refusal_of_the_server(
    server: Server, arguments: tuple[str, ...], status: ExitCode, value: str
) -> None:
    done = run_at(server, app, "spawn", *arguments)

    assert_failed(done, status, "zensim spawn: ", value)
    assert server.client.entities() == ()


def test_spawn_fails_when_nothing_listens() -> None:
    done = run(app, "spawn", "box_bot", "--connect", NOWHERE, "--wait", "0.1")

    assert_failed(done, ExitCode.UNREACHABLE, "zensim spawn: ")


def test_spawn_fails_when_no_server_has_the_world(server: Server) -> None:
    done = run_at(server, app, "spawn", "box_bot", "--world-name", "mars", "--wait", "0.1")

    assert_failed(done, ExitCode.UNREACHABLE, "zensim spawn: ")


def test_fleet_places_robots_in_a_row(server: Server) -> None:
    done = run_at(server, app, "fleet", "box_bot", "--robots", "3", "--spacing", "2")

    assert (done.status, done.out) == (ExitCode.OK, "spawned 3 of 3\n")
    assert server.client.entities() == ("box_bot0", "box_bot1", "box_bot2")
    assert find_position(server, "box_bot2").x == pytest.approx(4.0)
    assert find_namespace(server, "box_bot2") == "box_bot2"


def test_fleet_uses_the_given_prefix(server: Server) -> None:
    done = run_at(
        server,
        app,
        "fleet",
        "box_bot",
        "--robots",
        "4",
        "--prefix",
        "r",
        "--layout",
        "grid",
        "--json",
    )

    assert [(one["name"], one["code"]) for one in done.json()] == [(f"r{i}", 1) for i in range(4)]
    assert find_position(server, "r3").y == pytest.approx(1.0)


def test_fleet_ends_with_an_error_when_no_agent_drives_its_robots(server: Server) -> None:
    done = run_at(server, app, "fleet", "box_bot", "--robots", "2", "--wait-driven", "0.2")

    assert_failed(done, ExitCode.TIMEOUT, "zensim fleet: ")
    assert "2 of the robots" in done.err


def test_fleet_is_atomic(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1")

    done = run_at(
        server, app, "fleet", "box_bot", "--robots", "3", "--prefix", "r", "--spacing", "3"
    )

    assert (done.status, done.out) == (ExitCode.FAILED, "spawned 0 of 3\n")
    assert done.err.startswith("zensim fleet: r1: ")
    assert done.err.count("\n") == 1
    assert server.client.entities() == ("r1",)


def test_partial_fleet_continues_after_a_refusal(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1")

    done = run_at(server, app, "fleet", "box_bot", "--robots", "3", "--prefix", "r", "--partial")

    assert (done.status, done.out) == (ExitCode.PARTIAL, "spawned 2 of 3\n")
    assert done.err.startswith("zensim fleet: r1: ")
    assert server.client.entities() == ("r1", "r0", "r2")


def test_fleet_fails_when_all_are_refused(server: Server) -> None:
    done = run_at(server, app, "fleet", "tank", "--robots", "2")

    assert (done.status, done.out) == (ExitCode.FAILED, "spawned 0 of 2\n")
    assert done.err.startswith("zensim fleet: tank0: library.model: ")


@pytest.mark.parametrize(
    ("arguments", "status", "value"),
    [
        (("box_bot", "--layout", "spiral"), ExitCode.USAGE, "row, grid, circle"),
        (("box_bot", "--spacing", "-1"), ExitCode.USAGE, "-1"),
        (("a b.urdf",), ExitCode.USAGE, "'a b'"),
    ],
    ids=str,
)
def test_fleet_refuses_invalid_arguments_before_connecting(
    arguments: tuple[str, ...], status: ExitCode, value: str
) -> None:
    done = run(app, "fleet", *arguments, "--connect", NOWHERE)

    assert_failed(done, status, "zensim fleet: ", value)


def test_robots_fall_when_time_runs(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-z", "1")
    state: EntityState = server.client.entity_state("r1")

    server.client.step(24)

    assert server.client.entity_state("r1").pose.position.z < state.pose.position.z
