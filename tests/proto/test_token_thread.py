"""Tokens that a thread declares."""

import time
from threading import Event

import pytest

from tests.fakes import MemoryBus, MemoryToken
from tests.integration.processes import eventually
from zensim.proto.token_thread import MAX_FAILURES, RETRY_S, TokenThread

PATIENCE_S = 10.0


class SlowBus(MemoryBus):
    """Declares nothing before it may."""

    def __init__(self) -> None:
        super().__init__()
        self.may_declare = Event()

    def token(self, key: str) -> MemoryToken:
        self.may_declare.wait(PATIENCE_S)
        return super().token(key)


def test_tokens_are_declared_beside_the_caller() -> None:
    bus = SlowBus()
    tokens = TokenThread(lambda: bus)

    for number in range(50):
        tokens.token(f"t/{number}")
    assert bus.list_tokens("t/*") == []
    bus.may_declare.set()

    eventually(lambda: len(bus.list_tokens("t/*")) == 50, PATIENCE_S)
    tokens.close()


def test_closed_tokens_disappear_also_before_they_are_declared() -> None:
    bus = SlowBus()
    tokens = TokenThread(lambda: bus)
    first, second = tokens.token("t/1"), tokens.token("t/2")
    bus.may_declare.set()
    eventually(lambda: len(bus.list_tokens("t/*")) == 2, PATIENCE_S)

    first.close()
    tokens.token("t/3").close()
    tokens.token("t/4")

    eventually(lambda: bus.list_tokens("t/*") == ["t/2", "t/4"], PATIENCE_S)
    second.close()
    second.close()
    eventually(lambda: bus.list_tokens("t/*") == ["t/4"], PATIENCE_S)
    tokens.close()


def test_closed_thread_leaves_no_token_and_no_session() -> None:
    bus = MemoryBus()
    tokens = TokenThread(lambda: bus)
    tokens.token("t/1")
    eventually(lambda: bus.list_tokens("t/*"), PATIENCE_S)

    tokens.close()

    assert bus.is_closed
    assert bus.list_tokens("t/*") == []


def test_thread_without_tokens_opens_no_session() -> None:
    bus = MemoryBus()

    TokenThread(bus.open_session).close()

    assert bus.opened_sessions == []


def test_session_is_opened_again_if_it_fails() -> None:
    bus, attempts = MemoryBus(), [ConnectionError("no router")]

    def open_session() -> MemoryBus:
        if attempts:
            raise attempts.pop()
        return bus

    tokens = TokenThread(open_session)
    tokens.token("t/1")

    eventually(lambda: bus.list_tokens("t/*"), PATIENCE_S + RETRY_S)
    tokens.close()


class FailingBus(MemoryBus):
    """Fails at a token, as a session does that was closed; its end fails, too."""

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key

    def token(self, key: str) -> MemoryToken:
        if key == self._key:
            raise RuntimeError("session closed")
        return super().token(key)

    def close(self) -> None:
        super().close()
        raise RuntimeError("session closed")


def test_all_tokens_are_declared_again_if_the_session_fails(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failing, good = FailingBus("t/2"), MemoryBus()
    sessions = iter([failing, good])
    tokens = TokenThread(lambda: next(sessions))
    first = tokens.token("t/1")
    for key in ("t/2", "t/3"):
        tokens.token(key)

    eventually(lambda: good.list_tokens("t/*") == ["t/1", "t/2", "t/3"], PATIENCE_S)
    first.close()
    eventually(lambda: good.list_tokens("t/*") == ["t/2", "t/3"], PATIENCE_S)
    tokens.close()

    assert failing.is_closed
    assert [one.split()[0] for one in caplog.messages] == ["tokens.lost"]


def test_token_at_which_each_session_fails_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zensim.proto.token_thread.RETRY_S", 0.0)
    sessions: list[FailingBus] = []

    def open_session() -> FailingBus:
        sessions.append(FailingBus("t/2"))
        return sessions[-1]

    tokens = TokenThread(open_session)
    for number in range(1, 4):
        tokens.token(f"t/{number}")

    eventually(lambda: sessions and sessions[-1].list_tokens("t/*") == ["t/1", "t/3"], PATIENCE_S)
    tokens.close()
    assert len(sessions) == MAX_FAILURES + 1


class BusyBus(MemoryBus):
    """Keeps a core busy for each token."""

    def token(self, key: str) -> MemoryToken:
        until_s = time.perf_counter() + 0.002
        while time.perf_counter() < until_s:
            pass
        return super().token(key)


def test_thread_pauses_for_most_of_its_time() -> None:
    bus = BusyBus()
    tokens = TokenThread(lambda: bus)
    began_s = time.perf_counter()
    for number in range(20):
        tokens.token(f"t/{number}")

    eventually(lambda: len(bus.list_tokens("t/*")) == 20, PATIENCE_S)

    pauses_s = 19 * 9 * 0.002
    assert time.perf_counter() - began_s >= pauses_s
    tokens.close()
