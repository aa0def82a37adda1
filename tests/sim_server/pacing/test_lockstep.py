"""Lockstep: awaited agents, valid replies, late agents."""

import pytest

from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.proto.settings.lockstep_settings import LockstepSettings, OnMiss
from zensim.sim_server.pacing.lockstep import MAX_CHECK_INTERVAL_NS, Lockstep

SECOND = 1_000_000_000
CLAIMS = b"\x01\0\0\0"


def state(
    step: int, *, epoch: int = 0, claims: bytes = CLAIMS, is_awaited: bool = True
) -> DriveState:
    return DriveState(epoch, step, step, claims, b"", b"", b"", is_awaited=is_awaited)


def command(step: int, *, epoch: int = 0, claims: bytes = CLAIMS) -> DriveCommand:
    return DriveCommand(epoch, step, claims, b"")


def a_lockstep(on_miss: OnMiss = "hold") -> Lockstep:
    return Lockstep(LockstepSettings(lockstep=True, lockstep_timeout=1.0, on_miss=on_miss))


def check_for(lockstep: Lockstep, seconds: float, start_ns: int = 0) -> list[str]:
    """Check repeatedly for some wall time; list the agents that became late."""
    late: list[str] = []
    for now_ns in range(start_ns, start_ns + round(seconds * SECOND), MAX_CHECK_INTERVAL_NS // 2):
        late += lockstep.find_late(now_ns)
    return late


def test_agents_are_awaited_until_they_reply() -> None:
    lockstep = a_lockstep()
    lockstep.record_sent("b", state(3), 0)
    lockstep.record_sent("a", state(3), 0)
    both = lockstep.awaited

    assert lockstep.record_answer("b", command(3))

    assert both == ("a", "b")
    assert lockstep.awaited == ("a",)


def test_unawaited_state_needs_no_reply() -> None:
    lockstep = a_lockstep()

    lockstep.record_sent("a", state(3, is_awaited=False), 0)

    assert not lockstep.is_waiting
    assert lockstep.record_answer("a", command(1))


def test_agent_that_has_not_replied_to_an_unawaited_state_is_known() -> None:
    lockstep = a_lockstep()
    lockstep.record_sent("a", state(3, is_awaited=False), 0)
    lockstep.record_sent("sensors", state(3, is_awaited=False, claims=b""), 0)

    before = lockstep.unanswered
    lockstep.record_answer("a", command(2))
    late = lockstep.unanswered
    lockstep.record_answer("a", command(3))

    assert [sorted(one) for one in (before, late, lockstep.unanswered)] == [["a"], ["a"], []]


@pytest.mark.parametrize(
    "other", [command(2), command(4), command(3, epoch=1), command(3, claims=b"\x02\0\0\0")]
)
def test_command_for_another_state_is_no_reply_to_an_awaited_one(other: DriveCommand) -> None:
    lockstep = a_lockstep()
    lockstep.record_sent("a", state(3), 0)

    assert not lockstep.record_answer("a", other)
    assert lockstep.awaited == ("a",)


def test_late_agent_is_listed_once_and_counted() -> None:
    lockstep = a_lockstep()
    lockstep.record_sent("a", state(3), 0)

    early = check_for(lockstep, 0.9)
    late = check_for(lockstep, 1.0, round(0.9 * SECOND))

    assert (early, late) == ([], ["a"])
    assert lockstep.misses == {"a": 1}
    assert not lockstep.is_waiting


def test_late_reply_is_applied_until_a_newer_state_is_sent() -> None:
    lockstep = a_lockstep()
    lockstep.record_sent("a", state(3), 0)
    check_for(lockstep, 2.0)

    assert lockstep.record_answer("a", command(3))


def test_waiting_lockstep_waits_for_ever() -> None:
    lockstep = a_lockstep("wait")
    lockstep.record_sent("a", state(3), 0)

    assert check_for(lockstep, 4.5) == ["a"] * 4
    assert lockstep.awaited == ("a",)
    assert lockstep.misses == {}


def test_silent_agent_is_not_awaited_until_it_replies_again() -> None:
    lockstep = a_lockstep("hold")
    lockstep.record_sent("a", state(3), 0)
    check_for(lockstep, 2.0)

    is_owed = lockstep.record_sent("a", state(6), 0)
    lockstep.record_answer("a", command(3))
    lockstep.record_sent("a", state(9), 0)

    assert not is_owed
    assert lockstep.misses == {"a": 2}
    assert lockstep.awaited == ("a",)


def test_failing_lockstep_waits_for_a_silent_agent_again() -> None:
    lockstep = a_lockstep("fail")
    lockstep.record_sent("a", state(3), 0)
    check_for(lockstep, 2.0)

    lockstep.record_sent("a", state(6), 0)

    assert lockstep.awaited == ("a",)


def test_agent_that_has_disappeared_is_not_awaited_and_has_missed_nothing() -> None:
    lockstep = a_lockstep()
    lockstep.record_sent("a", state(3), 0)
    check_for(lockstep, 2.0)
    lockstep.record_sent("b", state(3), 0)

    lockstep.forget("a")
    lockstep.forget("b")

    assert (lockstep.awaited, lockstep.misses) == ((), {})


def test_time_in_which_the_server_itself_was_stopped_does_not_count() -> None:
    lockstep = a_lockstep()
    lockstep.record_sent("a", state(3), 0)

    assert lockstep.find_late(60 * SECOND) == ()
    assert lockstep.awaited == ("a",)


def test_has_sent_is_true_for_the_claims_of_this_epoch() -> None:
    lockstep = a_lockstep()
    unknown = lockstep.has_sent("a", state(3))
    lockstep.record_sent("a", state(3), 0)

    assert not unknown
    assert lockstep.has_sent("a", state(6))
    assert not lockstep.has_sent("a", state(6, epoch=1))
    assert not lockstep.has_sent("a", state(6, claims=b""))


def test_saved_states_are_known_again_and_await_nobody() -> None:
    lockstep, other = a_lockstep(), a_lockstep()
    lockstep.record_sent("b", state(3), 0)
    lockstep.record_answer("b", command(3))
    other.record_sent("c", state(9), 0)

    other.load(lockstep.save())

    assert other.save() == (("b", (0, 3, CLAIMS, 0)),)
    assert other.has_sent("b", state(4))
    assert not other.has_sent("c", state(9))
    assert not other.is_waiting
