"""ProgramThread: one program of this host, started, and ended when it is closed."""

import threading
from collections.abc import Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue

import msgspec

from zensim.api.api_errors import Error, Timeout
from zensim.api.program_keeper import ProgramOutput
from zensim.proto.supervisor import Supervisor


class ProgramThread:
    """Runs a program; the kernel ends it with the thread that started it.

    Attributes:
        status: Exit status; None before the end.
    """

    def __init__(self, name: str, arguments: Sequence[str], grace_s: float) -> None:
        """Start `zensim` with arguments.

        Args:
            name: Of the program in logs.
            arguments: Of the command line.
            grace_s: Time to end by itself when it is closed.
        """
        self._name, self._arguments, self._grace_s = name, tuple(arguments), grace_s
        self._output = ProgramOutput()
        self._is_over = threading.Event()
        self._lines: SimpleQueue[str] = SimpleQueue()
        self.status: int | None = None
        self._thread = threading.Thread(target=self._run, name=f"zensim {name}", daemon=True)
        self._thread.start()

    def read_line(self, timeout_s: float, what: str) -> str:
        """Read the first line that it prints; close it where there is none.

        Args:
            timeout_s: Wall time.
            what: Says what has not happened, for errors.

        Raises:
            Timeout: It prints nothing in time.
            Error: It has ended.
        """
        try:
            line = self._lines.get(timeout=timeout_s)
        except Empty as error:
            self.close()
            raise Timeout(f"{what} after {timeout_s:g} s") from error
        if not line:
            self.close()
            raise self.make_error(what)
        return line

    def close(self) -> bool:
        """End the program; return whether it was not closed before."""
        if self._is_over.is_set():
            return False
        self._is_over.set()
        self._thread.join()
        self._output.close()
        return True

    def make_error(self, what: str) -> Error:
        """Make an error with the last line of the program, or with the message of its JSON."""
        reason = next(reversed(self._output.lines), "")
        with suppress(msgspec.DecodeError, LookupError, TypeError):
            reason = msgspec.json.decode(reason)["error"]["message"]
        return Error(f"{what}: {reason}", slug=f"no_{self._name}")

    def _run(self) -> None:
        supervisor = Supervisor(lambda _program, _status: None, self._output.descriptor)
        program = supervisor.start(
            self._name, self._arguments, is_essential=False, grace_s=self._grace_s
        )
        process = program.process
        threading.Thread(
            target=lambda: self._lines.put(
                process.stdout.readline().decode() if process and process.stdout else ""
            ),
            daemon=True,
        ).start()
        self._is_over.wait()
        supervisor.close()
        self.status = process.returncode if process is not None else None
