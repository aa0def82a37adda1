"""An answer may be revised once while time runs freely."""

from msgspec.structs import replace

from tests.robot_agent.models import a_state
from zensim.robot_agent.answer_times import MAX_WINDOW_S, MIN_WINDOW_S, LateCommandWindow

NOW_S = 5.0


def after(*states: tuple[int, tuple[int, ...], int, bool]) -> LateCommandWindow:
    """Take note of states: step, claims, epoch, whether each is awaited."""
    window = LateCommandWindow()
    for step, claims, epoch, is_awaited in states:
        state = replace(a_state(step, claims, epoch=epoch), is_awaited=is_awaited)
        window.note_state(state, NOW_S)
    return window


def test_answer_may_be_revised_while_time_runs_freely() -> None:
    assert after((3, (1,), 0, False), (6, (1,), 0, False)).is_open(NOW_S + 0.01)


def test_answer_is_not_revised_before_time_is_known_to_run() -> None:
    assert not LateCommandWindow().is_open(NOW_S)
    assert not after((3, (1,), 0, False)).is_open(NOW_S)
    assert not after((3, (1,), 0, False), (3, (1,), 0, False)).is_open(NOW_S)


def test_answer_that_is_awaited_is_not_revised() -> None:
    assert not after((3, (1,), 0, False), (6, (1,), 0, True)).is_open(NOW_S)


def test_answer_is_not_revised_when_claims_or_epoch_change() -> None:
    assert not after((3, (1, 2), 0, False), (4, (1,), 0, False)).is_open(NOW_S)
    assert not after((3, (1,), 0, False), (6, (1,), 1, False)).is_open(NOW_S)


def test_answer_is_not_revised_when_no_state_has_come_for_long() -> None:
    assert not after((3, (1,), 0, False), (6, (1,), 0, False)).is_open(NOW_S + MIN_WINDOW_S)


def test_answer_may_be_revised_for_longer_at_a_low_rate_of_states() -> None:
    window = LateCommandWindow()
    for step in (1, 2):
        window.note_state(a_state(step, (1,)), NOW_S + 0.4 * step)
    assert window.is_open(NOW_S + 0.8 + 0.7)

    window.note_state(a_state(3, (1,)), NOW_S + 100.0)
    assert not window.is_open(NOW_S + 100.0 + MAX_WINDOW_S)


def test_answer_is_revised_once() -> None:
    window = after((3, (1,), 0, False), (6, (1,), 0, False))

    window.close()

    assert not window.is_open(NOW_S)
