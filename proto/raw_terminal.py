"""A terminal that passes each key at once, and the signals that end or suspend the program."""

import os
import select
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final

from zensim.proto.printable_text import printable
from zensim.proto.terminal_keys import IGNORE_FOCUS, IGNORE_RELEASES, REPORT_FOCUS, REPORT_RELEASES

CLEAR_LINE: Final = "\r\x1b[K"
READ_BYTES: Final = 4096


class NoTerminal(ValueError):
    """Standard input is not a terminal."""


class RawTerminal:
    """The terminal of standard input, between `enter` and `leave`."""

    def __init__(self) -> None:
        """Find the terminal.

        Raises:
            NoTerminal: There is none.
        """
        if sys.platform == "win32":
            raise NoTerminal("keys are read from terminals of Linux and macOS only")
        if not sys.stdin.isatty():
            raise NoTerminal(
                "standard input is not a terminal, so there are no keys to read; run it in a "
                "terminal, or use 'zensim drive'"
            )
        self.descriptor = sys.stdin.fileno()
        self._saved: list[Any] | None = None
        self._reports_keys = False

    def enter(self, *, reports_keys: bool = False) -> None:
        """Pass each key at once, without echo.

        Args:
            reports_keys: Whether to ask for changes of focus, and for releases of keys.
        """
        import termios  # noqa: PLC0415  not on every system
        import tty  # noqa: PLC0415

        self._saved = list(termios.tcgetattr(self.descriptor))
        tty.setcbreak(self.descriptor, termios.TCSANOW)
        changed = termios.tcgetattr(self.descriptor)
        changed[0] &= ~termios.IXON  # Ctrl-S would suspend what this program writes
        termios.tcsetattr(self.descriptor, termios.TCSANOW, changed)
        self._reports_keys = reports_keys
        if reports_keys:
            self._send(REPORT_FOCUS + REPORT_RELEASES)

    def leave(self) -> None:
        """Put the terminal back as it was; one that is gone is left."""
        import termios  # noqa: PLC0415

        saved, self._saved = self._saved, None
        if saved is None:
            return
        self._send(CLEAR_LINE)
        if self._reports_keys:
            self._send(IGNORE_RELEASES + IGNORE_FOCUS)
        with suppress(termios.error):
            termios.tcsetattr(self.descriptor, termios.TCSANOW, saved)

    def show(self, line: str) -> None:
        """Replace the line of the cursor."""
        self._send(CLEAR_LINE + printable(line))

    def read(self) -> bytes | None:
        """Read the keys that wait; None if the terminal is gone."""
        try:
            return os.read(self.descriptor, READ_BYTES) or None
        except OSError:
            return None

    def _send(self, text: str) -> None:
        # A terminal that takes no output, as over a link that hangs, must not block this program.
        with suppress(OSError):
            if select.select((), (self.descriptor,), (), 0.0)[1]:
                os.write(self.descriptor, text.encode())


ENDING: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
SUSPENDING: Final = "SIGTSTP"


class SignalPipe:
    """Signals as bytes of a pipe, so that a wait for keys ends at once."""

    def __init__(self) -> None:
        self.descriptor, self._end = os.pipe()
        os.set_blocking(self.descriptor, False)
        os.set_blocking(self._end, False)
        names = (*ENDING, SUSPENDING)
        numbers = [signal.Signals[name] for name in names if hasattr(signal, name)]
        self._before = {number: signal.signal(number, self._note) for number in numbers}

    def take(self) -> list[signal.Signals]:
        """Take the signals that came."""
        try:
            return [signal.Signals(code) for code in os.read(self.descriptor, 64)]
        except BlockingIOError:
            return []

    def suspends(self, number: signal.Signals) -> bool:
        """Whether a signal suspends a process, as Ctrl-Z does, instead of ending it."""
        return number.name == SUSPENDING

    def suspend(self) -> None:
        """Suspend this process, until it is continued."""
        number = signal.Signals[SUSPENDING]
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, self._note)

    def close(self) -> None:
        """Handle signals as before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self.descriptor)
        os.close(self._end)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        with suppress(BlockingIOError):
            os.write(self._end, bytes([number]))


@contextmanager
def open_signals() -> Iterator[SignalPipe]:
    """Take signals while the block runs."""
    signals = SignalPipe()
    try:
        yield signals
    finally:
        signals.close()


def wait_for_input(descriptors: Sequence[int], timeout_s: float) -> frozenset[int]:
    """Wait until a descriptor can be read; return those that can."""
    return frozenset(select.select(descriptors, (), (), max(0.0, timeout_s))[0])
