"""Answers: a retry is known by its id, and old ones are forgotten."""

from typing import cast

import pytest

from tests.fakes import MemoryCall
from zensim.sim_server.traffic.answers import KEPT, Answer, Answers, told
from zensim.sim_server.traffic.calls import Call


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


def test_answers_forget_the_oldest_when_they_are_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zensim.sim_server.traffic.answers.KEPT_BYTES", 10)
    answers = Answers()

    answers.keep(a_call(b"1"), an_answer("123456"))
    forgotten = answers.keep(a_call(b"2"), an_answer("123456"))

    assert forgotten == (("delete_entity", b"1"),)
    assert answers.known(a_call(b"1")) is None
    assert answers.known(a_call(b"2")) == an_answer("123456")


def test_answers_know_what_another_server_told() -> None:
    first, second = Answers(), Answers()
    kept = told(a_call(b"1"), an_answer("one"))
    assert kept is not None
    first.keep(a_call(b"1"), an_answer("one"))

    second.load([kept])

    assert second.known(a_call(b"1")) == an_answer("one")


@pytest.mark.parametrize(
    ("request_id", "service"), [(b"", "delete_entity"), (b"1", "info"), (b"1", "claim_entity")]
)
def test_journal_is_given_only_answers_that_another_server_can_give(
    request_id: bytes, service: str
) -> None:
    assert told(a_call(request_id, service), an_answer("one")) is None


def test_answer_that_was_taken_back_is_forgotten() -> None:
    answers = Answers()
    answers.keep(a_call(b"1"), an_answer("one"))

    answers.forget(a_call(b"1"))
    answers.forget(a_call(b"2"))

    assert answers.known(a_call(b"1")) is None
