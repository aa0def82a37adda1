"""Commands on a terminal: confirmation, redrawing, progress bars."""

import signal

import pytest

from tests.integration.processes import Server
from tests.integration.terminals import on_terminal
from zensim.proto.exit_codes import ExitCode


@pytest.mark.parametrize(
    ("reply", "status", "left"), [("n\n", ExitCode.FAILED, ("r1", "r2")), ("y\n", ExitCode.OK, ())]
)
def test_delete_all_asks_for_confirmation(
    two: Server, reply: str, status: ExitCode, left: tuple[str, ...]
) -> None:
    with on_terminal(two, "delete", "--all") as terminal:
        terminal.wait_for("[y/N]")
        terminal.type(reply)

        assert terminal.status() == status
    assert two.client.entities() == left


def test_delete_all_deletes_nothing_after_an_interrupt(two: Server) -> None:
    with on_terminal(two, "delete", "--all") as terminal:
        terminal.wait_for("[y/N]")
        terminal.process.send_signal(signal.SIGINT)

        assert terminal.status() == ExitCode.INTERRUPTED
    assert two.client.entities() == ("r1", "r2")


def test_delete_all_yes_does_not_ask(two: Server) -> None:
    with on_terminal(two, "delete", "--all", "--yes") as terminal:
        assert terminal.status() == ExitCode.OK
    assert two.client.entities() == ()


def test_watch_redraws_until_interrupted(two: Server) -> None:
    with on_terminal(two, "list", "-w", "--every", "0.05") as terminal:
        terminal.wait_for("2 entities at 0.00 s")
        two.client.delete("r1")
        terminal.wait_for("1 entity at 0.00 s")
        terminal.process.send_signal(signal.SIGINT)

        assert terminal.status() == ExitCode.INTERRUPTED


def test_watch_shows_the_last_state_while_the_server_is_suspended(two: Server) -> None:
    with on_terminal(two, "list", "-w", "--every", "0.05", "--timeout", "0.2") as terminal:
        terminal.wait_for("2 entities")
        two.process.send_signal(signal.SIGSTOP)
        try:
            terminal.wait_for("no server")
        finally:
            two.process.send_signal(signal.SIGCONT)
        terminal.output = ""
        terminal.wait_for("2 entities at 0.00 s")


def test_step_shows_progress(server: Server) -> None:
    with on_terminal(server, "step", "9999999") as terminal:
        terminal.wait_for("/9999999")
        terminal.process.send_signal(signal.SIGINT)

        assert terminal.status() == ExitCode.INTERRUPTED
    assert "zensim step: " in terminal.output
