"""`zensim pause`, `play`, `stop`, `reset` and `features` against a real server."""

import pytest

from tests.integration.processes import Server, eventually
from tests.spawner.cli.commands import NOWHERE, assert_failed, run, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.simulation_messages import State
from zensim.spawner.cli.simulation_commands import app


def test_time_runs_after_play_and_stands_after_pause(server: Server) -> None:
    done = run_at(server, app, "play")
    assert (done.status, done.out.split()[0]) == (ExitCode.OK, "playing")
    before = server.steps()
    eventually(lambda: server.steps() > before, 5.0, "stepping")

    done = run_at(server, app, "pause")

    assert (done.status, done.out.split()[0]) == (ExitCode.OK, "paused")
    assert server.client.simulation_state() == State.PAUSED


def test_stop_goes_back_to_the_start(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    server.client.step(3)

    done = run_at(server, app, "stop")

    assert (done.status, done.out) == (ExitCode.OK, "stopped at 0.000 s\n")
    assert server.client.entities() == ()
    assert run_at(server, app, "stop").status == ExitCode.OK


def test_pause_is_content_when_time_stands_already(server: Server) -> None:
    assert run_at(server, app, "pause").status == ExitCode.OK


@pytest.mark.parametrize(
    ("options", "is_at_start", "is_empty"),
    [((), True, True), (("--time",), True, False), (("--spawned", "--state"), False, True)],
)
def test_reset_goes_back_as_far_as_it_is_told(
    server: Server, options: tuple[str, ...], *, is_at_start: bool, is_empty: bool
) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    server.client.step(3)

    done = run_at(server, app, "reset", *options)

    assert done.status == ExitCode.OK
    assert (server.steps() == 0, server.client.entities() == ()) == (is_at_start, is_empty)


def test_features_are_told_by_name(server: Server) -> None:
    done = run_at(server, app, "features")

    assert {"SPAWNING", "SIMULATION_RESET"} <= set(done.out.split())
    assert "urdf" in done.err
    assert run_at(server, app, "features", "--json").json()["features"] == done.out.split()


def test_command_says_so_when_nobody_listens() -> None:
    done = run(app, "play", "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, "zensim play: UNREACHABLE (4): nobody listens at")
