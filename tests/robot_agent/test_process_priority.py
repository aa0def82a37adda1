"""The priority of an agent is low while time runs fast."""

from zensim.proto.messages.agent_messages import DriveState
from zensim.robot_agent.process_priority import NICENESS, ProcessPriority

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
    priority: ProcessPriority,
    factor: float,
    *,
    from_s: float = 0.0,
    seconds: float = 2.0,
    awaited: bool = False,
) -> None:
    """Let some seconds pass, with a state every 10 ms of them."""
    for tick in range(round(100 * seconds)):
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

    run(ProcessPriority(niceness), factor=4.0, seconds=4.0)

    assert niceness.requested == [NICENESS] * 3


def test_priority_stays_when_states_are_later_than_the_time_of_their_poll() -> None:
    niceness = FakeNiceness()
    priority = ProcessPriority(niceness)
    for turn in range(20):
        polled_s = 20.0 * turn
        priority.note_state(polled_s, state(round((polled_s + 15.0) * 1000) * MS))
        run(priority, factor=1.0, from_s=polled_s + 15.5)

    assert niceness.requested == []


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
