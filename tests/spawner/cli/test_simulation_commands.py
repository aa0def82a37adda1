"""`zensim step`, `run-to` and `speed` against a real server."""

import signal

import pytest

from tests.integration.processes import Server, eventually, running
from tests.spawner.cli.commands import NOWHERE, assert_failed, run, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.simulation_messages import State
from zensim.spawner.cli.simulation_commands import app


def test_step_makes_so_many_steps(server: Server) -> None:
    done = run_at(server, app, "step", "24")

    assert (done.status, done.out, done.err) == (ExitCode.OK, "24 steps, now 0.100 s\n", "")
    assert server.steps() == 24


def test_step_makes_one_when_no_number_is_given(server: Server) -> None:
    assert run_at(server, app, "step", "--json").json()["steps"] == 1


def test_run_to_stops_at_a_time(server: Server) -> None:
    run_at(server, app, "step", "7")

    done = run_at(server, app, "run-to", "0.5", "--json")

    assert done.json() == {"steps": 113, "sim_time_s": pytest.approx(0.5, abs=1e-4)}
    assert run_at(server, app, "run-to", "0.5").out.startswith("0 steps")


def test_interrupt_ends_the_steps_and_says_how_many_were_made(server: Server) -> None:
    with running("step", "9999999", "--connect", server.endpoint) as stepping:
        eventually(lambda: server.steps() > 100, 20.0, "stepping")
        stepping.send_signal(signal.SIGINT)
        said, noted = stepping.communicate(timeout=20.0)

    made = server.steps()
    assert (stepping.returncode, said) == (ExitCode.INTERRUPTED, "")
    assert noted == f"zensim step: canceled after {made} of 9999999 steps\n"


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (
            ("step", "0"),
            ExitCode.FAILED,
            "zensim step: OPERATION_FAILED (4): steps=0 is out of range",
        ),
        (
            ("run-to", "nan"),
            ExitCode.USAGE,
            "zensim run-to: USAGE (2): nan s is out of range; use 0",
        ),
        (("run-to", "1e300"), ExitCode.USAGE, "zensim run-to: USAGE (2): 1e+300 s is out of range"),
        (("speed", "1e9"), ExitCode.FAILED, "zensim speed: OPERATION_FAILED (4): real_time_factor"),
        (
            ("step", "--world-name", "x"),
            ExitCode.UNREACHABLE,
            "zensim step: UNREACHABLE (4): nothing",
        ),
    ],
)
def test_command_says_what_is_wrong_in_one_line(
    server: Server, arguments: tuple[str, ...], status: ExitCode, line: str
) -> None:
    assert_failed(run_at(server, app, *arguments), status, line)


def test_run_to_a_time_that_is_past_is_refused(server: Server) -> None:
    run_at(server, app, "step", "24")

    done = run_at(server, app, "run-to", "0.05")

    assert_failed(done, ExitCode.FAILED, "zensim run-to: OPERATION_FAILED (4): 0.05 s is past")


def test_step_is_refused_while_time_runs(server: Server) -> None:
    server.client.set_simulation_state(State.PLAYING)

    done = run_at(server, app, "step")

    assert_failed(
        done, ExitCode.FAILED, "zensim step: INCORRECT_STATE (3): the simulation is playing"
    )


def test_speed_is_chosen_and_told(server: Server) -> None:
    chosen = run_at(server, app, "speed", "0")
    told = run_at(server, app, "speed", "--json")
    back = run_at(server, app, "speed", "1")

    assert (chosen.status, chosen.out) == (ExitCode.OK, "speed flat out, now 0.000\n")
    assert told.json()["target_real_time_factor"] == 0.0
    assert back.out == "speed 1, now 0.000\n"


def test_command_says_so_when_nobody_listens() -> None:
    done = run(app, "step", "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, "zensim step: UNREACHABLE (4): nobody listens at")
