"""Fleets: response time

`get_entity_state` of one robot at random moments, as a caller sees it, while all robots drive
circles and the server paces itself to real time, or tries to. Floor: a request to an echo process
through the same router.
"""

import random
import time
from collections.abc import Callable, Iterator

from benchmarks.echo_process import echo
from benchmarks.figures import Asked, Figure, table
from benchmarks.fleet_server import Served, served
from benchmarks.ten_robots import milliseconds
from zensim.proto.messages.simulation_messages import State

__all__ = ["rows", "table"]

CASES = (
    (10, 240.0, "full", 1.0),
    (100, 240.0, "full", 1.0),
    (100, 100.0, "full", 1.0),
    (1000, 100.0, "auto", 5.0),
)
"""Robots, steps a simulated second, dynamics, and what is asked of the median answer [ms]."""
CASES_WHEN_SHORT = ((2, 240.0, "full", 1.0),)
SECONDS, SECONDS_WHEN_SHORT = 4.0, 0.5
"""For each size and kind of request."""
LONGEST_PAUSE_S = 0.02
SETTLE_S = 1.0
SEED = 11


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure requests at several sizes."""
    seconds = SECONDS_WHEN_SHORT if is_short else SECONDS
    for count, step_hz, dynamics, limit_ms in CASES_WHEN_SHORT if is_short else CASES:
        whom = f"{count} robots, dynamics {dynamics}, {step_hz:g} Hz"
        wish = ("--rtf", "1", "--step-hz", f"{step_hz:g}", "--dynamics", dynamics)
        with served(count, *wish) as server:
            yield from _states(whom, server, seconds, Asked("median", "<=", limit_ms))


def _states(whom: str, server: Served, seconds: float, asked: Asked) -> Iterator[Figure]:
    client = server.client
    client.set_simulation_state(State.PLAYING)
    time.sleep(SETTLE_S)
    took = _timed(lambda: client.entity_state("box_bot0"), seconds)
    with echo(client.bus) as asker:
        floor = _timed(asker.call, seconds)
    factor = client.info().real_time_factor
    yield Figure(what=f"{whom}: get_entity_state", unit="ms", samples=took, asked=asked)
    yield Figure(what=f"{whom}: floor, call of an echo", unit="ms", samples=floor)
    yield Figure(what=f"{whom}: real-time factor", unit="", samples=(factor,))


def _timed(call: Callable[[], object], seconds: float) -> tuple[float, ...]:
    phase, end_s, took = random.Random(SEED), time.monotonic() + seconds, []
    while time.monotonic() < end_s:
        time.sleep(phase.uniform(0.0, LONGEST_PAUSE_S))
        took.append(milliseconds(call))
    return tuple(took)
