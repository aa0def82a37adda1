"""Pauses between polls for states that come periodically."""

from zensim.proto.poll_schedule import EAGER_POLL_S, IDLE_S, MAX_PAUSE_S, MIN_PERIOD_S, PollSchedule


def looks_between_states(
    rhythm: PollSchedule, period_s: float, *, states: int, awaited: bool
) -> float:
    """Run an agent's loop; count its looks for each state, the last half of the time."""
    now_s, looks, seen = 0.0, 0, 0
    while seen < states:
        now_s += rhythm.pause_s(now_s) + 5e-5
        due = int(now_s / period_s)
        looks += seen >= states // 2
        if due > seen:
            seen = due
            rhythm.note_state(now_s, is_awaited=awaited)
    return looks / (states - states // 2)


def test_schedule_polls_a_few_times_per_state_in_real_time() -> None:
    assert looks_between_states(PollSchedule(), 0.0125, states=200, awaited=False) < 4.5


def test_schedule_polls_more_often_for_late_commands() -> None:
    rhythm = PollSchedule(0.0035)
    for state in range(100):
        rhythm.note_state(state * 0.1, is_awaited=False)

    assert rhythm.pause_s(9.9) == 0.0035


def test_schedule_limits_the_rate_of_answers_when_time_runs_fast() -> None:
    rhythm = PollSchedule()

    looks = looks_between_states(rhythm, 0.0005, states=4000, awaited=False)

    assert looks <= 1.1 * 0.0005 / MIN_PERIOD_S


def test_schedule_polls_fast_when_an_answer_is_awaited() -> None:
    rhythm = PollSchedule()
    rhythm.note_state(5.0, is_awaited=True)

    assert rhythm.pause_s(5.001) == EAGER_POLL_S
    assert rhythm.pause_s(5.03) > EAGER_POLL_S


def test_schedule_adopts_a_shorter_period_at_once() -> None:
    rhythm = PollSchedule()
    looks_between_states(rhythm, 0.0125, states=100, awaited=False)
    rhythm.note_state(10.0, is_awaited=False)
    rhythm.note_state(10.003, is_awaited=False)

    assert rhythm.pause_s(10.003) == MIN_PERIOD_S


def test_schedule_polls_less_often_while_time_is_stopped() -> None:
    rhythm = PollSchedule()
    rhythm.note_state(1.0, is_awaited=False)

    assert rhythm.pause_s(2.0) == IDLE_S
    assert PollSchedule().pause_s(0.0) == IDLE_S


def test_schedule_limits_its_pauses() -> None:
    rhythm = PollSchedule()
    for state in range(100):
        rhythm.note_state(state * 0.1, is_awaited=False)

    assert rhythm.pause_s(9.9) == MAX_PAUSE_S


def test_a_woken_loop_answers_as_often_as_one_that_polls() -> None:
    rhythm = PollSchedule(is_woken=True)
    rhythm.note_state(10.0, is_awaited=False)

    assert rhythm.minimum_pause_s(10.0) == MIN_PERIOD_S
    assert 0.0 < rhythm.minimum_pause_s(10.0 + MIN_PERIOD_S / 2) < MIN_PERIOD_S
    assert rhythm.minimum_pause_s(10.0 + 2 * MIN_PERIOD_S) == 0.0


def test_a_woken_loop_answers_awaited_states_at_once() -> None:
    rhythm = PollSchedule(is_woken=True)
    rhythm.note_state(10.0, is_awaited=True)

    assert rhythm.minimum_pause_s(10.0) == PollSchedule().minimum_pause_s(10.0) == 0.0
