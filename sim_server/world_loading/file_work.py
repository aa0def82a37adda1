"""Reading of the operator's files in a thread, which a stalled file system may keep for ever."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from zensim.proto.bounded_files import read_file
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

STALL_TIMEOUT_S: Final = 1.0
"""A thread that has read nothing for so long waits for a file system that does not answer."""
Found = TypeVar("Found")


class FilesStalled(ModelError):
    """A file system does not answer."""

    def __init__(self) -> None:
        super().__init__(
            f"a file below --model-path could not be read within {STALL_TIMEOUT_S:g} s; check that "
            "its file system answers",
            code=SpawnCode.MISSING_ASSETS,
            slug="world.stalled",
        )


def read_regular_file(
    path: Path, max_bytes: int, on_piece: Callable[[], None] = lambda: None
) -> bytes | None:
    """Read a file; None if it is missing, too large, or anything but a regular file."""
    with suppress(OSError, ValueError):
        return read_file(path, max_bytes, on_piece)
    return None


class FileWork(Generic[Found]):
    """A function that reads files, in a thread of its own; the caller polls `is_over`."""

    def __init__(self, work: Callable[[Callable[[], None]], Found]) -> None:
        """Start it.

        Args:
            work: Calls its argument after each file that it has read, or part of it.
        """
        self._work = work
        self._found: Found | None = None
        self._error: BaseException | None = None
        self._is_done = threading.Event()
        self._progress_s = time.monotonic()
        threading.Thread(target=self._run, name="files", daemon=True).start()

    def is_over(self) -> bool:
        """Whether `outcome` returns or raises now."""
        return self._is_done.is_set() or self.is_stalled

    def outcome(self) -> Found:
        """Return what the function returned, or raise what it raised.

        Raises:
            FilesStalled: It waits for a file.
        """
        if not self._is_done.is_set():
            raise FilesStalled
        if self._error is not None:
            raise self._error
        return self._found  # type: ignore[return-value]

    @property
    def is_stalled(self) -> bool:
        """Whether it has read nothing for the timeout."""
        waited_s = time.monotonic() - self._progress_s
        return waited_s > STALL_TIMEOUT_S and not self._is_done.is_set()

    def _run(self) -> None:
        try:
            self._found = self._work(self._note_progress)
        except BaseException as error:  # noqa: BLE001  raised again by `outcome`
            self._error = error
        self._is_done.set()

    def _note_progress(self) -> None:
        self._progress_s = time.monotonic()
