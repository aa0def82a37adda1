"""Replies: in the order of answering, each once what it tells is kept."""

from typing import TYPE_CHECKING, cast

from tests.fakes import MemoryCall
from zensim.sim_server.traffic.answers import Answer
from zensim.sim_server.traffic.replies import Replies, Waiting

if TYPE_CHECKING:
    from zensim.sim_server.traffic.calls import Call


def a_reply(number: int, position: int) -> tuple[MemoryCall, Waiting]:
    call = MemoryCall(f"sim/default/s{number}", b"", "", b"")
    answer = Answer(str(number).encode(), "text/plain")
    return call, Waiting(cast("Call", call), answer, position)


def some_replies(*positions: int) -> tuple[Replies, list[MemoryCall]]:
    replies = Replies(lambda name: f"key/{name}")
    pairs = [a_reply(number, position) for number, position in enumerate(positions)]
    for _, waiting in pairs:
        replies.add(waiting)
    return replies, [call for call, _ in pairs]


def answered(calls: list[MemoryCall]) -> list[bool]:
    return [call.is_over for call in calls]


def test_replies_go_as_far_as_the_journal_has_come() -> None:
    replies, calls = some_replies(1, 1, 2)

    replies.let_go(1)
    assert answered(calls) == [True, True, False]

    replies.let_go(2)
    assert answered(calls) == [True, True, True]
    assert (calls[2].answers[0].key, calls[2].answers[0].payload) == ("key/s2", b"2")


def test_replies_never_overtake_each_other() -> None:
    replies, calls = some_replies(5, 1)

    replies.let_go(4)

    assert answered(calls) == [False, False]


def test_replies_that_are_taken_back_are_not_sent() -> None:
    replies, calls = some_replies(1, 2)

    taken = replies.take_back()
    replies.let_go(9)

    assert [waiting.position for waiting in taken] == [1, 2]
    assert answered(calls) == [False, False]
