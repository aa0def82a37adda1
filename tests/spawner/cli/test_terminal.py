"""Commands on a terminal: what asks, what redraws, what shows progress."""

import os
import pty
import select
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

from tests.integration.processes import Server, command_line, end, eventually
from zensim.proto.exit_codes import ExitCode
from zensim.proto.process_limits import PARENT_PID_VARIABLE

WITHIN_S = 20.0


@dataclass
class Terminal:
    """A command and the screen that it writes on."""

    process: "subprocess.Popen[str]"
    screen: int
    said: str = field(default="")

    def shows(self, text: str) -> None:
        """Wait until this has been written."""
        eventually(lambda: text in self._read(), WITHIN_S, f"{text!r}")

    def type(self, keys: str) -> None:
        os.write(self.screen, keys.encode())

    def status(self) -> int:
        """Wait for the end, and return how it was."""
        eventually(self._has_ended, WITHIN_S, "the end")
        return self.process.wait()

    def _has_ended(self) -> bool:
        self._read()
        return self.process.poll() is not None

    def _read(self) -> str:
        while select.select([self.screen], [], [], 0.01)[0]:
            self.said += os.read(self.screen, 65536).decode(errors="replace")
        return self.said


@contextmanager
def on_terminal(server: Server, *arguments: str) -> Iterator[Terminal]:
    """Run a command with a terminal for everything; it is gone afterwards."""
    screen, slave = pty.openpty()
    process = subprocess.Popen(
        command_line([*arguments, "--connect", server.endpoint]),
        stdin=slave,
        stdout=slave,
        stderr=slave,
        text=True,
        start_new_session=True,
        env={
            **os.environ,
            PARENT_PID_VARIABLE: str(os.getpid()),
            "TERM": "xterm",
            "COLUMNS": "100",
        },
    )
    try:
        yield Terminal(process, screen)
    finally:
        end(process)
        os.close(screen)
        os.close(slave)


@pytest.mark.parametrize(
    ("answer", "status", "left"), [("n\n", ExitCode.FAILED, ("r1", "r2")), ("y\n", ExitCode.OK, ())]
)
def test_delete_asks_a_person_before_it_takes_all(
    two: Server, answer: str, status: ExitCode, left: tuple[str, ...]
) -> None:
    with on_terminal(two, "delete", "--all") as terminal:
        terminal.shows("Delete all 2 entities? [y/N]")
        terminal.type(answer)

        assert terminal.status() == status
    assert two.client.entities() == left


def test_delete_that_is_interrupted_at_its_question_takes_nothing(two: Server) -> None:
    with on_terminal(two, "delete", "--all") as terminal:
        terminal.shows("[y/N]")
        terminal.process.send_signal(signal.SIGINT)

        assert terminal.status() == ExitCode.INTERRUPTED
    assert two.client.entities() == ("r1", "r2")


def test_delete_does_not_ask_who_has_said_yes(two: Server) -> None:
    with on_terminal(two, "delete", "--all", "--yes") as terminal:
        assert terminal.status() == ExitCode.OK
    assert two.client.entities() == ()


def test_watch_redraws_until_it_is_interrupted(two: Server) -> None:
    with on_terminal(two, "list", "-w", "--every", "0.05") as terminal:
        terminal.shows("2 entities at 0.00 s; Ctrl-C ends")
        two.client.delete("r1")
        terminal.shows("1 entity at 0.00 s")
        terminal.process.send_signal(signal.SIGINT)

        assert terminal.status() == ExitCode.INTERRUPTED


def test_watch_keeps_what_it_saw_while_no_server_answers(two: Server) -> None:
    with on_terminal(two, "list", "-w", "--every", "0.05", "--timeout", "0.2") as terminal:
        terminal.shows("2 entities")
        two.process.send_signal(signal.SIGSTOP)
        try:
            terminal.shows("no server answers")
        finally:
            two.process.send_signal(signal.SIGCONT)
        terminal.said = ""
        terminal.shows("2 entities at 0.00 s")


def test_steps_show_their_progress(server: Server) -> None:
    with on_terminal(server, "step", "9999999") as terminal:
        terminal.shows("/9999999")
        terminal.process.send_signal(signal.SIGINT)

        assert terminal.status() == ExitCode.INTERRUPTED
    assert "canceled after" in terminal.said
