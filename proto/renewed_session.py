"""A session for what comes and goes with names, which is replaced when much of it has gone.

Zenoh keeps each key that a session has ever declared, 1.1 kB in that session and 1.7 kB in its
router, until the session closes (`python -m benchmarks.bare_keys`).
"""

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Generic, Protocol, TypeVar

LOG = logging.getLogger("zensim.bus")
RENEW_AFTER: Final = 1000
"""Declarations that a session has lost: 2.7 MB of both sides."""
SETTLE_S: Final = 1.0
"""Time from a move to the end of the session before."""
MAX_RETIRED: Final = 2
"""Sessions that wait for the end of their last declarations; those of the oldest are moved then."""

SessionT = TypeVar("SessionT")
DeclaredT = TypeVar("DeclaredT")
SessionT_contra = TypeVar("SessionT_contra", contravariant=True)


class Declaration(Protocol[SessionT_contra]):
    """What a session declares, until it is closed."""

    def move(self, session: SessionT_contra) -> object:
        """Declare it on another session, and use that; return what keeps it declared here."""


class Generation(Generic[SessionT]):
    """A session, what it declares, and how much it has declared before."""

    def __init__(self, session: SessionT, close: Callable[[], None]) -> None:
        self.session = session
        self.close = close
        self.open: dict[Declaration[SessionT], None] = {}
        self.pending = 0
        """What is being declared."""
        self.gone = 0
        self.moved: list[object] = []
        """What keeps declared here what was moved, until the session closes."""


class RenewedSession(Generic[SessionT]):
    """The session on which declarations are made now, and those before it."""

    def __init__(
        self,
        first: SessionT,
        open_session: Callable[[], tuple[SessionT, Callable[[], None]]],
        renew_after: int = RENEW_AFTER,
    ) -> None:
        """Begin with a session of the caller, which this never closes.

        Args:
            first: That session.
            open_session: Opens another one, in a thread; returns also what closes it.
            renew_after: Declarations that a session may lose.
        """
        self._open_session = open_session
        self._renew_after = renew_after
        self._lock = threading.Lock()
        self._current = Generation(first, lambda: None)
        self._retired: list[Generation[SessionT]] = []
        self._places: dict[Declaration[SessionT], Generation[SessionT]] = {}
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()

    def declare(
        self, owner: Declaration[SessionT], make: Callable[[SessionT], DeclaredT]
    ) -> DeclaredT:
        """Declare what its owner moves and removes later; return what `make` returns."""
        with self._lock:
            place = self._current
            place.pending += 1
        try:
            declared = make(place.session)
        except BaseException:
            with self._lock:
                place.pending -= 1
            raise
        with self._lock:
            place.pending -= 1
            place.open[owner] = None
            self._places[owner] = place
        return declared

    def remove(self, declaration: Declaration[SessionT]) -> None:
        """Forget what was undeclared; renew the session if it has lost much."""
        with self._lock:
            place = self._places.pop(declaration, None)
            if place is None:
                return
            place.open.pop(declaration, None)
            place.gone += 1
            is_due = place is self._current and place.gone >= self._renew_after
            is_empty = place is not self._current and not place.open
            if (is_due or is_empty) and self._thread is None and not self._ended.is_set():
                self._thread = threading.Thread(target=self._renew, name="renewal", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Close all sessions but the first."""
        with self._lock:
            self._ended.set()
            thread = self._thread
        if thread is not None:
            thread.join()
        for one in (*self._retired, self._current):
            _close(one)
        self._retired.clear()

    def _renew(self) -> None:
        """Replace the session if it is due, and close those that nobody needs."""
        try:
            if self._current.gone >= self._renew_after:
                self._replace()
            for one in self._take_unused():
                if one.moved:
                    # Else a router could hear of the end before it hears of the new place.
                    self._ended.wait(SETTLE_S)
                _close(one)
        finally:
            with self._lock:
                self._thread = None

    def _replace(self) -> None:
        try:
            opened = Generation(*self._open_session())
        except Exception as error:  # noqa: BLE001 - a thread has no caller; errors are the network's
            LOG.info("renewal.failed reason=%r", str(error))
            self._current.gone = 0  # it is tried again after as many
            return
        with self._lock:
            self._retired.append(self._current)
            self._current = opened
        if len(self._retired) > MAX_RETIRED:
            self._move_all(self._retired[0], opened)

    def _move_all(self, source: Generation[SessionT], target: Generation[SessionT]) -> None:
        for declaration in tuple(source.open):
            with self._lock:  # so that it is not closed meanwhile
                if self._places.get(declaration) is not source:
                    continue
                with suppress(Exception):  # it stays where it is, and so does the session
                    source.moved.append(declaration.move(target.session))
                    del source.open[declaration]
                    target.open[declaration] = None
                    self._places[declaration] = target

    def _take_unused(self) -> list[Generation[SessionT]]:
        with self._lock:
            unused = [one for one in self._retired if not (one.open or one.pending)]
            self._retired = [one for one in self._retired if one not in unused]
        return unused


def _close(generation: Generation[SessionT]) -> None:
    # One that has failed may refuse this, too.
    with suppress(Exception):
        generation.close()
