"""Commands taken against those due, by agent."""

import pytest

from zensim.proto.messages.telemetry_messages import AgentCommands
from zensim.sim_server.pacing.command_counts import CommandCounts


def test_rates_are_those_of_the_window_and_counts_those_since_the_start() -> None:
    counts = CommandCounts()
    for step in range(20):
        counts.note_sent("a", (0, step))
    counts.note_taken("a", (0, 3))
    counts.close_window(2.0)
    for step in range(20, 30):
        counts.note_sent("a", (0, step))
        counts.note_taken("a", (0, step))

    counts.close_window(1.0)

    assert counts.list_agents() == {"a": AgentCommands(11, 30, 10.0, 11.0)}
    assert (counts.taken, counts.due) == (11, 30)


def test_a_step_counts_once() -> None:
    counts = CommandCounts()

    for _ in range(3):
        counts.note_sent("a", (0, 7))
        counts.note_taken("a", (0, 7))
    counts.note_sent("a", (1, 7))
    counts.note_sent("a", (1, 8))

    assert counts.list_agents()["a"] == AgentCommands(1, 2)


def test_command_on_its_way_at_the_end_of_a_window_is_not_missing() -> None:
    counts = CommandCounts()
    shares = []
    for step in range(4):
        counts.note_sent("a", (0, step))
        counts.close_window(1.0)
        shares.append(counts.least_share)
        counts.note_taken("a", (0, step))

    assert shares == [1.0] * 4
    assert counts.list_agents()["a"] == AgentCommands(4, 4, 1.0, 1.0)


def test_command_that_comes_after_the_next_state_counts_once_for_its_step() -> None:
    counts = CommandCounts()

    counts.note_sent("a", (0, 0))
    counts.note_sent("a", (0, 1))
    counts.note_taken("a", (0, 0))
    late = counts.list_agents()["a"]
    counts.note_taken("a", (0, 1))

    assert late == AgentCommands(1, 1)
    assert counts.list_agents()["a"] == AgentCommands(2, 2)


def test_least_share_is_that_of_the_starved_agent() -> None:
    counts = CommandCounts()
    for step in range(20):
        counts.note_sent("a", (0, step))
        counts.note_taken("a", (0, step))
        counts.note_sent("starved", (0, step))
    counts.note_sent("starved", (0, 20))
    counts.note_taken("starved", (0, 0))

    counts.close_window(1.0)
    starved = counts.least_share
    counts.forget("starved")
    counts.close_window(1.0)

    assert starved == pytest.approx(0.05)
    assert counts.least_share == 1.0
    assert list(counts.list_agents()) == ["a"]
