"""One topic of four publishers

Four pools publish on `/tf` at 60 Hz. Nothing that a plain subscriber receives is missing in that of
ROS 2, which drops samples that are not newer than the last one of the same clock.
"""

from collections.abc import Iterator
from contextlib import ExitStack

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of, none_of
from tests.interop.foreign_peers import list_routers, stage
from tests.interop.interop_odom import listen

POOLS, ROBOTS, HZ = 4, 8, 60.0
LISTEN_S, LISTEN_WHEN_SHORT_S = 60.0, 4.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Count messages of `/tf`."""
    seconds = LISTEN_WHEN_SHORT_S if is_short else LISTEN_S
    for router in list_routers(is_short=is_short):
        with stage(router) as network, ExitStack() as stack:
            network.spawn(ROBOTS)
            for _ in range(POOLS):
                stack.enter_context(network.agents("--pool", "0", "--tf-hz", f"{HZ:g}"))
            network.wait_until_driven(ROBOTS)
            found = listen(network, "--tf", ["/tf"], seconds)["/tf"]
        yield all_of(f"{router}: publishers", found["publishers"], POOLS)
        yield none_of(f"{router}: of {found['plain']} messages lost", found["missing"])
        yield none_of(f"{router}: gaps in sequence numbers", found["gaps"])
