"""Liveliness tokens of large fleets: declared in a thread that takes a tenth of a core at most."""

import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from threading import Event, Thread
from typing import Final, Protocol

LOG = logging.getLogger("zensim.ros2")
CORE_SHARE: Final = 0.1
"""Part of its time in which the thread declares tokens."""
BURST_S: Final = 0.002
"""Time after which it pauses; what runs beside it is delayed by less."""
RETRY_S: Final = 1.0
"""Pause before a session is opened again."""
MAX_FAILURES: Final = 3
"""Sessions that may fail at one token; it is then left out."""


class DeclaredToken(Protocol):
    """A token that is declared."""

    def close(self) -> None:
        """Undeclare it."""


class DeclaringSession(Protocol):
    """A session that declares tokens."""

    def token(self, key: str) -> DeclaredToken:
        """Declare a token."""

    def close(self) -> None:
        """Undeclare all tokens."""


class QueuedToken:
    """A token that the thread declares, and undeclares after it is closed."""

    def __init__(self, key: str, queue: "SimpleQueue[QueuedToken | None]") -> None:
        self.key = key
        self.is_wanted = True
        self.declared: DeclaredToken | None = None
        """Token that the thread declared; the thread alone sets this and `failures`."""
        self.failures = 0
        self._queue = queue

    def close(self) -> None:
        """Undeclare the token soon; further calls do nothing."""
        if self.is_wanted:
            self.is_wanted = False
            self._queue.put(self)


class TokenThread:
    """Declares tokens on a session of its own, in the order in which they were given.

    If the session fails, all are declared again on the next one.
    """

    def __init__(
        self, open_session: Callable[[], DeclaringSession], core_share: float = CORE_SHARE
    ) -> None:
        """Create it without a session; the first token opens one.

        Args:
            open_session: Called in the thread.
            core_share: Part of its time in which the thread works.
        """
        self._open_session = open_session
        self._pause_per_work = (1.0 - core_share) / core_share
        self._queue: SimpleQueue[QueuedToken | None] = SimpleQueue()
        self._again: deque[QueuedToken] = deque()
        """Tokens of a session that failed; only the thread uses this and the next field."""
        self._declared: dict[QueuedToken, None] = {}
        self._is_closed = Event()
        self._thread: Thread | None = None

    def token(self, key: str) -> QueuedToken:
        """Declare a token soon."""
        token = QueuedToken(key, self._queue)
        self._queue.put(token)
        if self._thread is None:
            self._thread = Thread(target=self._run, name="tokens", daemon=True)
            self._thread.start()
        return token

    def close(self) -> None:
        """Undeclare all tokens at once, and end the thread."""
        self._is_closed.set()
        self._queue.put(None)
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        while (session := self._open()) is not None:
            try:
                self._declare(session)
            except Exception as error:  # noqa: BLE001 - a thread has no caller; errors are the network's
                LOG.warning("tokens.lost tokens=%d reason=%r", len(self._declared), str(error))
            finally:
                _close(session)
            self._is_closed.wait(RETRY_S)
            self._declare_again()

    def _declare(self, session: DeclaringSession) -> None:
        """Declare and undeclare tokens until the thread ends.

        Raises:
            Exception: The session failed; the tokens in `_declared` are gone with it.
        """
        worked_s = 0.0
        while (token := self._take()) is not None and not self._is_closed.is_set():
            began_s = time.perf_counter()
            if token.failures < MAX_FAILURES:
                self._apply(token, session)
            worked_s += time.perf_counter() - began_s
            if worked_s >= BURST_S:
                self._is_closed.wait(worked_s * self._pause_per_work)
                worked_s = 0.0

    def _take(self) -> QueuedToken | None:
        return self._again.popleft() if self._again else self._queue.get()

    def _apply(self, token: QueuedToken, session: DeclaringSession) -> None:
        if token.is_wanted:
            self._declared[token] = None
            token.failures += 1
            token.declared = session.token(token.key)
            token.failures = 0
        elif self._declared.pop(token, 0) is None and token.declared is not None:
            token.declared.close()

    def _declare_again(self) -> None:
        """Declare the tokens of a failed session first on the next one."""
        self._again.extendleft(reversed(self._declared))
        for token in self._declared:
            token.declared = None
        self._declared.clear()

    def _open(self) -> DeclaringSession | None:
        """Open the session as soon as the network accepts it; None if the thread ends before."""
        while not self._is_closed.is_set():
            if (session := self._try_open()) is not None:
                return session
            self._is_closed.wait(RETRY_S)
        return None

    def _try_open(self) -> DeclaringSession | None:
        try:
            return self._open_session()
        except Exception as error:  # noqa: BLE001 - a thread has no caller; errors are the network's
            LOG.info("tokens waiting reason=%r", str(error))
            return None


def _close(session: DeclaringSession) -> None:
    # One that has failed may refuse this, too.
    with suppress(Exception):
        session.close()
