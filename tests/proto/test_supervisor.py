"""Supervisor with real processes."""

import json
import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial

import psutil
import pytest

from tests.integration.processes import eventually, free_endpoint
from zensim.proto.parent_death import PARENT_PID_VARIABLE
from zensim.proto.supervisor import (
    MAX_RESTARTS,
    STEADY_S,
    ProgramDied,
    SupervisedProgram,
    Supervisor,
    hide_settings,
)

NOWHERE = "tcp/127.0.0.1:1"
WAITING = ("spawn", "box_bot", "--wait", "600", "--connect", NOWHERE)
"""Waits for ten minutes."""
QUICK = ("model", "box_bot")
MISTYPED = ("model", "nowhere.urdf")
ENDS_S = 40.0


class RestartLog:
    """Records restarts."""

    def __init__(self) -> None:
        self.restarts: list[tuple[str, int]] = []

    def add(self, program: SupervisedProgram, status: int) -> None:
        self.restarts.append((program.name, status))


@pytest.fixture
def restart_log() -> RestartLog:
    return RestartLog()


@pytest.fixture
def supervisor(restart_log: RestartLog) -> Iterator[Supervisor]:
    started = Supervisor(restart_log.add)
    yield started
    started.close()


def find_pid(program: SupervisedProgram) -> int:
    assert program.process is not None
    return program.process.pid


def wait_for_exit(program: SupervisedProgram) -> int:
    process = program.process
    assert process is not None
    eventually(lambda: process.poll() is not None, ENDS_S, "its end")
    return process.wait()


def is_up_after_watch(supervisor: Supervisor, program: SupervisedProgram) -> bool:
    supervisor.watch()
    return program.process is not None


def is_gone(pid: int) -> bool:
    return not psutil.pid_exists(pid)


def an_agent(name: str) -> str:
    """Settings of an agent that waits for ten minutes."""
    config = {"entities": [name], "wait_s": 600.0}
    return json.dumps({"endpoint": NOWHERE, "config": config, "is_quiet": True})


def names_only(process: psutil.Process, robot: str) -> bool:
    """Whether a command line names this robot, and no other of `r1` to `r3`."""
    return re.findall(r'"(r[1-3])"', " ".join(process.cmdline())) == [robot]


def is_down_after_watch(supervisor: Supervisor, log: RestartLog) -> bool:
    supervisor.watch()
    return bool(log.restarts)


def test_programs_that_are_alike_are_children_with_settings_of_their_own(
    supervisor: Supervisor, restart_log: RestartLog
) -> None:
    settings = {name: an_agent(name) for name in ("r1", "r2", "r3")}
    supervisor.start_alike("agent", settings)
    programs = list(supervisor.programs)
    for program in programs:
        eventually(partial(is_up_after_watch, supervisor, program), ENDS_S, "a process")

    for program, name in zip(programs, settings, strict=True):
        process = psutil.Process(find_pid(program))
        eventually(partial(names_only, process, name), ENDS_S, "its settings")
        assert process.ppid() == os.getpid()
        assert os.getsid(process.pid) == process.pid

    psutil.Process(first := find_pid(programs[0])).kill()
    eventually(partial(is_down_after_watch, supervisor, restart_log), ENDS_S, "its end")
    eventually(lambda: is_up_after_watch(supervisor, programs[0]), ENDS_S, "a process again")
    assert restart_log.restarts == [("r1", -9)]
    assert find_pid(programs[0]) != first


def test_programs_that_are_alike_start_one_by_one_when_their_copies_fail(
    supervisor: Supervisor, capfd: pytest.CaptureFixture[str]
) -> None:
    supervisor.start_alike("agent", {"r1": an_agent("r1"), "r2": "{}"})
    first, _ = supervisor.programs

    eventually(lambda: is_up_after_watch(supervisor, first), ENDS_S, "a process")

    assert psutil.Process(find_pid(first)).ppid() == os.getpid()
    supervisor.close()
    assert "endpoint" in capfd.readouterr().err


