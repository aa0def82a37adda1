"""Commands on pseudo-terminals."""

import fcntl
import os
import pty
import select
import struct
import subprocess
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Protocol

from tests.integration.processes import command_line, end, eventually
from zensim.proto.parent_death import PARENT_PID_VARIABLE

WITHIN_S = 20.0


@dataclass
class Terminal:
    """A command and its screen."""

    process: "subprocess.Popen[str]"
    screen: int
    output: str = field(default="")

    def wait_for(self, text: str) -> None:
        """Wait until a text was printed."""
        eventually(lambda: text in self._read(), WITHIN_S, f"{text!r}")

    def type(self, keys: str) -> None:
        os.write(self.screen, keys.encode())

    def status(self) -> int:
        """Wait for the exit status."""
        eventually(self._has_exited, WITHIN_S, "exit")
        return self.process.wait()

    def close(self) -> None:
        """Close the screen, as a terminal does whose window is closed."""
        if self.screen >= 0:
            os.close(self.screen)
        self.screen = -1

    def _has_exited(self) -> bool:
        self._read()
        return self.process.poll() is not None

    def _read(self) -> str:
        # A pseudo-terminal whose program has exited cannot be read.
        with suppress(OSError):
            while self.screen >= 0 and select.select([self.screen], [], [], 0.01)[0]:
                self.output += os.read(self.screen, 65536).decode(errors="replace")
        return self.output


class Reachable(Protocol):
    """A server at an endpoint."""

    @property
    def endpoint(self) -> str:
        """Where it listens."""


@contextmanager
def on_terminal(server: Reachable | None, *arguments: str) -> Iterator[Terminal]:
    """Run a command on a pseudo-terminal of 30 lines of 100 columns, and end it."""
    connection = () if server is None else ("--connect", server.endpoint)
    screen, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    # The first terminal that the leader of a session opens controls it, so that Ctrl-C is a signal.
    take_over = ["sh", "-c", 'exec 0<>"$0" 1>&0 2>&0 && exec "$@"', os.ttyname(slave)]
    process = subprocess.Popen(
        [*take_over, *command_line([*arguments, *connection])],
        text=True,
        start_new_session=True,
        env={
            **os.environ,
            PARENT_PID_VARIABLE: str(os.getpid()),
            "TERM": "xterm-256color",
            "COLUMNS": "100",
        },
    )
    terminal = Terminal(process, screen)
    try:
        yield terminal
    finally:
        end(process)
        terminal.close()
        os.close(slave)
