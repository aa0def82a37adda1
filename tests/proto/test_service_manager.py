"""What systemd is notified of, read from a real socket."""

import os
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.fakes import ManualClock
from zensim.proto.program_status import ProgramStatus
from zensim.proto.service_manager import ServiceManager


@pytest.fixture
def manager_socket(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as found:
        found.bind(str(tmp_path / "notify"))
        found.settimeout(0.0)
        yield found


def read_all(manager_socket: socket.socket) -> list[str]:
    found: list[str] = []
    with suppress(BlockingIOError):
        while True:
            found.append(manager_socket.recv(100).decode())
    return found


def make_variables(manager_socket: socket.socket, **others: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": manager_socket.getsockname(), **others}


def test_manager_is_notified_of_start_turns_and_end(manager_socket: socket.socket) -> None:
    times = ManualClock()
    variables = make_variables(manager_socket, WATCHDOG_USEC="30000000")
    status = ProgramStatus(times, ServiceManager(variables))

    before = read_all(manager_socket)
    for _ in range(25):
        status.note_turn()
        times.now_s += 1.0
    status.drain()
    status.drain()

    assert before == []
    assert read_all(manager_socket) == ["READY=1", "WATCHDOG=1", "WATCHDOG=1", "STOPPING=1"]


def test_watchdog_of_another_process_is_left_alone(manager_socket: socket.socket) -> None:
    variables = make_variables(
        manager_socket, WATCHDOG_USEC="1000", WATCHDOG_PID=str(os.getpid() + 1)
    )

    assert ServiceManager(variables).watchdog_period_s is None


def test_abstract_address_is_understood() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as found:
        name = f"zensim-{os.getpid()}"
        found.bind(f"\0{name}")
        found.settimeout(5.0)
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).notify("READY=1")

        assert found.recv(100) == b"READY=1"


@pytest.mark.parametrize("variables", [{}, {"NOTIFY_SOCKET": "/nowhere/at/all"}])
def test_without_a_manager_nothing_happens(variables: dict[str, str]) -> None:
    manager = ServiceManager(variables)

    manager.notify("READY=1")

    assert manager.watchdog_period_s is None
