"""When the answer to a state may be given anew."""

from msgspec.structs import replace

from tests.robot_agent.models import a_state
from zensim.robot_agent.revising import LEAST_S, MOST_S, Revising

NOW_S = 5.0


def after(*states: tuple[int, tuple[int, ...], int, bool]) -> Revising:
    """Take note of states: step, claims, epoch, whether each is awaited."""
    revising = Revising()
    for step, claims, epoch, is_awaited in states:
        state = replace(a_state(step, claims, epoch=epoch), is_awaited=is_awaited)
        revising.note_state(state, NOW_S)
    return revising


def test_answer_may_be_revised_while_time_runs_freely() -> None:
    assert after((3, (1,), 0, False), (6, (1,), 0, False)).is_open(NOW_S + 0.01)


def test_answer_is_not_revised_before_time_is_known_to_run() -> None:
    assert not Revising().is_open(NOW_S)
    assert not after((3, (1,), 0, False)).is_open(NOW_S)
    assert not after((3, (1,), 0, False), (3, (1,), 0, False)).is_open(NOW_S)


def test_answer_that_is_awaited_is_not_revised() -> None:
    assert not after((3, (1,), 0, False), (6, (1,), 0, True)).is_open(NOW_S)


def test_answer_is_not_revised_when_a_state_tells_of_other_claims_or_another_epoch() -> None:
    assert not after((3, (1, 2), 0, False), (4, (1,), 0, False)).is_open(NOW_S)
    assert not after((3, (1,), 0, False), (6, (1,), 1, False)).is_open(NOW_S)


def test_answer_is_not_revised_when_no_state_has_come_for_long() -> None:
    assert not after((3, (1,), 0, False), (6, (1,), 0, False)).is_open(NOW_S + LEAST_S)


def test_answer_may_be_revised_for_longer_where_states_come_seldom() -> None:
    revising = Revising()
    for beat in (1, 2):
        revising.note_state(a_state(beat, (1,)), NOW_S + 0.4 * beat)
    assert revising.is_open(NOW_S + 0.8 + 0.7)

    revising.note_state(a_state(3, (1,)), NOW_S + 100.0)
    assert not revising.is_open(NOW_S + 100.0 + MOST_S)


def test_answer_is_revised_once() -> None:
    revising = after((3, (1,), 0, False), (6, (1,), 0, False))

    revising.close()

    assert not revising.is_open(NOW_S)
