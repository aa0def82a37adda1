"""The journal's thread: it alone waits for the disk. What has come meanwhile is one transaction."""

from __future__ import annotations

import sqlite3
import threading
from queue import SimpleQueue
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.sim_server.journal.records import Record

END_S = 1.5
"""How long a server that ends waits for the disk."""


class Disk(Protocol):
    """Where records end up."""

    def keep(self, records: Sequence[Record]) -> None:
        """Put a batch on the disk, all or nothing."""

    def close(self) -> None:
        """Let go of it."""


class Writer:
    """Takes records from the loop; says up to which position they are on the disk."""

    def __init__(self, disk: Disk, position: int) -> None:
        self.durable = position
        """Everything up to here is on the disk."""
        self.commits = 0
        self.failure: tuple[int, str] | None = None
        """Generation of the records that could not be written, and why."""
        self._disk = disk
        self._void = -1
        self._queue: SimpleQueue[Record | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs; if it does not, nothing is written any more."""
        return self._thread.is_alive()

    def submit(self, record: Record) -> None:
        """Hand a record over."""
        self._queue.put(record)

    def close(self) -> bool:
        """Write what is left and end; say whether the thread did within `END_S`."""
        self._queue.put(None)
        self._thread.join(END_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        is_over = False
        while not is_over:
            batch = self._batch()
            is_over = batch[-1] is None
            records = [r for r in batch if r is not None and r.generation > self._void]
            if records:
                self._write(records)
        self._disk.close()

    def _batch(self) -> list[Record | None]:
        batch = [self._queue.get()]
        # Only this thread takes, so what is there stays there.
        while batch[-1] is not None and not self._queue.empty():
            batch.append(self._queue.get())
        return batch

    def _write(self, records: list[Record]) -> None:
        try:
            self._disk.keep(records)
        except (sqlite3.Error, OSError) as error:
            self._void = records[-1].generation
            self.failure = (self._void, _reason(error))
            return
        self.durable = records[-1].position
        self.commits += 1


def _reason(error: Exception) -> str:
    text = (error.strerror if isinstance(error, OSError) else "") or str(error)
    return " ".join(text.split())[:200]
