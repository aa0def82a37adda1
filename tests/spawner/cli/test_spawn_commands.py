"""`zensim spawn` and `zensim fleet` against a real server."""

import math
from pathlib import Path

import pytest

from tests.integration.processes import Server
from tests.spawner.cli.commands import NOWHERE, assert_failed, run, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.standard_messages import Point
from zensim.spawner.cli.spawn_commands import app
from zensim.spawner.spawn.spawn_client import make_pose

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


def place_of(server: Server, name: str) -> Point:
    return server.client.entity_state(name).pose.position


def namespace_of(server: Server, name: str) -> str:
    return server.client.entity_model(name).namespace


def test_spawn_puts_a_shipped_model_on_the_ground(server: Server) -> None:
    done = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "1", "-y", "-2.5")

    assert (done.status, done.err) == (ExitCode.OK, "")
    assert done.out.startswith("spawned r1 under r1/\n")
    place = place_of(server, "r1")
    assert (place.x, place.y, place.z) == pytest.approx((1.0, -2.5, 0.06))


def test_spawn_puts_a_robot_at_a_height_when_it_is_told(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-z", "2")

    assert place_of(server, "r1").z == pytest.approx(2.0)


def test_spawn_turns_a_robot_as_it_is_told(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-R", "0.1", "-P", "0.2", "-Y", "0.3")

    q = server.client.entity_state("r1").pose.orientation
    expected = make_pose((0.0, 0.0, 0.0), (0.1, 0.2, 0.3)).orientation
    assert (q.x, q.y, q.z, q.w) == pytest.approx((expected.x, expected.y, expected.z, expected.w))


@pytest.mark.parametrize("flag", ["-urdf", "--robot_urdf"])
def test_spawn_reads_a_file_by_the_tutorials_flag(server: Server, ball: str, flag: str) -> None:
    done = run_at(server, app, "spawn", flag, ball, "--robot_name", "b1")

    assert done.out.startswith("spawned b1 under b1/\n")
    assert place_of(server, "b1").z == pytest.approx(0.5)


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
def test_spawn_reads_the_tutorials_namespace_flags(
    server: Server, flags: tuple[str, ...], namespace: str
) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", *flags)

    assert namespace_of(server, "r1") == namespace


def test_spawn_writes_the_namespace_into_the_drive(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-ns", "team/a")

    drive = server.client.models(("r1",)).models[0].drive
    assert drive is not None
    assert drive.ros.namespace == "team/a"
    assert drive.ros.remappings == ("/tf:=/team/a/tf",)


def test_spawn_numbers_names_when_none_was_given(server: Server) -> None:
    first = run_at(server, app, "spawn", "box_bot")
    second = run_at(server, app, "spawn", "box_bot", "-x", "1")

    assert first.out.startswith("spawned box_bot under box_bot/\n")
    assert second.out.startswith("spawned box_bot_1 under box_bot_1/\n")


def test_spawn_refuses_a_taken_name_unless_it_may_be_changed(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1")

    refused = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "1")
    renamed = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "1", "--allow-renaming")

    assert_failed(refused, ExitCode.FAILED, "zensim spawn: NAME_NOT_UNIQUE (101): ")
    assert "'r1' already exists" in refused.err
    assert renamed.out.startswith("spawned r1_1 ")


def test_spawn_puts_a_robot_beside_another(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-x", "5", "-Y", str(math.pi / 2.0))

    done = run_at(server, app, "spawn", "box_bot", "-n", "r2", "-x", "1", "--reference-frame", "r1")

    assert done.status == ExitCode.OK
    place = place_of(server, "r2")
    assert (place.x, place.y) == pytest.approx((5.0, 1.0))


def test_spawn_prints_its_report_as_json(server: Server) -> None:
    report = run_at(server, app, "spawn", "box_bot", "-n", "r1", "--json").json()

    assert report["result"]["result"] == 1
    assert (report["entity_name"], report["entity_namespace"]) == ("r1", "r1")
    assert {"applied"} <= {entry["status"] for entry in report["report"]}


def test_spawn_warns_of_what_is_suspicious(server: Server) -> None:
    done = run_at(server, app, "spawn", "box_bot", "-n", "r1", "-z", "0.01")

    assert done.status == ExitCode.OK
    assert "zensim spawn: warning: initial_pose: lowest point is 5.0 cm below ground" in done.err


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        ((), ExitCode.USAGE, "no model was given; use 'zensim spawn box_bot'"),
        (("nowhere.urdf",), ExitCode.NOT_FOUND, "nowhere.urdf: no such file"),
        (("box_bot", "-n", "9 lives"), ExitCode.USAGE, "name '9 lives' is not valid; use a letter"),
        (("box_bot", "-ns", "a b"), ExitCode.USAGE, "namespace 'a b' is not valid; use names"),
        (("box_bot", "-ns", "sim/a"), ExitCode.USAGE, "begins with a reserved name; use any but"),
        (("box_bot", "--timeout", "0"), ExitCode.USAGE, "--timeout 0 is out of range; use"),
        (("box_bot", "--wait", "nan"), ExitCode.USAGE, "--wait nan is out of range; use"),
        (("box_bot", "--world-name", "a b"), ExitCode.USAGE, "world name 'a b' is not valid; use"),
    ],
    ids=str,
)
def test_spawn_is_refused_in_one_line_before_anything_is_sent(
    arguments: tuple[str, ...], status: ExitCode, message: str
) -> None:
    done = run(app, "spawn", *arguments, "--connect", NOWHERE)

    assert_failed(done, status, "zensim spawn: ")
    assert message in done.err


def test_spawn_refuses_an_endpoint_that_is_none() -> None:
    done = run(app, "spawn", "box_bot", "--connect", "there")

    assert_failed(
        done, ExitCode.USAGE, "zensim spawn: USAGE (2): endpoint 'there' is not valid; use"
    )


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("tank",), ExitCode.NOT_FOUND, "there is box_bot"),
        (("box_bot", "-x", "nan"), ExitCode.FAILED, "INVALID_POSE (109): "),
        (("box_bot", "-x", "1e9"), ExitCode.FAILED, "INVALID_POSE (109): "),
        (("box_bot", "--reference-frame", "r7"), ExitCode.NOT_FOUND, "'r7' does not exist"),
    ],
    ids=str,
)
def test_spawn_says_what_the_server_refused(
    server: Server, arguments: tuple[str, ...], status: ExitCode, message: str
) -> None:
    done = run_at(server, app, "spawn", *arguments)

    assert_failed(done, status, "zensim spawn: ")
    assert message in done.err
    assert server.client.entities() == ()


