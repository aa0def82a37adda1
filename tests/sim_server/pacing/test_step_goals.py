"""Step goals: order, end, progress."""

import pytest

from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.sim_server.pacing.step_goals import MAX_FINISHED_GOALS, StepGoals

SECOND = 1_000_000_000


def make(step_goals: StepGoals, steps: int) -> None:
    for _ in range(steps):
        step_goals.note_step()
        step_goals.finish_completed()


def sent(step_goals: StepGoals, now_ns: int) -> list[StepsProgress]:
    return list(step_goals.due_progress(now_ns))


def test_goals_are_reached_one_after_another() -> None:
    stepping = StepGoals()
    first, second = stepping.add(2), stepping.add(1)

    make(stepping, 2)
    between = (first.status, second.status, len(stepping))
    make(stepping, 1)

    assert between == ("succeeded", "executing", 1)
    assert second.status == "succeeded"
    assert not stepping.has_steps_left


def test_goal_has_not_ended_before_finish_completed() -> None:
    stepping = StepGoals()
    goal = stepping.add(1)

    stepping.note_step()

    assert (goal.remaining, goal.is_over, stepping.has_steps_left) == (0, False, False)


def test_goal_of_no_steps_ends_with_finish_completed() -> None:
    stepping = StepGoals()
    goal = stepping.add(0)

    stepping.finish_completed()

    assert goal.status == "succeeded"


def test_cancel_ends_the_goal_of_an_id_and_leaves_the_others() -> None:
    stepping = StepGoals()
    first, second = stepping.add(10, "a"), stepping.add(10, "b")
    make(stepping, 4)

    canceled = stepping.cancel("a")

    assert canceled == [first]
    assert (first.status, first.completed, first.remaining) == ("canceled", 4, 6)
    assert second.status == "executing"


def test_cancel_without_an_id_ends_all_goals() -> None:
    stepping = StepGoals()
    goals = [stepping.add(1), stepping.add(1, "b")]

    assert stepping.cancel("") == goals
    assert not stepping


def test_abort_ends_all_goals_with_a_reason() -> None:
    stepping = StepGoals()
    goal = stepping.add(5, "a")

    stepping.abort("no more time")

    assert (goal.status, goal.reason) == ("aborted", "no more time")


def test_progress_is_made_at_10_hz_at_most_and_at_the_end() -> None:
    stepping = StepGoals()
    stepping.add(300, "a")
    seen = []

    for step in range(300):
        make(stepping, 1)
        seen += sent(stepping, step * SECOND // 100)

    assert len(seen) == pytest.approx(31, abs=1)
    assert seen[-1] == StepsProgress("a", 300, 0, "succeeded")
    assert all(one.completed_steps + one.remaining_steps == 300 for one in seen)


def test_progress_of_goals_without_an_id_is_not_made() -> None:
    stepping = StepGoals()
    stepping.add(1)

    first = sent(stepping, 0)
    make(stepping, 1)

    assert first + sent(stepping, SECOND) == []


def test_progress_of_a_canceled_goal_is_made_once() -> None:
    stepping = StepGoals()
    stepping.add(5, "a")
    stepping.cancel("a")

    assert sent(stepping, 0) == [StepsProgress("a", 0, 5, "canceled")]
    assert sent(stepping, SECOND) == []


def test_ended_goals_are_kept_up_to_a_limit() -> None:
    stepping = StepGoals()
    for i in range(MAX_FINISHED_GOALS + 10):
        stepping.add(1, f"goal{i}")
        make(stepping, 1)

    assert stepping.find("goal0") is None
    assert stepping.find(f"goal{MAX_FINISHED_GOALS + 9}") is not None


def test_late_agents_are_noted_for_the_active_goal() -> None:
    stepping = StepGoals()
    first, second = stepping.add(1), stepping.add(1)

    stepping.note_late(("a",))

    assert (first.late, second.late) == ({"a"}, set())
