"""RecorderProcess: a recorder of a world on a server, a process of its own."""

from pathlib import Path

from zensim.api.program_thread import ProgramThread
from zensim.api.world_recorder import WorldRecorder
from zensim.proto.supervisor import RECORDER_GRACE_S


class RecorderProcess(WorldRecorder):
    """Records by `zensim record` on this host."""

    def __init__(
        self, address: str, world: str, path: Path, options: tuple[str, ...], timeout_s: float
    ) -> None:
        """Start to record; see `Simulation.record`."""
        super().__init__(path)
        arguments = (
            *("record", "--json", "--quiet", "--output", str(self.path)),
            *("--connect", address, "--world-name", world),
            *options,
        )
        self._program = ProgramThread("recorder", arguments, RECORDER_GRACE_S)
        self._program.read_line(timeout_s, f"'{path}' is not recorded")

    def close(self) -> None:
        """See `WorldRecorder`."""
        if self._program.close() and self._program.status:
            raise self._program.make_error(f"'{self.path}' is not recorded to the end")
