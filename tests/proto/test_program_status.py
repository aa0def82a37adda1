"""The status of a program: phases, and a loop that makes no turn."""

import pytest

from tests.fakes import ManualClock
from zensim.proto.metric_families import make_gauge
from zensim.proto.program_status import CLIENT_TURN_S, SERVER_TURN_S, Phase, ProgramStatus


@pytest.mark.parametrize("phase", ["starting", "restoring", "draining"])
def test_program_is_alive_and_not_ready_before_its_loop_and_at_its_end(phase: Phase) -> None:
    status = ProgramStatus(ManualClock())
    status.phase = phase

    assert status.check_alive().fault == ""
    assert status.check_ready().fault != ""


def test_first_turn_makes_a_program_ready() -> None:
    status = ProgramStatus(ManualClock())

    status.note_turn()

    assert status.check_ready().fault == ""


def test_turn_does_not_end_draining() -> None:
    status = ProgramStatus(ManualClock())
    status.note_turn()

    status.drain()
    status.note_turn()

    assert status.check_ready().fault != ""


@pytest.mark.parametrize("max_turn_s", [SERVER_TURN_S, CLIENT_TURN_S])
def test_loop_without_a_turn_is_stuck_until_the_next(max_turn_s: float) -> None:
    times = ManualClock(100.0)
    status = ProgramStatus(times, max_turn_s=max_turn_s)
    status.note_turn()

    times.now_s += max_turn_s
    is_alive_in_time = not status.check_alive().fault
    times.now_s += 0.1
    is_stuck = bool(status.check_alive().fault)
    status.note_turn()

    assert (is_alive_in_time, is_stuck) == (True, True)
    assert status.check_alive().fault == ""


def test_program_that_ends_is_not_stuck_after_its_last_turn() -> None:
    times = ManualClock()
    status = ProgramStatus(times)
    status.note_turn()

    status.drain()
    times.now_s += 10 * SERVER_TURN_S

    assert status.check_alive().fault == ""


def test_metrics_of_all_sources_are_listed() -> None:
    status = ProgramStatus()
    status.sources += [lambda: [make_gauge("a", "A.", 1.0)], lambda: [make_gauge("b", "B.", 2.0)]]

    assert [family.name for family in status.list_metrics()] == ["a", "b"]
