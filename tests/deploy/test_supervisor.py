"""Supervisor: starts real processes, restarts those that should be, leaves none."""

import os
import signal
import sys
from collections.abc import Iterator

import psutil
import pytest

from tests.integration.processes import eventually, free_endpoint
from zensim.deploy.supervisor import MAX_RESTARTS, ProgramDied, SupervisedProgram, Supervisor
from zensim.proto.process_limits import PARENT_PID_VARIABLE

NOWHERE = "tcp/127.0.0.1:1"
WAITING = ("spawn", "box_bot", "--wait", "600", "--connect", NOWHERE)
"""Does nothing for ten minutes."""
QUICK = ("model", "box_bot")
MISTYPED = ("model", "nowhere.urdf")
ENDS_S = 40.0


class Notes:
    """What a supervisor said of restarts."""

    def __init__(self) -> None:
        self.restarts: list[tuple[str, int]] = []

    def take(self, program: SupervisedProgram, status: int) -> None:
        self.restarts.append((program.name, status))


@pytest.fixture
def notes() -> Notes:
    return Notes()


@pytest.fixture
def supervisor(notes: Notes) -> Iterator[Supervisor]:
    made = Supervisor(notes.take)
    yield made
    made.close()


def pid_of(program: SupervisedProgram) -> int:
    assert program.process is not None
    return program.process.pid


def wait_for_end(program: SupervisedProgram) -> int:
    process = program.process
    assert process is not None
    return eventually(lambda: process.poll() is not None, ENDS_S) and process.returncode


def is_up_after_watch(supervisor: Supervisor, program: SupervisedProgram) -> bool:
    supervisor.watch()
    return program.process is not None


def is_gone(pid: int) -> bool:
    return not psutil.pid_exists(pid)


def test_supervisor_starts_zensim_in_a_session_of_its_own(supervisor: Supervisor) -> None:
    program = supervisor.start("waiting", WAITING)

    process = psutil.Process(pid_of(program))
    # The kernel tells both a moment after the process is there.
    eventually(lambda: process.cmdline() or None, ENDS_S, "a command line")
    eventually(lambda: process.environ() or None, ENDS_S, "an environment")
    assert process.cmdline() == [sys.executable, "-m", "zensim", *WAITING]
    assert process.environ()[PARENT_PID_VARIABLE] == str(os.getpid())
    assert os.getsid(process.pid) == process.pid
    assert supervisor.programs == [program]


def test_supervisor_gives_what_a_program_prints(supervisor: Supervisor) -> None:
    program = supervisor.start("quick", (*QUICK, "--json"))

    assert program.process is not None
    assert program.process.stdout is not None
    assert b'"name": "box_bot"' in program.process.stdout.read()


def test_supervisor_says_nothing_while_everything_is_up(
    supervisor: Supervisor, notes: Notes
) -> None:
    program = supervisor.start("waiting", WAITING)

    supervisor.watch()

    assert not is_gone(pid_of(program))
    assert notes.restarts == []


@pytest.mark.parametrize(("arguments", "status"), [(QUICK, 0), (MISTYPED, 3)])
def test_supervisor_raises_when_a_program_ends_that_may_not(
    supervisor: Supervisor, arguments: tuple[str, ...], status: int
) -> None:
    supervisor.start("waiting", WAITING)
    wait_for_end(supervisor.start("server", arguments))

    with pytest.raises(ProgramDied, match=rf"^server\b.*\b{status}$"):
        supervisor.watch()


def test_supervisor_restarts_a_program_after_a_pause(supervisor: Supervisor, notes: Notes) -> None:
    program = supervisor.start("agent", WAITING, is_restarted=True)
    first = pid_of(program)
    os.kill(first, signal.SIGKILL)
    wait_for_end(program)

    supervisor.watch()
    was_started_at_once = program.process is not None
    eventually(lambda: is_up_after_watch(supervisor, program), ENDS_S)

    assert not was_started_at_once
    assert notes.restarts == [("agent", -signal.SIGKILL)]
    assert program.restarts == 1
    assert pid_of(program) != first


def test_supervisor_gives_a_program_up_that_was_restarted_often(supervisor: Supervisor) -> None:
    program = supervisor.start("agent", MISTYPED, is_restarted=True)
    program.restarts = MAX_RESTARTS
    wait_for_end(program)

    with pytest.raises(ProgramDied, match=r"agent\b.*\b3\b"):
        supervisor.watch()


def test_supervisor_goes_on_with_the_others_when_one_is_restarted(supervisor: Supervisor) -> None:
    first, second = (supervisor.start(name, WAITING, is_restarted=True) for name in ("a", "b"))
    kept = pid_of(second)
    os.kill(pid_of(first), signal.SIGKILL)
    wait_for_end(first)

    supervisor.watch()

    assert pid_of(second) == kept
    assert not is_gone(kept)


def test_supervisor_ends_a_server_cleanly(supervisor: Supervisor) -> None:
    endpoint = free_endpoint()
    process = supervisor.start("server", ("serve", "--listen", endpoint)).process
    assert process is not None
    port = int(endpoint.rsplit(":", 1)[1])
    eventually(lambda: port in listening_ports(process.pid), ENDS_S, "listening")

    supervisor.close()

    assert process.returncode == 0
    assert is_gone(process.pid)


def listening_ports(pid: int) -> list[int]:
    connections = psutil.Process(pid).net_connections("tcp")
    return [one.laddr.port for one in connections if one.status == psutil.CONN_LISTEN]


def test_supervisor_leaves_nobody_when_closed(supervisor: Supervisor) -> None:
    pids = [pid_of(supervisor.start(name, WAITING)) for name in ("a", "b", "c")]

    supervisor.close()

    assert all(is_gone(pid) for pid in pids)
    assert supervisor.programs == []


def test_supervisor_kills_who_does_not_end_by_himself(supervisor: Supervisor) -> None:
    pid = pid_of(supervisor.start("stopped", WAITING))
    os.kill(pid, signal.SIGSTOP)

    supervisor.close()

    assert is_gone(pid)


def test_supervisor_closes_while_a_program_waits_for_its_restart(supervisor: Supervisor) -> None:
    waiting = supervisor.start("agent", WAITING, is_restarted=True)
    os.kill(pid_of(waiting), signal.SIGKILL)
    wait_for_end(waiting)
    supervisor.watch()
    other = pid_of(supervisor.start("other", WAITING))

    supervisor.close()

    assert is_gone(other)


def test_supervisor_closes_after_a_program_died(supervisor: Supervisor) -> None:
    wait_for_end(supervisor.start("server", MISTYPED))
    other = pid_of(supervisor.start("other", WAITING))
    with pytest.raises(ProgramDied):
        supervisor.watch()

    supervisor.close()
    supervisor.close()

    assert is_gone(other)


def test_supervisor_leaves_no_file_open(supervisor: Supervisor) -> None:
    before = psutil.Process().num_fds()

    for _ in range(3):
        supervisor.start("waiting", WAITING)
        supervisor.close()

    assert psutil.Process().num_fds() == before
