"""The status of a program: phases, and a loop that makes no turn."""

import pytest

from zensim.proto.metric_families import make_gauge
from zensim.proto.program_status import MAX_TURN_S, Phase, ProgramStatus


class Times:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize("phase", ["starting", "restoring", "draining"])
def test_program_is_alive_and_not_ready_before_its_loop_and_at_its_end(phase: Phase) -> None:
    status = ProgramStatus(Times())
    status.phase = phase

    assert status.check_alive().fault == ""
    assert status.check_ready().fault != ""


def test_first_turn_makes_a_program_ready() -> None:
    status = ProgramStatus(Times())

    status.note_turn()

    assert status.check_ready().fault == ""


def test_turn_does_not_end_draining() -> None:
    status = ProgramStatus(Times())
    status.note_turn()

    status.drain()
    status.note_turn()

    assert status.check_ready().fault != ""


def test_loop_without_a_turn_is_stuck_until_the_next() -> None:
    times = Times()
    status = ProgramStatus(times)
    status.note_turn()

    times.now_s += MAX_TURN_S
    is_alive_in_time = not status.check_alive().fault
    times.now_s += 0.1
    is_stuck = bool(status.check_alive().fault)
    status.note_turn()

    assert (is_alive_in_time, is_stuck) == (True, True)
    assert status.check_alive().fault == ""


def test_metrics_of_all_sources_are_listed() -> None:
    status = ProgramStatus()
    status.sources += [lambda: [make_gauge("a", "A.", 1.0)], lambda: [make_gauge("b", "B.", 2.0)]]

    assert [family.name for family in status.list_metrics()] == ["a", "b"]
