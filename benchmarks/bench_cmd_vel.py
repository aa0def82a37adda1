"""From command to motion

A robot stands, a Twist is published on its `cmd_vel` at a random moment, and the time is measured
until its first odometry that shows motion. Nine others drive circles, all at real-time factor 1.
The server publishes states every 12.5 ms and steps every 4.2 ms: a command waits for the agent's
next check (3.5 ms), then for the next step; the body moves one to four steps after its wheels, and
that waits for the next state. Floor: the same way through the router twice, to a process that
publishes what it receives.
"""

import random
from collections.abc import Iterator

from benchmarks.echo_process import echo
from benchmarks.figures import Figure, table
from benchmarks.motion import SPEED, response_ms, stop
from benchmarks.ten_robots import ROBOTS, ROBOTS_WHEN_SHORT, fleet, milliseconds

__all__ = ["rows", "table"]

SAMPLES = 300
SAMPLES_WHEN_SHORT = 5
SEED = 4


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the latency from cmd_vel to odom, and the network's share."""
    count = SAMPLES_WHEN_SHORT if is_short else SAMPLES
    phase = random.Random(SEED)
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found:
        found.circle()
        first = found.robots[0]
        stop(first)
        took = [response_ms(first, phase, (-1) ** i * SPEED) for i in range(count)]
        with echo(found.server.bus) as asker:
            floor = [milliseconds(asker.ping) for _ in range(count)]
    yield Figure(what="put of cmd_vel to odom that moves", unit="ms", samples=tuple(took))
    yield Figure(what="floor: put, and put back", unit="ms", samples=tuple(floor))
