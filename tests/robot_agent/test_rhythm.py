"""How often an agent looks for drive states."""

from zensim.robot_agent.rhythm import COMMANDS_S, EAGER_LOOK_S, IDLE_S, LONGEST_S, SOONEST_S, Rhythm


def looks_between_states(rhythm: Rhythm, period_s: float, *, states: int, awaited: bool) -> float:
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


def test_agent_looks_a_few_times_for_a_state_in_real_time() -> None:
    assert looks_between_states(Rhythm(), 0.0125, states=200, awaited=False) < 4.5


def test_agent_looks_more_often_where_commands_are_not_to_wait_for_states() -> None:
    rhythm = Rhythm(COMMANDS_S)
    for state in range(100):
        rhythm.note_state(state * 0.1, is_awaited=False)

    assert rhythm.pause_s(9.9) == COMMANDS_S


def test_agent_answers_no_more_often_than_that_when_time_runs_fast() -> None:
    rhythm = Rhythm()

    looks = looks_between_states(rhythm, 0.0005, states=4000, awaited=False)

    assert looks <= 1.1 * 0.0005 / SOONEST_S


def test_agent_looks_again_and_again_when_it_is_awaited() -> None:
    rhythm = Rhythm()
    rhythm.note_state(5.0, is_awaited=True)

    assert rhythm.pause_s(5.001) == EAGER_LOOK_S
    assert rhythm.pause_s(5.03) > EAGER_LOOK_S


def test_agent_finds_a_faster_beat_at_once() -> None:
    rhythm = Rhythm()
    looks_between_states(rhythm, 0.0125, states=100, awaited=False)
    rhythm.note_state(10.0, is_awaited=False)
    rhythm.note_state(10.003, is_awaited=False)

    assert rhythm.pause_s(10.003) == SOONEST_S


def test_agent_looks_less_often_while_time_stands() -> None:
    rhythm = Rhythm()
    rhythm.note_state(1.0, is_awaited=False)

    assert rhythm.pause_s(2.0) == IDLE_S
    assert Rhythm().pause_s(0.0) == IDLE_S


def test_agent_never_sleeps_so_long_that_everything_else_waits() -> None:
    rhythm = Rhythm()
    for state in range(100):
        rhythm.note_state(state * 0.1, is_awaited=False)

    assert rhythm.pause_s(9.9) == LONGEST_S
