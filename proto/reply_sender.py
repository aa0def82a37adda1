"""Threads that send replies: a client that stops reading delays its own replies only."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, TypeAlias

MAX_THREADS: Final = 8
"""Clients that may stop reading at once without a delay for others."""
MAX_UNSENT_BYTES: Final = 16 << 20
"""Replies of one client that may wait to be sent; the next ones end without a value."""
REPLY_BYTES: Final = 4096
"""Memory of a reply that waits, besides its own bytes: its query, and what sends it."""
MAX_UNSENT: Final = 8192
"""Replies of all clients that may wait before no further queries are taken."""
MAX_BACKLOG: Final = 64
"""Replies of one client that may wait before its further requests wait, too."""
MAX_UNFINISHED: Final = 1024
"""The same for queries without a value; each keeps the 64 KiB in which it was received."""
CLOSE_TIMEOUT_S: Final = 1.0
LOG = logging.getLogger(__name__)

Send: TypeAlias = Callable[[], None]


@dataclass
class UnsentReplies:
    """Replies to one client, oldest first."""

    client: str
    queue: deque[tuple[Send, int]] = field(default_factory=deque)
    size: int = 0
    """Bytes of all replies."""
    is_stalled: bool = False
    """Whether `settle` has waited for it in vain since its last reply was sent."""


class ReplySender:
    """Sends replies in order of each client, at most one of each client at a time."""

    def __init__(self, max_threads: int = MAX_THREADS, max_bytes: int = MAX_UNSENT_BYTES) -> None:
        self._max_threads = max_threads
        self._max_bytes = max_bytes
        lock = threading.Lock()
        self._has_work = threading.Condition(lock)
        self._has_sent = threading.Condition(lock)
        self._unsent: dict[str, UnsentReplies] = {}
        self._ready: deque[UnsentReplies] = deque()
        """Clients with unsent replies that no thread serves."""
        self._threads = self._idle = self._count = 0
        self._is_closed = False
        self._finishes: deque[Send] = deque()
        self._has_finishes = threading.Event()
        self._finisher: threading.Thread | None = None
        self.prepare_thread: Callable[[], object] = lambda: None
        """Function that each thread calls first."""

    @property
    def is_full(self) -> bool:
        """Whether so many replies wait that no further queries should be taken."""
        return self._count >= MAX_UNSENT or len(self._finishes) >= MAX_UNFINISHED

    def send(self, client: str, size: int, send: Send, finish: Send) -> None:
        """Send a reply from another thread; too many unsent ones are finished without a value.

        Args:
            client: Whose replies stay in order.
            size: Bytes of the reply.
            send: Sends it and finishes the query; may block.
            finish: Finishes the query only.
        """
        with self._has_work:
            if (unsent := self._unsent.get(client)) is None:
                unsent = self._unsent[client] = UnsentReplies(client)
                self._ready.append(unsent)
                self._wake_thread()
            if unsent.queue and unsent.size + size > self._max_bytes:
                send, size = finish, 0
            unsent.queue.append((send, size))
            unsent.size += size
            self._count += 1

    def has_backlog(self, client: str) -> bool:
        """Whether many replies to a client wait to be sent."""
        unsent = self._unsent.get(client)
        return unsent is not None and len(unsent.queue) >= MAX_BACKLOG

    def finish(self, finish: Send) -> None:
        """Finish a query without a value from another thread, at a fraction of the cost of `send`.

        Args:
            finish: Finishes the query; may block.
        """
        self._finishes.append(finish)
        if not self._has_finishes.is_set():
            self._has_finishes.set()
            if self._finisher is None:
                self._finisher = threading.Thread(
                    target=self._run_finishes, name="finishes", daemon=True
                )
                self._finisher.start()

    def settle(self, timeout_s: float) -> None:
        """Wait until the replies are sent, but not for clients that have stopped reading.

        A client whose reply is unsent after the timeout is not waited for again before one is sent.
        """
        if not self._unsent:
            return
        deadline_s = time.monotonic() + timeout_s
        with self._has_sent:
            while waited := [one for one in self._unsent.values() if not one.is_stalled]:
                if (left_s := deadline_s - time.monotonic()) <= 0.0:
                    for unsent in waited:
                        unsent.is_stalled = True
                    return
                self._has_sent.wait(left_s)

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> None:
        """Send what is unsent, for a time at most, and end the threads."""
        deadline_s = time.monotonic() + timeout_s
        with self._has_sent:
            while self._unsent and (left_s := deadline_s - time.monotonic()) > 0.0:
                self._has_sent.wait(left_s)
            self._is_closed = True
            self._has_work.notify_all()
        self._has_finishes.set()
        if self._finisher is not None:
            self._finisher.join(max(0.0, deadline_s - time.monotonic()))

    def _wake_thread(self) -> None:
        if len(self._ready) <= self._idle:
            self._has_work.notify()
        elif self._threads < self._max_threads:
            self._threads += 1
            self._idle += 1
            threading.Thread(target=self._run, name="replies", daemon=True).start()

    def _run(self) -> None:
        self.prepare_thread()
        while (unsent := self._take_client()) is not None:
            try:
                unsent.queue[0][0]()
            except Exception:  # else all later replies to this client would wait for ever
                LOG.exception("reply not sent client=%s", unsent.client)
            self._note_sent(unsent)

    def _run_finishes(self) -> None:
        self.prepare_thread()
        while not self._is_closed or self._finishes:
            self._has_finishes.wait()
            self._has_finishes.clear()
            while self._finishes:
                _finish(self._finishes.popleft())

    def _take_client(self) -> UnsentReplies | None:
        with self._has_work:
            while not (self._ready or self._is_closed):
                self._has_work.wait()
            if self._is_closed:
                return None
            self._idle -= 1
            return self._ready.popleft()

    def _note_sent(self, unsent: UnsentReplies) -> None:
        with self._has_work:
            _, size = unsent.queue.popleft()
            unsent.size -= size
            self._count -= 1
            unsent.is_stalled = False
            self._idle += 1
            if unsent.queue:
                self._ready.append(unsent)
            else:
                del self._unsent[unsent.client]
            self._has_sent.notify_all()


def _finish(finish: Send) -> None:
    try:
        finish()
    except Exception:  # else all later ones would wait for ever
        LOG.exception("query not finished")
