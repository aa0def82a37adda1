"""Pauses, process priority and revised answers of an agent."""

from msgspec.structs import replace

from tests.robot_agent.models import a_state
from zensim.proto.messages.agent_messages import DriveState
from zensim.robot_agent.agent_timing import (
    EAGER_POLL_S,
    IDLE_S,
    MAX_COMMAND_PAUSE_S,
    MAX_PAUSE_S,
    MAX_WINDOW_S,
    MIN_PERIOD_S,
    MIN_WINDOW_S,
    NICENESS,
    LateCommandWindow,
    PollSchedule,
    ProcessPriority,
)


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
    rhythm = PollSchedule(MAX_COMMAND_PAUSE_S)
    for state in range(100):
        rhythm.note_state(state * 0.1, is_awaited=False)

    assert rhythm.pause_s(9.9) == MAX_COMMAND_PAUSE_S


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


MS = 1_000_000


def state(time_ns: int, *, is_awaited: bool = False) -> DriveState:
    return DriveState(0, 0, time_ns, b"", b"", b"", b"", is_awaited=is_awaited)


class FakeNiceness:
    """What was asked of the kernel, which is too busy for the first few."""

    def __init__(self, refusals: int = 0) -> None:
        self.requested: list[int] = []
        self._refusals = refusals

    def __call__(self, niceness: int) -> bool:
        self.requested.append(niceness)
        return len(self.requested) > self._refusals


def run(
    priority: ProcessPriority, factor: float, *, from_s: float = 0.0, awaited: bool = False
) -> None:
    """Let two seconds pass, told every 10 ms of them."""
    for tick in range(200):
        now_s = from_s + tick * 0.01
        drive_state = state(round(1000 * from_s * MS + tick * 10 * MS * factor), is_awaited=awaited)
        priority.note_state(now_s, drive_state)


def test_priority_is_lowered_once_when_time_runs_fast() -> None:
    niceness = FakeNiceness()

    run(ProcessPriority(niceness), factor=4.0)

    assert niceness.requested == [NICENESS]


def test_priority_stays_in_real_time() -> None:
    niceness = FakeNiceness()

    run(ProcessPriority(niceness), factor=1.0)

    assert niceness.requested == []


def test_priority_stays_when_time_waits_for_the_agent() -> None:
    niceness = FakeNiceness()

    run(ProcessPriority(niceness), factor=4.0, awaited=True)

    assert niceness.requested == []


def test_priority_is_set_again_when_the_kernel_refuses() -> None:
    niceness = FakeNiceness(refusals=2)

    run(ProcessPriority(niceness), factor=4.0)

    assert niceness.requested == [NICENESS] * 3


def test_priority_is_restored_when_time_runs_slowly_again() -> None:
    niceness = FakeNiceness()
    priority = ProcessPriority(niceness)

    run(priority, factor=4.0)
    run(priority, factor=1.0, from_s=100.0)

    assert niceness.requested == [NICENESS, 0]


def test_priority_survives_a_reset_of_time() -> None:
    niceness = FakeNiceness()
    priority = ProcessPriority(niceness)

    run(priority, factor=1.0, from_s=100.0)
    priority.note_state(103.0, state(0))
    priority.note_state(103.6, state(600 * MS))

    assert niceness.requested == []


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
