"""The graph of a thousand robots

A peer joins late, when two pools drive a thousand robots with all topics. It parses every token; a
graph is complete with the last one.
"""

from collections.abc import Iterator
from contextlib import ExitStack

from benchmarks.figures import Figure, Limit
from benchmarks.ten_robots import spawn
from tests.integration.processes import eventually
from tests.interop.acceptance import all_of
from tests.interop.foreign_peers import SERVE, Stage, stage

ROBOTS, ROBOTS_WHEN_SHORT = 1000, 5
ROUNDS, POOLS, HZ = 3, 2, 1.0
TOKENS_OF_ROBOT = 8
"""Of a box_bot: its node, and seven endpoints; fewer than a hundred of a pool have more."""
ALL_TOKENS = "@ros2_lv/0/**"
COMPLETE_S, DRIVEN_S, WAIT_S, LISTED_S = 5.0, 300.0, 60.0, 5.0
SERVER = ("--dynamics", "auto", "--step-hz", "100")


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Join late, some times."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    with stage(SERVE, options=SERVER) as network, ExitStack() as stack:
        spawn(network.server.client, robots)
        for _ in range(POOLS):
            rates = ("--odom-hz", f"{HZ:g}", "--tf-hz", f"{HZ:g}")
            stack.enter_context(network.agents("--pool", "0", *rates))
        eventually(lambda: network.server.client.info().claimed == robots, DRIVEN_S, "claiming")
        tokens = _count_tokens(network, robots)
        times_s = [_join(network, tokens) for _ in range(ROUNDS)]
    yield all_of(f"{robots} robots: nodes and endpoints", tokens, robots * TOKENS_OF_ROBOT)
    yield Figure(
        what=f"{robots} robots: {tokens} nodes and endpoints complete",
        unit="s",
        samples=tuple(times_s),
        limit=Limit("max", "<=", COMPLETE_S, is_timed=True),
    )


def _count_tokens(network: Stage, robots: int) -> int:
    """Count nodes and endpoints when there are enough and their number is stable."""
    counts = [0]

    def count() -> int | None:
        counts.append(len(network.server.bus.list_tokens(ALL_TOKENS, LISTED_S)))
        is_stable = counts[-1] == counts[-2] >= robots * TOKENS_OF_ROBOT
        return counts[-1] if is_stable else None

    return eventually(count, DRIVEN_S, "announcing")


def _join(network: Stage, tokens: int) -> float:
    limits = ("--tokens", str(tokens), "--within", f"{WAIT_S:g}")
    found = network.run("graph", "--brief", *limits, within_s=WAIT_S)
    return float(found["complete_ms"]) * 1e-3
