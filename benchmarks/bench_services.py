"""Services

From request to response, as a caller sees it, at random moments while ten robots drive circles.
Floor: a request to an echo process through the same router.
"""

import random
import time
from collections.abc import Callable, Iterator

from benchmarks.echo_process import Echo, echo
from benchmarks.figures import Figure, table
from benchmarks.ten_robots import ROBOTS, ROBOTS_WHEN_SHORT, fleet, milliseconds
from tests.integration.processes import Server

__all__ = ["rows", "table"]

SAMPLES = 500
SAMPLES_WHEN_SHORT = 3
LONGEST_PAUSE_S = 0.01
SEED = 7


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure reading services."""
    count = SAMPLES_WHEN_SHORT if is_short else SAMPLES
    phase = random.Random(SEED)
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found:
        found.circle()
        with echo(found.server.bus) as asker:
            for what, call in _calls(found.server, asker).items():
                samples = tuple(_timed(call, phase) for _ in range(count))
                yield Figure(what=what, unit="ms", samples=samples)


def _calls(server: Server, asker: Echo) -> dict[str, Callable[[], object]]:
    client = server.client
    return {
        "get_entity_state": lambda: client.entity_state("box_bot1"),
        "get_entities": client.entities,
        "info": client.info,
        "floor: call of an echo": asker.call,
    }


def _timed(call: Callable[[], object], phase: random.Random) -> float:
    time.sleep(phase.uniform(0.0, LONGEST_PAUSE_S))
    return milliseconds(call)
