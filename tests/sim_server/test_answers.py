"""Answers: a retry is known by its id, and old ones are forgotten."""

from typing import cast

import pytest

from proto.bus import Call
from sim_server.answers import KEPT, Answer, Answers
from tests.fakes import MemoryCall


def a_call(request_id: bytes, service: str = "delete_entity") -> Call:
    return cast("Call", MemoryCall(f"sim/default/{service}", b"", "", request_id))


def an_answer(text: str) -> Answer:
    return Answer(text.encode(), "text/plain")


def test_answers_know_a_retry_by_its_id() -> None:
    answers = Answers()
    answers.keep(a_call(b"1"), an_answer("one"))

    assert answers.known(a_call(b"1")) == an_answer("one")
    assert answers.known(a_call(b"2")) is None


@pytest.mark.parametrize(
    ("request_id", "service"), [(b"", "delete_entity"), (b"1", "info"), (b"1", "no_service")]
)
def test_answers_keep_only_what_changes_something_and_has_an_id(
    request_id: bytes, service: str
) -> None:
    answers = Answers()

    answers.keep(a_call(request_id, service), an_answer("one"))

    assert answers.known(a_call(request_id, service)) is None


def test_answers_forget_the_oldest_when_there_are_many() -> None:
    answers = Answers()

    for i in range(KEPT + 1):
        answers.keep(a_call(str(i).encode()), an_answer(str(i)))

    assert answers.known(a_call(b"0")) is None
    assert answers.known(a_call(b"1")) == an_answer("1")
