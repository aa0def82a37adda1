"""A router that dies

Server, agents and the commanding client connect to a separate router, which is killed and restarted
5 s later. Measured is the time from its start until every robot has moved on a command; simulation
time must not go back.
"""

import time
from collections.abc import Iterator

from benchmarks.figures import Figure, Limit
from tests.chaos.recovery import ROBOTS, ROBOTS_WHEN_SHORT, run_driven_fleet
from tests.integration.processes import connected, free_endpoint, running

ROUNDS, ROUNDS_WHEN_SHORT = 20, 1
DOWN_S, DOWN_WHEN_SHORT_S = 5.0, 1.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill the router and start it again."""
    endpoint, back = free_endpoint(), []
    with running("serve", "--connect", endpoint):
        router = running("router", "--listen", endpoint)
        process = router.__enter__()
        try:
            with (
                connected(endpoint, process),
                run_driven_fleet(endpoint, ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found,
            ):
                found.drive_s()
                for _ in range(ROUNDS_WHEN_SHORT if is_short else ROUNDS):
                    process.kill()
                    process.wait()
                    router.__exit__(None, None, None)
                    time.sleep(DOWN_WHEN_SHORT_S if is_short else DOWN_S)
                    router = running("router", "--listen", endpoint)
                    process = router.__enter__()
                    back.append(found.drive_s())
                steps_back = float(found.clock.steps_back)
        finally:
            router.__exit__(None, None, None)
    yield Figure(
        what="router started to all robots driving",
        unit="s",
        samples=tuple(back),
        limit=Limit("max", "<=", 5.0, is_timed=True),
    )
    yield Figure(
        what="times that the clock went back",
        unit="",
        samples=(steps_back,),
        limit=Limit("max", "<=", 0.0),
    )
