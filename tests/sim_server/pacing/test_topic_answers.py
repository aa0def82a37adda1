"""Topics that are awaited after others: which messages count, and when time waits."""

import pytest

from zensim.proto.settings.lockstep_settings import LockstepSettings, OnMiss
from zensim.sim_server.pacing.joined_clients import JoinedState
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.topic_answers import CLIENT_PREFIX, TopicAnswers

CMD, SCAN = "/r1/cmd_vel", "/r1/scan"
ANSWER = (b"twist", "")
LATER = (b"later", "")
SECOND_NS = 1_000_000_000


def make_answers(on_miss: OnMiss = "hold") -> TopicAnswers:
    answers = TopicAnswers(Lockstep(LockstepSettings(on_miss=on_miss, lockstep_timeout=1.0)))
    answers.set(CMD, SCAN)
    return answers


def at(step: int) -> JoinedState:
    return JoinedState(0, step, is_awaited=True)


def let_time_out(answers: TopicAnswers) -> list[str]:
    for tick in range(200):
        answers.lockstep.find_late(tick * SECOND_NS // 100)
    return list(answers.note_late())


def test_message_is_awaited_until_the_answer_comes() -> None:
    answers = make_answers()

    answers.note_message(SCAN, at(24), 0)
    waited = answers.lockstep.awaited
    counts = answers.take_answer(CMD, ANSWER, (0, 24))

    assert waited == (CLIENT_PREFIX + CMD,)
    assert counts
    assert not answers.lockstep.is_waiting


def test_message_of_another_topic_is_not_awaited() -> None:
    answers = make_answers()

    answers.note_message("/r2/scan", at(24), 0)

    assert not answers.lockstep.is_waiting


def test_answer_that_came_before_its_message_in_the_same_step_counts() -> None:
    answers = make_answers()

    counts = answers.take_answer(CMD, ANSWER, (0, 24))
    found = answers.note_message(SCAN, at(24), 0)

    assert not counts
    assert found == [(CMD, ANSWER)]
    assert not answers.lockstep.is_waiting


def test_surplus_message_of_an_earlier_step_answers_nothing() -> None:
    answers = make_answers()

    answers.take_answer(CMD, ANSWER, (0, 21))
    found = answers.note_message(SCAN, at(24), 0)

    assert found == []
    assert answers.lockstep.is_waiting


def test_first_of_two_messages_in_a_step_counts() -> None:
    answers = make_answers()
    answers.note_message(SCAN, at(24), 0)

    assert answers.take_answer(CMD, ANSWER, (0, 24))
    assert not answers.take_answer(CMD, LATER, (0, 24))
    assert answers.note_message(SCAN, at(48), 0) == []


def test_late_node_is_named_once_and_awaited_again_when_it_answers() -> None:
    answers = make_answers()
    answers.note_message(SCAN, at(24), 0)

    late = let_time_out(answers)
    answers.note_message(SCAN, at(48), 0)
    goes_on = not answers.lockstep.is_waiting
    counts = answers.take_answer(CMD, ANSWER, (0, 50))
    answers.note_message(SCAN, at(72), 0)

    assert late == [CMD]
    assert list(answers.note_late()) == []
    assert goes_on
    assert counts
    assert answers.lockstep.is_waiting


def test_late_node_is_awaited_further_when_lockstep_waits() -> None:
    answers = make_answers("wait")
    answers.note_message(SCAN, at(24), 0)

    assert let_time_out(answers) == []
    assert answers.lockstep.is_waiting


@pytest.mark.parametrize("returns", ["publisher", "message"])
def test_node_that_is_gone_is_not_awaited_until_it_returns(returns: str) -> None:
    answers = make_answers("wait")
    answers.note_message(SCAN, at(24), 0)

    answers.forget(CMD)
    answers.note_message(SCAN, at(48), 0)
    goes_on = not answers.lockstep.is_waiting
    if returns == "publisher":
        answers.resume(CMD)
    else:
        answers.take_answer(CMD, ANSWER, (0, 49))
    answers.note_message(SCAN, at(72), 0)

    assert goes_on
    assert answers.lockstep.is_waiting


def test_topic_without_another_is_awaited_no_more() -> None:
    answers = make_answers()
    answers.note_message(SCAN, at(24), 0)

    answers.set(CMD, "")

    assert not answers.has_topics
    assert not answers.lockstep.is_waiting