def test_end_takes_programs_whose_copies_are_not_made_yet(supervisor: Supervisor) -> None:
    others = set(psutil.Process().children(recursive=True))
    supervisor.start_alike("agent", {name: an_agent(name) for name in ("r1", "r2")})
    before = set(psutil.Process().children(recursive=True)) - others

    supervisor.close()

    assert before
    assert not any(one.is_running() for one in before)
    assert set(psutil.Process().children(recursive=True)) <= others


def test_program_runs_in_its_own_session(supervisor: Supervisor) -> None:
    program = supervisor.start("waiting", WAITING)

    process = psutil.Process(find_pid(program))
    # The kernel provides both shortly after the start.
    eventually(lambda: process.cmdline() or None, ENDS_S, "a command line")
    eventually(lambda: process.environ() or None, ENDS_S, "an environment")
    assert process.cmdline() == [sys.executable, "-m", "zensim", *WAITING]
    assert process.environ()[PARENT_PID_VARIABLE] == str(os.getpid())
    assert os.getsid(process.pid) == process.pid
    assert supervisor.programs == [program]


def test_settings_of_the_started_command_are_hidden_and_others_stay() -> None:
    given = {
        "ZENSIM_CONFIG": "a.yaml",
        "ZENSIM_SENSORS_RUN_METRICS": "9464",
        "ZENSIM_SERVE_RTF": "2",
        "ZENSIM_ENGINE": "mujoco",
        "ZENSIM_TOKEN": "@file",
        "PATH": "/bin",
    }

    assert hide_settings(given, "sensors") == {
        "ZENSIM_CONFIG": "",
        "ZENSIM_SENSORS_RUN_METRICS": "",
        "ZENSIM_ENGINE": "",
    }
    assert hide_settings(given, "") == {"ZENSIM_CONFIG": "", "ZENSIM_ENGINE": ""}


def test_output_of_a_program_is_readable(supervisor: Supervisor) -> None:
    program = supervisor.start("quick", (*QUICK, "--json"))

    assert program.process is not None
    assert program.process.stdout is not None
    assert b'"name": "box_bot"' in program.process.stdout.read()


def test_running_program_is_not_restarted(supervisor: Supervisor, restart_log: RestartLog) -> None:
    program = supervisor.start("waiting", WAITING)

    supervisor.watch()

    assert not is_gone(find_pid(program))
    assert restart_log.restarts == []


@pytest.mark.parametrize(("arguments", "status"), [(QUICK, 0), (MISTYPED, 3)])
def test_exit_without_restart_is_an_error(
    supervisor: Supervisor, arguments: tuple[str, ...], status: int
) -> None:
    supervisor.start("waiting", WAITING)
    wait_for_exit(supervisor.start("server", arguments))

    with pytest.raises(ProgramDied, match=f"server .* {status}$"):
        supervisor.watch()


def test_program_is_restarted_after_a_delay(
    supervisor: Supervisor, restart_log: RestartLog
) -> None:
    program = supervisor.start("agent", WAITING, is_restarted=True)
    first = find_pid(program)
    os.kill(first, signal.SIGKILL)
    wait_for_exit(program)
    program.started_s = time.monotonic()

    supervisor.watch()
    was_started_at_once = program.process is not None
    eventually(lambda: is_up_after_watch(supervisor, program), ENDS_S)

    assert not was_started_at_once
    assert restart_log.restarts == [("agent", -signal.SIGKILL)]
    assert program.restarts == 1
    assert find_pid(program) != first


