"""Robots that agents drive, as a server counts them."""

import pytest

from tests.sim_server.fakes import a_command
from tests.spawner.client.test_sim_client import ServedWorld
from zensim.spawner.client.driven_count import DrivenCount, NotDriven, wait_until_driven


def drive(served: ServedWorld, agent: str, *names: str) -> None:
    served.world.claim(agent, names, "stop")
    command = a_command(served.world, agent, *([1.0] * 2 * len(names)))
    assert served.world.command(agent, command)
    served.world.record_ready_time(agent, 1)


def test_robots_count_once_their_agent_has_commanded_them() -> None:
    served = ServedWorld("r0", "r1")
    count = DrivenCount(served.client, ["r0", "r1"])

    claimed_only = count.poll()
    drive(served, "a", "r0")
    one, missing = count.poll(), count.missing
    drive(served, "b", "r1")

    assert (claimed_only, one, missing) == (0, 1, 1)
    assert (count.poll(), count.missing) == (2, 0)


def test_robots_of_others_do_not_count() -> None:
    served = ServedWorld("r0", "r1", "other0", "other1")
    count = DrivenCount(served.client, ["r0", "r1"])

    drive(served, "a", "other0", "other1")

    assert (count.poll(), count.missing) == (0, 2)


def test_no_robots_are_all_driven_without_a_call() -> None:
    assert DrivenCount(ServedWorld().client, []).missing == 0


def test_a_claim_is_not_enough_in_a_paused_world() -> None:
    served = ServedWorld("r0")
    served.world.clock.pause()
    count = DrivenCount(served.client, ["r0"])
    served.world.claim("a", ("r0",), "stop")

    claimed_only = count.poll()
    drive(served, "a", "r0")

    assert (claimed_only, count.poll()) == (0, 1)


def test_wait_names_the_robot_that_no_agent_drives() -> None:
    counts: list[int] = []

    with pytest.raises(NotDriven, match="'r0'"):
        wait_until_driven(ServedWorld("r0").client, ["r0"], 0.0, counts.append)

    assert counts
    assert set(counts) == {0}


def test_wait_ends_with_the_first_poll_that_counts_all() -> None:
    served = ServedWorld("r0")
    drive(served, "a", "r0")
    counts: list[int] = []

    wait_until_driven(served.client, ["r0"], 0.0, counts.append)

    assert counts == [1]
