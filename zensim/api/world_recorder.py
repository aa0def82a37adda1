"""WorldRecorder: a recorder of a world, a process of its own."""

import threading
from pathlib import Path
from queue import Empty, SimpleQueue

from zensim.api.api_errors import Error, Timeout
from zensim.api.closed_on_exit import ClosedOnExit
from zensim.api.program_keeper import ProgramOutput
from zensim.api.recording_file import Recording
from zensim.proto.supervisor import Supervisor


class WorldRecorder(ClosedOnExit):
    """Records topics of a world until it or its simulation is closed.

    Attributes:
        path: File or folder that is written.
    """

    def __init__(
        self, address: str, world: str, path: Path, options: tuple[str, ...], timeout_s: float
    ) -> None:
        """Start to record; see `Sim.record`."""
        self.path = path
        self._arguments = (
            *("record", "--json", "--quiet", "--output", str(path)),
            *("--connect", address, "--world-name", world),
            *options,
        )
        self._output = ProgramOutput()
        self._is_over = threading.Event()
        self._lines: SimpleQueue[str] = SimpleQueue()
        # The kernel ends a program with the thread that started it.
        self._thread = threading.Thread(target=self._run, name="zensim record", daemon=True)
        self._thread.start()
        try:
            line = self._lines.get(timeout=timeout_s)
        except Empty as error:
            self.close()
            raise Timeout(f"'{path}' is not recorded after {timeout_s:g} s") from error
        if not line:
            self.close()
            reason = ": ".join([f"'{path}' cannot be recorded", *list(self._output.lines)[-1:]])
            raise Error(reason, slug="no_recorder")

    def close(self) -> None:
        """End the recording; its files are whole then. May be repeated."""
        if not self._is_over.is_set():
            self._is_over.set()
            self._thread.join()
            self._output.close()

    def read(self) -> Recording:
        """End the recording, and read it."""
        self.close()
        return Recording(self.path)

    def _run(self) -> None:
        supervisor = Supervisor(lambda _program, _status: None, self._output.descriptor)
        program = supervisor.start("recorder", self._arguments, is_essential=False)
        process = program.process
        threading.Thread(
            target=lambda: self._lines.put(
                process.stdout.readline().decode() if process and process.stdout else ""
            ),
            daemon=True,
        ).start()
        self._is_over.wait()
        supervisor.close()

    def __repr__(self) -> str:
        """Write the path."""
        return f"WorldRecorder({str(self.path)!r})"
