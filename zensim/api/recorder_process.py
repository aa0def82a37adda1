"""RecorderProcess: a recorder of a world on a server, a process of its own."""

import threading
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue

import msgspec

from zensim.api.api_errors import Error, Timeout
from zensim.api.program_keeper import ProgramOutput
from zensim.api.world_recorder import WorldRecorder
from zensim.proto.supervisor import RECORDER_GRACE_S, Supervisor


class RecorderProcess(WorldRecorder):
    """Records by `zensim record` on this host."""

    def __init__(
        self, address: str, world: str, path: Path, options: tuple[str, ...], timeout_s: float
    ) -> None:
        """Start to record; see `Simulation.record`."""
        super().__init__(path)
        self._arguments = (
            *("record", "--json", "--quiet", "--output", str(self.path)),
            *("--connect", address, "--world-name", world),
            *options,
        )
        self._output = ProgramOutput()
        self._is_over = threading.Event()
        self._lines: SimpleQueue[str] = SimpleQueue()
        self._status: int | None = None
        # The kernel ends a program with the thread that started it.
        self._thread = threading.Thread(target=self._run, name="zensim record", daemon=True)
        self._thread.start()
        try:
            line = self._lines.get(timeout=timeout_s)
        except Empty as error:
            self._end()
            raise Timeout(f"'{path}' is not recorded after {timeout_s:g} s") from error
        if not line:
            self._end()
            raise self._make_error("cannot be recorded")

    def close(self) -> None:
        """See `WorldRecorder`."""
        if not self._is_over.is_set():
            self._end()
            if self._status:
                raise self._make_error("is not recorded to the end")

    def _end(self) -> None:
        self._is_over.set()
        self._thread.join()
        self._output.close()

    def _make_error(self, what: str) -> Error:
        reason = next(reversed(self._output.lines), "")
        with suppress(msgspec.DecodeError, LookupError, TypeError):
            reason = msgspec.json.decode(reason)["error"]["message"]
        return Error(f"'{self.path}' {what}: {reason}", slug="no_recorder")

    def _run(self) -> None:
        supervisor = Supervisor(lambda _program, _status: None, self._output.descriptor)
        program = supervisor.start(
            "recorder", self._arguments, is_essential=False, grace_s=RECORDER_GRACE_S
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
        self._status = process.returncode if process is not None else None
