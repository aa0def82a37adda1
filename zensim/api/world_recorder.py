"""WorldRecorder: a recorder of a world, until it or its simulation is closed."""

from abc import abstractmethod
from pathlib import Path

from zensim.api.closed_on_exit import ClosedOnExit
from zensim.api.recording_file import Recording


class WorldRecorder(ClosedOnExit):
    """Records topics of a world until it or its simulation is closed.

    Attributes:
        path: File or folder that is written, absolute.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()  # a program may change its directory

    @abstractmethod
    def close(self) -> None:
        """End the recording; its files are whole then. May be repeated.

        Raises:
            Error: It ended before, for example as the disk is full; what was written is readable.
        """

    def read(self) -> Recording:
        """End the recording, and read it."""
        self.close()
        return Recording(self.path)

    def __repr__(self) -> str:
        """Write the path."""
        return f"{type(self).__name__}({str(self.path)!r})"
