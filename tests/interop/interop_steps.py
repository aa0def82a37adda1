"""The action /simulate_steps

A foreign action client sends goals to a paused world: one that succeeds, one that it cancels, two
at the same time, and one while the world plays, which is refused.
"""

import itertools
from collections.abc import Iterator
from typing import Any

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of
from tests.interop.foreign_peers import Stage, list_routers, stage
from tests.proto.ros_hashes import hash_of_service
from zensim.proto.messages.simulation_messages import State

STEPS = 240


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Send goals through each router."""
    for router in list_routers(is_short=is_short):
        with stage(router) as network:
            yield from _judge(router, network)


def _judge(router: str, network: Stage) -> Iterator[Figure]:
    client = network.server.client
    client.set_simulation_state(State.PAUSED)
    before = network.server.steps()
    (goal,) = _send(network)
    made = network.server.steps() - before
    yield all_of(f"{router}: steps of an accepted goal", made if goal["accepted"] else 0, STEPS)
    yield all_of(f"{router}: feedback that rises", int(_rises(goal["completed"])), 1)
    yield all_of(f"{router}: SUCCEEDED", int(goal["status"] == "Succeeded"), 1)
    cancel = ("--cancel", "--cancel-hash", hash_of_service("action_msgs/srv/CancelGoal"))
    (canceled,) = _send(network, *cancel)
    is_canceled = canceled["status"] == "Canceled" and canceled["canceling"] == 1
    yield all_of(f"{router}: CANCELED", int(is_canceled), 1)
    both = _send(network, "--clients", "2")
    ended = [one.get("status", "refused") for one in both]
    known = sum(one in {"Succeeded", "refused"} for one in ended)
    yield all_of(f"{router}: replies to two at once ({', '.join(ended)})", known, 2)
    yield all_of(f"{router}: successes of two at once", ended.count("Succeeded"), 1)
    client.set_simulation_state(State.PLAYING)
    (refused,) = _send(network)
    yield all_of(f"{router}: refusals while playing", int(not refused["accepted"]), 1)


def _send(network: Stage, *options: str) -> list[dict[str, Any]]:
    goals: list[dict[str, Any]] = network.run("steps", "--steps", str(STEPS), *options)["goals"]
    return goals


def _rises(completed: list[int]) -> bool:
    return len(completed) > 0 and all(
        earlier < later for earlier, later in itertools.pairwise(completed)
    )
