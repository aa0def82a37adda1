"""Two foreign peers

A publisher with a client, and a subscriber with a server, have nothing between them but the
router. Both have the session settings of rmw_zenoh: mode peer, no multicast.
"""

from collections.abc import Iterator
from typing import Any

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of
from tests.interop.foreign_peers import Stage, list_routers, stage, wait_until_ready

SAMPLES = 10
DISCOVERY_S, LISTEN_S = 10.0, 30.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Let two peers talk."""
    for router in list_routers(is_short=is_short):
        with stage(router) as network:
            told, received = talk(network)
        yield all_of(f"{router}: samples received", len(received["received"]), SAMPLES)
        yield all_of(f"{router}: replies", int(told["replied"]), 1)
        both = int(told["discovered"]) + int(received["discovered"])
        yield all_of(f"{router}: peers that discover the other one", both, 2)


def talk(network: Stage) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run both peers; return what each of them printed."""
    with network.running("listener", "--within", f"{LISTEN_S:g}") as listener:
        wait_until_ready(listener)
        told = network.run("talker", "--within", f"{DISCOVERY_S:g}", within_s=LISTEN_S)
        received = network.read_last(listener, LISTEN_S)
    return told, received
