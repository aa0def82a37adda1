"""`zensim pause`, `play`, `stop`, `reset`, `features`, `step`, `run-to`, `rtf` on a server."""

import signal

import pytest

from tests.deploy.cli.commands import NOWHERE, assert_failed, run, run_at
from tests.integration.processes import Server, eventually, running
from zensim.deploy.cli.simulation_commands import app
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.simulation_messages import State


def test_play_starts_time_and_pause_stops_it(server: Server) -> None:
    done = run_at(server, app, "play")
    assert (done.status, done.out.split()[0]) == (ExitCode.OK, "playing")
    before = server.steps()
    eventually(lambda: server.steps() > before, 5.0, "stepping")

    done = run_at(server, app, "pause")

    assert (done.status, done.out.split()[0]) == (ExitCode.OK, "paused")
    assert server.client.simulation_state() == State.PAUSED


def test_stop_resets_the_simulation(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    server.client.step(3)

    refused = run_at(server, app, "stop")
    kept = server.client.entities()
    done = run_at(server, app, "stop", "--yes")

    assert_failed(refused, ExitCode.FAILED, "zensim stop: ", "--yes", "zensim pause")
    assert kept == ("r1",)
    assert (done.status, done.out.split()[0]) == (ExitCode.OK, "stopped")
    assert server.client.entities() == ()
    assert run_at(server, app, "stop").status == ExitCode.OK


def test_state_and_reset_are_printed_as_json(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")

    assert run_at(server, app, "pause", "--json").json()["state"] == "paused"
    assert run_at(server, app, "reset", "--json").json()["deleted"] == 1


def test_quiet_and_verbose_exclude_each_other(server: Server) -> None:
    assert_failed(run_at(server, app, "pause", "-q", "-v"), ExitCode.USAGE, "zensim pause: ")


def test_pause_succeeds_when_paused(server: Server) -> None:
    assert run_at(server, app, "pause").status == ExitCode.OK


@pytest.mark.parametrize(
    ("options", "is_at_start", "is_empty"),
    [((), True, True), (("--time",), True, False), (("--spawned", "--state"), False, True)],
)
def test_reset_applies_the_selected_scope(
    server: Server, options: tuple[str, ...], *, is_at_start: bool, is_empty: bool
) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    server.client.step(3)

    done = run_at(server, app, "reset", *options)

    assert done.status == ExitCode.OK
    assert (server.steps() == 0, server.client.entities() == ()) == (is_at_start, is_empty)


def test_features_are_printed_by_name(server: Server) -> None:
    done = run_at(server, app, "features")

    assert {"SPAWNING", "SIMULATION_RESET"} <= set(done.out.split())
    assert "urdf" in done.err
    assert run_at(server, app, "features", "--json").json()["features"] == done.out.split()


def test_step_advances_by_n_steps(server: Server) -> None:
    done = run_at(server, app, "step", "24")

    assert (done.status, done.out.split()[0], done.err) == (ExitCode.OK, "24", "")
    assert server.steps() == 24


def test_step_defaults_to_one(server: Server) -> None:
    assert run_at(server, app, "step", "--json").json()["steps"] == 1


def test_run_to_advances_to_a_time(server: Server) -> None:
    run_at(server, app, "step", "7")

    done = run_at(server, app, "run-to", "0.5", "--json")

    assert done.json() == {"steps": 113, "sim_time_s": pytest.approx(0.5, abs=1e-4)}
    assert run_at(server, app, "run-to", "0.5").out.startswith("0 steps")


def test_interrupt_cancels_and_prints_the_completed_steps(server: Server) -> None:
    with running("step", "9999999", "--connect", server.endpoint) as stepping:
        eventually(lambda: server.steps() > 100, 20.0, "stepping")
        stepping.send_signal(signal.SIGINT)
        output, notes = stepping.communicate(timeout=120.0)

    assert (stepping.returncode, output) == (ExitCode.INTERRUPTED, "")
    assert notes.startswith("zensim step: ")
    assert f" {server.steps()} of 9999999" in notes


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (("step", "0"), ExitCode.FAILED, "zensim step: "),
        (("run-to", "nan"), ExitCode.USAGE, "zensim run-to: "),
        (("run-to", "1e300"), ExitCode.USAGE, "zensim run-to: "),
        (("rtf", "1e9"), ExitCode.FAILED, "zensim rtf: "),
        (("rtf", "-1"), ExitCode.FAILED, "zensim rtf: "),
        (("rtf", "nan"), ExitCode.USAGE, "zensim rtf: "),
        (("step", "--world-name", "x"), ExitCode.UNREACHABLE, "zensim step: "),
    ],
)
def test_command_fails_with_one_line(
    server: Server, arguments: tuple[str, ...], status: ExitCode, line: str
) -> None:
    assert_failed(run_at(server, app, *arguments), status, line)


def test_run_to_refuses_a_past_time(server: Server) -> None:
    run_at(server, app, "step", "24")

    done = run_at(server, app, "run-to", "0.05")

    assert_failed(done, ExitCode.FAILED, "zensim run-to: ")


def test_step_is_refused_while_playing(server: Server) -> None:
    server.client.set_simulation_state(State.PLAYING)

    done = run_at(server, app, "step")

    assert_failed(done, ExitCode.FAILED, "zensim step: ")


def test_rtf_sets_and_prints_the_factor(server: Server) -> None:
    set_to_zero = run_at(server, app, "rtf", "0")
    printed = run_at(server, app, "rtf", "--json")
    set_to_one = run_at(server, app, "rtf", "1")

    assert (set_to_zero.status, set_to_zero.err) == (ExitCode.OK, "")
    assert printed.json()["target_real_time_factor"] == 0.0
    assert set_to_one.out.startswith("real-time factor ")


def test_stats_prints_counts_and_times(server: Server) -> None:
    lines = dict(line.split(maxsplit=1) for line in run_at(server, app, "stats").out.splitlines())
    found = run_at(server, app, "stats", "--json").json()

    assert {name.partition(".")[0] for name in lines} == found.keys()
    assert float(lines["usage.cpu_s"]) <= found["usage"]["cpu_s"]
    assert "usage.wall_s" not in lines
    assert not [line for line in lines.values() if "(" in line]
    assert int(lines["requests"]) <= found["requests"]
    assert (found["world"], found["refused"], found["joined"]) == ("default", 0, 0)


def test_command_fails_when_nothing_listens() -> None:
    done = run(app, "step", "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, "zensim step: ")
