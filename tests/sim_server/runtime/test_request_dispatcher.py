"""Response cache, and replies that wait for the journal in order."""

from typing import cast

import pytest

from tests.fakes import MemoryCall
from zensim.proto.network_protocols import ServiceCall
from zensim.sim_server.runtime.request_dispatcher import (
    MAX_CACHED_RESPONSES,
    QueuedReply,
    ReplyQueue,
    ResponseCache,
    make_journaled_response,
)
from zensim.sim_server.runtime.response_encoding import CachedResponse


def a_call(request_id: bytes, service: str = "delete_entity") -> ServiceCall:
    return cast("ServiceCall", MemoryCall(f"sim/default/{service}", b"", "", request_id))


def an_answer(text: str) -> CachedResponse:
    return CachedResponse(text.encode(), "text/plain")


def test_cache_finds_a_retry_by_its_id() -> None:
    answers = ResponseCache()
    answers.keep(a_call(b"1"), an_answer("one"))

    assert answers.find(a_call(b"1")) == an_answer("one")
    assert answers.find(a_call(b"2")) is None


@pytest.mark.parametrize(
    ("request_id", "service"), [(b"", "delete_entity"), (b"1", "info"), (b"1", "no_service")]
)
def test_cache_keeps_only_mutating_requests_with_an_id(request_id: bytes, service: str) -> None:
    answers = ResponseCache()

    answers.keep(a_call(request_id, service), an_answer("one"))

    assert answers.find(a_call(request_id, service)) is None


def test_cache_drops_the_oldest_when_there_are_many() -> None:
    answers = ResponseCache()

    for i in range(MAX_CACHED_RESPONSES + 1):
        answers.keep(a_call(str(i).encode()), an_answer(str(i)))

    assert answers.find(a_call(b"0")) is None
    assert answers.find(a_call(b"1")) == an_answer("1")


def test_cache_drops_the_oldest_when_they_are_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zensim.sim_server.runtime.request_dispatcher.MAX_CACHED_BYTES", 10)
    answers = ResponseCache()

    answers.keep(a_call(b"1"), an_answer("123456"))
    forgotten = answers.keep(a_call(b"2"), an_answer("123456"))

    assert forgotten == (("delete_entity", b"1"),)
    assert answers.find(a_call(b"1")) is None
    assert answers.find(a_call(b"2")) == an_answer("123456")


def test_cache_loads_responses_of_an_earlier_server() -> None:
    first, second = ResponseCache(), ResponseCache()
    kept = make_journaled_response(a_call(b"1"), an_answer("one"))
    assert kept is not None
    first.keep(a_call(b"1"), an_answer("one"))

    second.load([kept])

    assert second.find(a_call(b"1")) == an_answer("one")


@pytest.mark.parametrize(
    ("request_id", "service"), [(b"", "delete_entity"), (b"1", "info"), (b"1", "claim_entity")]
)
def test_journal_gets_only_responses_that_survive_a_restart(
    request_id: bytes, service: str
) -> None:
    assert make_journaled_response(a_call(request_id, service), an_answer("one")) is None


def test_cache_forgets_a_response() -> None:
    answers = ResponseCache()
    answers.keep(a_call(b"1"), an_answer("one"))

    answers.forget(a_call(b"1"))
    answers.forget(a_call(b"2"))

    assert answers.find(a_call(b"1")) is None


def a_reply(number: int, position: int) -> tuple[MemoryCall, QueuedReply]:
    call = MemoryCall(f"sim/default/s{number}", b"", "", b"")
    answer = CachedResponse(str(number).encode(), "text/plain")
    return call, QueuedReply(cast("ServiceCall", call), answer, position)


def some_replies(*positions: int) -> tuple[ReplyQueue, list[MemoryCall]]:
    replies = ReplyQueue(lambda name, _: f"key/{name}")
    pairs = [a_reply(number, position) for number, position in enumerate(positions)]
    for _, waiting in pairs:
        replies.add(waiting)
    return replies, [call for call, _ in pairs]


def answered(calls: list[MemoryCall]) -> list[bool]:
    return [call.is_over for call in calls]


def test_replies_are_sent_up_to_the_durable_position() -> None:
    replies, calls = some_replies(1, 1, 2)

    replies.send_durable(1)
    assert answered(calls) == [True, True, False]

    replies.send_durable(2)
    assert answered(calls) == [True, True, True]
    assert (calls[2].answers[0].key, calls[2].answers[0].payload) == ("key/s2", b"2")


def test_replies_never_overtake_each_other() -> None:
    replies, calls = some_replies(5, 1)

    replies.send_durable(4)

    assert answered(calls) == [False, False]


def test_replies_that_are_taken_are_not_sent() -> None:
    replies, calls = some_replies(1, 2)

    taken = replies.take_unsent()
    replies.send_durable(9)

    assert [waiting.position for waiting in taken] == [1, 2]
    assert answered(calls) == [False, False]


def test_cache_holds_32_mebibytes() -> None:
    answers, mebibyte = ResponseCache(), "x" * (1 << 20)

    dropped = [len(answers.keep(a_call(b"%d" % i), an_answer(mebibyte))) for i in range(34)]

    assert dropped == [0] * 32 + [1, 1]
