"""Writers of a recording: a thread, so that a slow disk delays no message, or the caller."""

import errno
import threading
import time
from queue import SimpleQueue
from typing import Final, NamedTuple, Protocol

from zensim.recording.mcap_records import AttachedFile
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic
from zensim.recording.recording_parts import RecordingParts
from zensim.recording.written_topics import measure_messages

IDLE_S: Final = 0.1
"""Time between two turns of the thread: one for each batch would cost as much as the writing."""


class NewPart(NamedTuple):
    """Order to begin the next file, with these times [ns]."""

    log_ns: int
    publish_ns: int


Batch = list[RecordedMessage]
Order = Batch | AttachedFile | NewPart


class MessageWriter(Protocol):
    """Writes what a recorder hands over."""

    lost: int
    """Messages for which there was no room, or that came after the failure."""
    failure: OSError | None
    """What ended the recording."""

    def put(self, batch: Batch) -> None:
        """Take messages."""

    def order(self, order: AttachedFile | NewPart) -> None:
        """Take another order."""

    def stop(self) -> None:
        """Write what waits."""


class DirectWriter:
    """Writes at once: the caller waits for the disk, and nothing is lost before it fails."""

    def __init__(self, parts: RecordingParts[RecordedTopic]) -> None:
        self._parts = parts
        self.lost = 0
        self.failure: OSError | None = None

    def put(self, batch: Batch) -> None:
        """Write messages."""
        left = len(batch)
        try:
            for message in batch if self.failure is None else ():
                left -= 1
                self._parts.write(message)
            self._parts.flush_if_due(time.monotonic())
        except OSError as error:
            self.failure = self.failure or error
        if self.failure is not None:
            self.lost += left

    def order(self, order: AttachedFile | NewPart) -> None:
        """Obey another order."""
        if self.failure is not None:
            return
        try:
            obey(self._parts, order)
        except OSError as error:
            self.failure = error

    def stop(self) -> None:
        """Do nothing: nothing waits."""


def obey(parts: RecordingParts[RecordedTopic], order: AttachedFile | NewPart) -> None:
    """Attach a file, or begin a new part.

    Raises:
        OSError: See `RecordingParts.write`.
    """
    if isinstance(order, AttachedFile):
        parts.attach(order)
    else:
        parts.start_part(order.log_ns, order.publish_ns)


class WriteQueue:
    """Messages that wait for the disk, and the thread that writes them."""

    def __init__(self, parts: RecordingParts[RecordedTopic], max_bytes: int) -> None:
        """Start the thread.

        Args:
            parts: Used by the thread only, until `stop` returns.
            max_bytes: Memory of the messages that wait; more are dropped.
        """
        self._parts = parts
        self._max_bytes = max_bytes
        self._orders: SimpleQueue[Order | None] = SimpleQueue()
        self._put_bytes = self._taken_bytes = 0
        self.lost = 0
        """Messages for which there was no room, or that came after the failure."""
        self.failure: OSError | None = None
        """What ended the recording."""
        self._left = 0
        self._is_ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def put(self, batch: Batch) -> None:
        """Hand over messages; drop them if too many wait."""
        if not batch:
            return
        size = measure_messages(batch)
        if self._put_bytes - self._taken_bytes + size > self._max_bytes:
            self.lost += len(batch)
            return
        self._put_bytes += size
        self._orders.put(batch)

    def order(self, order: AttachedFile | NewPart) -> None:
        """Hand over another order."""
        self._orders.put(order)

    def stop(self) -> None:
        """Write what waits, and end the thread."""
        self._orders.put(None)
        self._is_ending.set()
        self._thread.join()
        while not self._orders.empty():
            left = self._orders.get()
            self.lost += len(left) if isinstance(left, list) else 0

    def _run(self) -> None:
        try:
            while (order := self._take()) is not None:
                self._obey(order)
        except OSError as error:
            self.failure = error
        except Exception as error:  # noqa: BLE001  else the recorder runs on without a writer
            self.failure = OSError(errno.EIO, f"{type(error).__name__}: {error}")
            self.failure.__cause__ = error
        if self.failure is not None:
            self.lost += self._left

    def _take(self) -> Order | None:
        while self._orders.empty():
            self._is_ending.wait(IDLE_S)
            self._parts.flush_if_due(time.monotonic())
        return self._orders.get()

    def _obey(self, order: Order) -> None:
        if not isinstance(order, list):
            obey(self._parts, order)
        else:
            self._left = len(order)
            for message in order:
                self._left -= 1
                self._parts.write(message)
            self._taken_bytes += measure_messages(order)
        self._parts.flush_if_due(time.monotonic())
