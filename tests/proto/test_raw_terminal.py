"""A pseudo-terminal as raw terminal, and signals as bytes of a pipe."""

import os
import pty
import signal
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from zensim.proto.raw_terminal import NoTerminal, RawTerminal, open_signals, wait_for_input

LOCAL_FLAGS = 3


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The other side of the terminal of standard input."""
    screen, slave = pty.openpty()
    with os.fdopen(slave) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield screen
    os.close(screen)


def all_shown(screen: int, terminal: RawTerminal) -> bytes:
    """Return what has been written to the terminal, which may come in parts."""
    os.write(terminal.descriptor, b"END")
    shown = b""
    while not shown.endswith(b"END"):
        assert wait_for_input([screen], 5.0)
        shown += os.read(screen, 4096)
    return shown


def test_key_comes_at_once_and_the_terminal_is_put_back(screen: int) -> None:
    terminal = RawTerminal()
    before = termios.tcgetattr(terminal.descriptor)

    terminal.enter()
    raw = termios.tcgetattr(terminal.descriptor)
    os.write(screen, b"w")
    wait_for_input([terminal.descriptor], 5.0)
    data = terminal.read()
    terminal.leave()

    assert data == b"w"
    assert not raw[LOCAL_FLAGS] & (termios.ICANON | termios.ECHO)
    assert raw[LOCAL_FLAGS] & termios.ISIG
    assert termios.tcgetattr(terminal.descriptor) == before


@pytest.mark.parametrize("reports_keys", [False, True])
def test_focus_is_reported_only_where_it_is_wanted(screen: int, *, reports_keys: bool) -> None:
    terminal = RawTerminal()

    terminal.enter(reports_keys=reports_keys)
    terminal.show("r1\x1b[2J")
    terminal.leave()

    shown = all_shown(screen, terminal)
    assert (b"\x1b[?1004h" in shown) == (b"\x1b[?1004l" in shown) == reports_keys
    assert b"\x1b[2J" not in shown


def test_terminal_that_is_gone_reads_as_none(screen: int) -> None:
    terminal = RawTerminal()
    terminal.enter()
    other = os.dup(screen)
    os.close(other)
    os.dup2(os.open(os.devnull, os.O_RDONLY), screen)

    data = terminal.read()
    terminal.leave()

    assert data is None


def test_file_is_no_terminal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "keys").open("w+") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)

        with pytest.raises(NoTerminal):
            RawTerminal()


def test_signals_end_a_wait_and_are_handled_as_before_afterwards() -> None:
    before = signal.getsignal(signal.SIGTERM)

    with open_signals() as signals:
        os.kill(os.getpid(), signal.SIGTERM)
        ready = wait_for_input([signals.descriptor], 5.0)
        taken = signals.take()
        rest = signals.take()

    assert ready == {signals.descriptor}
    assert (taken, rest) == ([signal.SIGTERM], [])
    assert not signals.suspends(signal.SIGTERM)
    assert signals.suspends(signal.SIGTSTP)
    assert signal.getsignal(signal.SIGTERM) == before
