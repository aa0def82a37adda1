"""A session is replaced when much that it declared has gone, and nothing that is there goes."""

import threading
from typing import TYPE_CHECKING

import pytest

from tests.integration.processes import eventually
from zensim.proto import renewed_session
from zensim.proto.renewed_session import MAX_RETIRED, RenewedSession

if TYPE_CHECKING:
    from collections.abc import Callable

WITHIN_S = 10.0
RENEW_AFTER = 10


def is_renewing() -> bool:
    """Whether a thread replaces or closes sessions."""
    return any(one.name == "renewal" for one in threading.enumerate())


class Session:
    """Knows what is declared on it."""

    def __init__(self) -> None:
        self.declared: set[Declared] = set()
        self.is_closed = False

    def close(self) -> None:
        assert not self.declared
        self.is_closed = True


class Declared:
    """A declaration that can move."""

    def __init__(self, names: RenewedSession[Session]) -> None:
        self._names = names
        self.session = names.declare(self, self._declare)

    def _declare(self, session: Session) -> Session:
        assert not session.is_closed
        session.declared.add(self)
        return session

    def move(self, session: Session) -> object:
        before, self.session = self.session, session
        session.declared.add(self)
        before.declared.discard(self)
        return before

    def close(self) -> None:
        self.session.declared.discard(self)
        self._names.remove(self)


class Network:
    """Opens sessions, unless it is told to fail."""

    def __init__(self) -> None:
        self.sessions = [Session()]
        self.is_failing = False
        self.names = RenewedSession(self.sessions[0], self.open, RENEW_AFTER)

    def open(self) -> "tuple[Session, Callable[[], None]]":
        if self.is_failing:
            raise OSError("no route")
        self.sessions.append(Session())
        return self.sessions[-1], self.sessions[-1].close

    def churn(self, count: int = RENEW_AFTER) -> None:
        for _ in range(count):
            Declared(self.names).close()

    def renew(self) -> None:
        """Let names come and go until there is another session."""
        before = len(self.sessions)
        self.churn()
        eventually(lambda: len(self.sessions) > before, WITHIN_S, "another session")
        eventually(lambda: not is_renewing(), WITHIN_S, "the end of the thread")


def test_session_is_kept_while_little_has_gone() -> None:
    network = Network()

    network.churn(RENEW_AFTER - 1)

    assert len(network.sessions) == 1


def test_session_is_replaced_after_much_has_gone() -> None:
    network = Network()

    for _ in range(5):
        network.renew()

    first, *between, last = network.sessions
    assert [one.is_closed for one in (first, *between, last)] == [False, *[True] * 4, False]


def test_what_is_declared_stays_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renewed_session, "SETTLE_S", 0.0)
    network = Network()
    network.renew()
    kept = Declared(network.names)

    for _ in range(MAX_RETIRED + 3):
        network.renew()
        assert kept in kept.session.declared
        assert not kept.session.is_closed

    open_sessions = [one for one in network.sessions if not one.is_closed]
    assert len(open_sessions) <= MAX_RETIRED + 2
    kept.close()
    assert not any(one.declared for one in network.sessions)


def test_session_is_not_closed_while_something_is_declared_there() -> None:
    network = Network()
    network.renew()
    owner = Declared(network.names)
    owner.close()
    used: list[Session] = []

    def declare(session: Session) -> None:
        used.append(session)
        network.renew()
        network.renew()
        assert not session.is_closed
        raise ConnectionError

    with pytest.raises(ConnectionError):
        network.names.declare(owner, declare)

    network.renew()
    assert used[0].is_closed


def test_session_that_cannot_be_replaced_is_kept() -> None:
    network = Network()
    network.is_failing = True
    network.churn(3 * RENEW_AFTER)
    eventually(lambda: not is_renewing(), WITHIN_S, "the end of the thread")

    network.is_failing = False
    network.renew()

    assert len(network.sessions) == 2


def test_all_but_the_first_are_closed_at_the_end() -> None:
    network = Network()
    network.renew()

    network.names.close()

    assert [one.is_closed for one in network.sessions] == [False, True]