def test_spawn_says_so_when_nobody_listens() -> None:
    done = run(app, "spawn", "box_bot", "--connect", NOWHERE, "--wait", "0.1")

    assert_failed(
        done, ExitCode.UNREACHABLE, f"zensim spawn: UNREACHABLE (4): nobody listens at {NOWHERE}"
    )


def test_spawn_says_so_when_nobody_serves_that_world(server: Server) -> None:
    done = run_at(server, app, "spawn", "box_bot", "--world-name", "mars", "--wait", "0.1")

    assert_failed(
        done, ExitCode.UNREACHABLE, "zensim spawn: UNREACHABLE (4): nothing answers sim/mars/"
    )


def test_fleet_puts_robots_in_a_row(server: Server) -> None:
    done = run_at(server, app, "fleet", "box_bot", "--count", "3", "--spacing", "2")

    assert (done.status, done.out) == (ExitCode.OK, "spawned 3 of 3\n")
    assert server.client.entities() == ("box_bot0", "box_bot1", "box_bot2")
    assert place_of(server, "box_bot2").x == pytest.approx(4.0)
    assert namespace_of(server, "box_bot2") == "box_bot2"


def test_fleet_names_robots_as_it_is_told(server: Server) -> None:
    done = run_at(
        server, app, "fleet", "box_bot", "-c", "4", "--prefix", "r", "--layout", "grid", "--json"
    )

    assert [(one["name"], one["code"]) for one in done.json()] == [(f"r{i}", 1) for i in range(4)]
    assert place_of(server, "r3").y == pytest.approx(1.0)


def test_fleet_is_spawned_whole_or_not_at_all(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1")

    done = run_at(server, app, "fleet", "box_bot", "-c", "3", "--prefix", "r", "--spacing", "3")

    assert (done.status, done.out) == (ExitCode.FAILED, "spawned 0 of 3\n")
    assert done.err.startswith("zensim fleet: r1: NAME_NOT_UNIQUE (101): ")
    assert done.err.count("\n") == 1
    assert server.client.entities() == ("r1",)


def test_fleet_goes_on_when_told_to_and_says_so_when_some_are_refused(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1")

    done = run_at(server, app, "fleet", "box_bot", "-c", "3", "--prefix", "r", "--partial")

    assert (done.status, done.out) == (ExitCode.PARTIAL, "spawned 2 of 3\n")
    assert done.err.startswith("zensim fleet: r1: NAME_NOT_UNIQUE (101): ")
    assert server.client.entities() == ("r1", "r0", "r2")


def test_fleet_fails_when_all_are_refused(server: Server) -> None:
    done = run_at(server, app, "fleet", "tank", "-c", "2")

    assert (done.status, done.out) == (ExitCode.FAILED, "spawned 0 of 2\n")
    assert done.err.startswith("zensim fleet: tank0: NOT_FOUND (2): library.model: ")


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("box_bot", "--layout", "spiral"), ExitCode.USAGE, "use row, grid, circle"),
        (("box_bot", "--spacing", "-1"), ExitCode.USAGE, "use at least 1 robot and more than 0 m"),
        (("a b.urdf",), ExitCode.USAGE, "prefix 'a b' is not valid"),
    ],
    ids=str,
)
def test_fleet_is_refused_in_one_line_before_anything_is_sent(
    arguments: tuple[str, ...], status: ExitCode, message: str
) -> None:
    done = run(app, "fleet", *arguments, "--connect", NOWHERE)

    assert_failed(done, status, "zensim fleet: ")
    assert message in done.err


def test_robots_are_where_they_were_put_until_time_runs(server: Server) -> None:
    run_at(server, app, "spawn", "box_bot", "-n", "r1", "-z", "1")
    state: EntityState = server.client.entity_state("r1")

    server.client.step(24)

    assert server.client.entity_state("r1").pose.position.z < state.pose.position.z