@pytest.mark.parametrize(
    ("arguments", "number", "is_restarted"),
    [(WAITING, signal.SIGKILL, True), (MISTYPED, None, False)],
    ids=["killed", "failed"],
)
def test_program_may_be_restarted_only_if_it_was_killed(
    supervisor: Supervisor,
    arguments: tuple[str, ...],
    number: signal.Signals | None,
    *,
    is_restarted: bool,
) -> None:
    program = supervisor.start("recorder", arguments, is_essential=False)
    program.is_restarted_if_killed = True
    if number is not None:
        os.kill(find_pid(program), number)
    wait_for_exit(program)

    supervisor.watch()

    assert (program.restarts, program.failures) == (int(is_restarted), 1)


def test_steady_program_is_restarted_without_a_delay(supervisor: Supervisor) -> None:
    program = supervisor.start("agent", WAITING, is_restarted=True)
    os.kill(find_pid(program), signal.SIGKILL)
    wait_for_exit(program)
    program.started_s = time.monotonic() - 2 * STEADY_S

    supervisor.watch()

    assert program.restart_at_s <= time.monotonic()


def test_number_of_restarts_is_limited(supervisor: Supervisor) -> None:
    program = supervisor.start("agent", MISTYPED, is_restarted=True)
    program.restarts = MAX_RESTARTS
    wait_for_exit(program)

    with pytest.raises(ProgramDied, match=r"agent .* 3$"):
        supervisor.watch()


def test_restart_does_not_affect_other_programs(supervisor: Supervisor) -> None:
    first, second = (supervisor.start(name, WAITING, is_restarted=True) for name in ("a", "b"))
    second_pid = find_pid(second)
    os.kill(find_pid(first), signal.SIGKILL)
    wait_for_exit(first)

    supervisor.watch()

    assert find_pid(second) == second_pid
    assert not is_gone(second_pid)


def test_close_ends_a_server_with_status_0(supervisor: Supervisor) -> None:
    endpoint = free_endpoint()
    # It listens before it has started, and finishes that: 0.3 CPU s, longer on a loaded machine.
    arguments = ("serve", "--listen", endpoint)
    process = supervisor.start("server", arguments, grace_s=ENDS_S).process
    assert process is not None
    port = int(endpoint.rsplit(":", 1)[1])
    eventually(lambda: port in listening_ports(process.pid), ENDS_S, "listening")

    supervisor.close()

    assert process.returncode == 0
    assert is_gone(process.pid)


def listening_ports(pid: int) -> list[int]:
    connections = psutil.Process(pid).net_connections("tcp")
    return [one.laddr.port for one in connections if one.status == psutil.CONN_LISTEN]


def test_close_ends_all_programs(supervisor: Supervisor) -> None:
    pids = [find_pid(supervisor.start(name, WAITING)) for name in ("a", "b", "c")]

    supervisor.close()

    assert all(is_gone(pid) for pid in pids)
    assert supervisor.programs == []


def test_close_kills_a_suspended_program(supervisor: Supervisor) -> None:
    pid = find_pid(supervisor.start("stopped", WAITING))
    os.kill(pid, signal.SIGSTOP)

    supervisor.close()

    assert is_gone(pid)


def test_close_during_a_restart_delay(supervisor: Supervisor) -> None:
    waiting = supervisor.start("agent", WAITING, is_restarted=True)
    os.kill(find_pid(waiting), signal.SIGKILL)
    wait_for_exit(waiting)
    waiting.started_s = time.monotonic()
    supervisor.watch()
    other = find_pid(supervisor.start("other", WAITING))

    supervisor.close()

    assert is_gone(other)


def test_close_after_an_exit(supervisor: Supervisor) -> None:
    wait_for_exit(supervisor.start("server", MISTYPED))
    other = find_pid(supervisor.start("other", WAITING))
    with pytest.raises(ProgramDied):
        supervisor.watch()

    supervisor.close()
    supervisor.close()

    assert is_gone(other)


def test_close_leaves_no_open_files(supervisor: Supervisor) -> None:
    before = psutil.Process().num_fds()

    for _ in range(3):
        supervisor.start("waiting", WAITING)
        supervisor.close()

    assert psutil.Process().num_fds() == before
