"""An agent that is killed

The node of an agent that is killed with SIGKILL disappears from the graph of a peer, and appears
again with the next agent.
"""

import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from benchmarks.figures import Figure
from tests.interop.acceptance import at_most
from tests.interop.foreign_peers import Stage, list_routers, stage

if TYPE_CHECKING:
    import subprocess

ROUNDS, ROUNDS_WHEN_SHORT = 5, 1
GONE_S, BACK_S = 3.0, 5.0
ROBOT = "box_bot0"


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill agents."""
    rounds = ROUNDS_WHEN_SHORT if is_short else ROUNDS
    for router in list_routers(is_short=is_short):
        with stage(router) as network:
            network.spawn(1)
            times = [_kill_one(network) for _ in range(rounds)]
        gone, back = zip(*times, strict=True)
        yield at_most(f"{router}: kill to disappearance", gone, GONE_S, "s", is_timed=True)
        yield at_most(f"{router}: start to appearance", back, BACK_S, "s", is_timed=True)


def _kill_one(network: Stage) -> tuple[float, float]:
    """Kill an agent and start another; return the time [s] until the peer reports each."""
    with network.running("watch", "--node", f"/{ROBOT}/agent") as watch:
        with network.agents(ROBOT) as agent:
            _wait(watch, is_present=True)
            begin_s = time.monotonic()
            agent.kill()
            _wait(watch, is_present=False)
            gone_s = time.monotonic() - begin_s
        begin_s = time.monotonic()
        with network.agents(ROBOT):
            _wait(watch, is_present=True)
            return gone_s, time.monotonic() - begin_s


def _wait(watch: "subprocess.Popen[str]", *, is_present: bool) -> None:
    assert watch.stdout is not None
    for line in watch.stdout:
        if json.loads(line)["present"] == is_present:
            return
    raise AssertionError(f"the peer exited before the node was {is_present}")
