"""Replies leave in order of each client, and no client delays another."""

import threading
from collections.abc import Iterator
from functools import partial

import pytest

from zensim.proto import reply_sender
from zensim.proto.reply_sender import ReplySender

TIMEOUT_S = 10.0


@pytest.fixture
def sender() -> Iterator[ReplySender]:
    found = ReplySender(max_threads=2, max_bytes=100)
    yield found
    found.close()


class StalledClient:
    """A client whose first reply is sent only when it reads again."""

    def __init__(self, sender: ReplySender, name: str) -> None:
        self.is_reading = threading.Event()
        self.is_sending = threading.Event()
        sender.send(name, 1, self._send, self._send)
        assert self.is_sending.wait(TIMEOUT_S)

    def _send(self) -> None:
        self.is_sending.set()
        assert self.is_reading.wait(TIMEOUT_S)


def send_text(sender: ReplySender, client: str, text: str, sent: list[str], size: int = 1) -> None:
    sender.send(client, size, lambda: sent.append(text), lambda: sent.append(f"no {text}"))


def test_sender_keeps_the_order_of_a_client(sender: ReplySender) -> None:
    sent: list[str] = []
    for number in range(50):
        send_text(sender, "a", str(number), sent)

    sender.settle(TIMEOUT_S)

    assert sent == [str(number) for number in range(50)]


def test_sender_sends_to_others_while_one_client_does_not_read(sender: ReplySender) -> None:
    sent: list[str] = []
    stalled = StalledClient(sender, "stalled")
    sender.settle(0.001)
    send_text(sender, "b", "reply", sent)

    sender.settle(TIMEOUT_S)

    assert sent == ["reply"]
    stalled.is_reading.set()


def test_settle_does_not_wait_again_for_a_client_that_does_not_read(sender: ReplySender) -> None:
    sent: list[str] = []
    stalled = StalledClient(sender, "stalled")
    sender.settle(0.001)
    send_text(sender, "stalled", "late", sent)

    sender.settle(TIMEOUT_S)

    assert sent == []
    stalled.is_reading.set()
    sender.close(TIMEOUT_S)
    assert sent == ["late"]


def test_sender_finishes_without_value_what_exceeds_the_bytes_of_a_client(
    sender: ReplySender,
) -> None:
    sent: list[str] = []
    stalled = StalledClient(sender, "stalled")
    for text, size in (("small", 60), ("large", 60), ("tiny", 20)):
        send_text(sender, "stalled", text, sent, size)

    stalled.is_reading.set()
    sender.close(TIMEOUT_S)

    assert sent == ["small", "no large", "tiny"]


def test_one_reply_of_any_size_is_sent(sender: ReplySender) -> None:
    sent: list[str] = []
    send_text(sender, "a", "huge", sent, 10_000)

    sender.settle(TIMEOUT_S)

    assert sent == ["huge"]


def test_more_clients_than_threads_are_served_when_one_reads_again(sender: ReplySender) -> None:
    stalled = [StalledClient(sender, name) for name in ("a", "b")]
    sent: list[str] = []
    send_text(sender, "c", "reply", sent)
    sender.settle(0.001)
    assert sent == []

    stalled[0].is_reading.set()
    sender.close(0.1)
    stalled[1].is_reading.set()

    assert sent == ["reply"]


def test_close_waits_no_longer_than_its_timeout(sender: ReplySender) -> None:
    sent: list[str] = []
    stalled = StalledClient(sender, "stalled")
    send_text(sender, "stalled", "late", sent)

    sender.close(0.01)

    assert sent == []
    stalled.is_reading.set()


def test_reply_that_fails_does_not_stop_later_ones(sender: ReplySender) -> None:
    sent: list[str] = []

    def fail() -> None:
        raise ValueError("no such encoding")

    sender.send("a", 1, fail, fail)
    send_text(sender, "a", "next", sent)

    sender.settle(TIMEOUT_S)

    assert sent == ["next"]


def test_each_thread_is_prepared_before_it_sends() -> None:
    sender, calls = ReplySender(max_threads=1), list[str]()
    sender.prepare_thread = lambda: calls.append("prepared")
    for text in ("one", "two"):
        send_text(sender, "a", text, calls)

    sender.settle(TIMEOUT_S)
    sender.close()

    assert calls == ["prepared", "one", "two"]


def test_sender_is_full_until_replies_are_sent(
    sender: ReplySender, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reply_sender, "MAX_UNSENT", 3)
    stalled = StalledClient(sender, "stalled")
    sent: list[str] = []
    send_text(sender, "stalled", "second", sent)
    was_full = sender.is_full

    send_text(sender, "stalled", "third", sent)

    assert (was_full, sender.is_full) == (False, True)
    stalled.is_reading.set()
    sender.settle(TIMEOUT_S)
    assert not sender.is_full


def test_client_has_a_backlog_until_its_replies_are_sent(
    sender: ReplySender, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reply_sender, "MAX_BACKLOG", 2)
    stalled = StalledClient(sender, "stalled")
    before = sender.has_backlog("stalled")

    send_text(sender, "stalled", "second", [])

    assert (before, sender.has_backlog("stalled")) == (False, True)
    assert not sender.has_backlog("other")
    stalled.is_reading.set()
    sender.settle(TIMEOUT_S)
    assert not sender.has_backlog("stalled")


def test_queries_without_a_value_do_not_wait_for_replies_that_stall(sender: ReplySender) -> None:
    stalled = StalledClient(sender, "stalled")
    finished = threading.Event()

    sender.finish(finished.set)

    assert finished.wait(TIMEOUT_S)
    stalled.is_reading.set()


def test_sender_finishes_all_queries_before_it_closes() -> None:
    sender = ReplySender()
    finished: list[int] = []
    for number in range(1000):
        sender.finish(partial(finished.append, number))
    sender.finish(fail)
    sender.finish(partial(finished.append, 1000))

    sender.close(TIMEOUT_S)

    assert finished == list(range(1001))


def fail() -> None:
    raise RuntimeError("the link is closed")
