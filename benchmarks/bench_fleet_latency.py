"""Fleets: response time

`get_entity_state` of one robot at random moments, as a caller sees it, while all robots drive
circles and the server paces itself to real time, or tries to. Floor: a request to an echo process
through the same router.
"""

import random
import time
from collections.abc import Callable, Iterator

from benchmarks.echo_process import echo
from benchmarks.figures import Figure, Limit, table
from benchmarks.fleet_server import FleetServer, run_fleet_server
from benchmarks.ten_robots import milliseconds
from zensim.proto.messages.simulation_messages import State

__all__ = ["rows", "table"]

CASES = (
    (10, 240.0, "full", 1.0),
    (100, 240.0, "full", 1.0),
    (100, 100.0, "full", 1.0),
    (1000, 100.0, "auto", 5.0),
)
"""Robots, steps per simulated second, dynamics, and limit of the median response time [ms]."""
CASES_WHEN_SHORT = ((2, 240.0, "full", 1.0),)
SECONDS, SECONDS_WHEN_SHORT = 4.0, 0.5
"""Samples per size and kind of request."""
LONGEST_PAUSE_S = 0.02
SETTLE_S = 1.0
SEED = 11


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure requests at several sizes."""
    seconds = SECONDS_WHEN_SHORT if is_short else SECONDS
    for count, step_hz, dynamics, limit_ms in CASES_WHEN_SHORT if is_short else CASES:
        label = f"{count} robots, dynamics {dynamics}, {step_hz:g} Hz"
        arguments = ("--rtf", "1", "--step-hz", f"{step_hz:g}", "--dynamics", dynamics)
        with run_fleet_server(count, *arguments) as server:
            yield from _states(label, server, seconds, Limit("median", "<=", limit_ms))


def _states(label: str, server: FleetServer, seconds: float, limit: Limit) -> Iterator[Figure]:
    client = server.client
    client.set_simulation_state(State.PLAYING)
    time.sleep(SETTLE_S)
    took = _timed(lambda: client.entity_state("box_bot0"), seconds)
    with echo(client.bus) as asker:
        floor = _timed(asker.call, seconds)
    factor = client.info().real_time_factor
    yield Figure(what=f"{label}: get_entity_state", unit="ms", samples=took, limit=limit)
    yield Figure(what=f"{label}: floor, call of an echo", unit="ms", samples=floor)
    yield Figure(what=f"{label}: real-time factor", unit="", samples=(factor,))


def _timed(call: Callable[[], object], seconds: float) -> tuple[float, ...]:
    phase, end_s, took = random.Random(SEED), time.monotonic() + seconds, []
    while time.monotonic() < end_s:
        time.sleep(phase.uniform(0.0, LONGEST_PAUSE_S))
        took.append(milliseconds(call))
    return tuple(took)
