"""Command timeouts by simulation time and wall time."""

from zensim.sim_server.pacing.command_timeouts import (
    COMMAND_TIMEOUT_NS,
    CommandReceipt,
    CommandTimeouts,
)


def watching(**last: tuple[int, int]) -> CommandTimeouts:
    """Watch agents, each with simulation time and wall time of its last command."""
    timeouts = CommandTimeouts()
    for agent, (time_ns, wall_ns) in last.items():
        timeouts.note(agent, CommandReceipt(time_ns, wall_ns, agent.encode()))
    return timeouts


def test_no_agent_is_silent_when_none_is_watched() -> None:
    assert CommandTimeouts().find_silent(10**12, 10**12) is None


def test_agent_is_silent_when_both_times_have_passed() -> None:
    timeouts = watching(a=(0, 0))

    assert timeouts.find_silent(COMMAND_TIMEOUT_NS, COMMAND_TIMEOUT_NS - 1) is None
    assert timeouts.find_silent(COMMAND_TIMEOUT_NS - 1, COMMAND_TIMEOUT_NS) is None
    assert timeouts.find_silent(COMMAND_TIMEOUT_NS, COMMAND_TIMEOUT_NS) == ("a", b"a")


def test_agent_that_commands_again_is_checked_after_the_others() -> None:
    timeouts = watching(a=(0, 0), b=(1, 1))
    timeouts.note("a", CommandReceipt(2, 2, b"a"))

    assert timeouts.find_silent(COMMAND_TIMEOUT_NS + 1, COMMAND_TIMEOUT_NS + 1) == ("b", b"b")


def test_forgotten_agent_is_not_watched() -> None:
    timeouts = watching(a=(0, 0))

    timeouts.forget("a")

    assert "a" not in timeouts
    assert timeouts.find_silent(10**12, 10**12) is None


def test_silence_counts_from_the_moment_at_which_time_went_back() -> None:
    timeouts = watching(a=(10**9, 10**9))

    assert timeouts.find_silent(0, 2 * 10**9) is None
    assert timeouts.find_silent(COMMAND_TIMEOUT_NS - 1, 10**12) is None
    assert timeouts.find_silent(COMMAND_TIMEOUT_NS, 10**12) == ("a", b"a")
