"""Agents that need no state for some time."""

from zensim.sim_server.pacing.resting_agents import MAX_REST_NS, RestingAgents

VERSION = (0, 1)


def resting(rest_ns: int) -> RestingAgents:
    agents = RestingAgents()
    agents.note("a", rest_ns, time_ns=1000, now_ns=5000, version=VERSION)
    return agents


def find(agents: RestingAgents, time_ns: int, now_ns: int) -> frozenset[str]:
    return agents.find(time_ns=time_ns, now_ns=now_ns, version=VERSION)


def test_rest_lasts_as_long_as_the_agent_says() -> None:
    agents = resting(100)

    assert find(agents, 1099, 5099) == {"a"}
    assert find(agents, 1100, 5099) == frozenset()
    assert find(agents, 1099, 5100) == frozenset()


def test_rest_is_limited() -> None:
    assert find(resting(10 * MAX_REST_NS), 1000 + MAX_REST_NS, 5000) == frozenset()


def test_rest_ends_with_a_command_without_one_and_with_its_agent() -> None:
    agents, gone = resting(100), resting(100)

    agents.note("a", 0, time_ns=1010, now_ns=5010, version=VERSION)
    gone.forget("a")

    assert find(agents, 1020, 5020) == find(gone, 1020, 5020) == frozenset()


def test_rest_ends_when_claims_or_epoch_change() -> None:
    agents = resting(100)

    assert agents.find(time_ns=1010, now_ns=5010, version=(0, 2)) == frozenset()
    assert agents.find(time_ns=10, now_ns=5010, version=(1, 1)) == frozenset()
