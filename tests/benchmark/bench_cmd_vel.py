"""From command to motion

A robot stands, a Twist is put on its `cmd_vel` at a random moment, and the time runs until its
first odometry that shows motion has come; nine others drive circles meanwhile, all at real-time
factor 1. The server tells agents every 12.5 ms and steps every 4.2 ms: a command waits for the
agent's next state, then for the next step, and its effect for the next state. Floor: the same way
through the router twice, to a process that puts back at once what it gets.
"""

import math
import random
import time
from collections.abc import Iterator

from proto.topics import Odometry
from tests.benchmark.echo import echo
from tests.benchmark.figures import Asked, Figure, table
from tests.benchmark.fleet import ROBOTS, ROBOTS_WHEN_SHORT, fleet, milliseconds, soon
from tests.integration.robots import Robot

__all__ = ["rows", "table"]

SAMPLES = 300
SAMPLES_WHEN_SHORT = 5
SPEED = 0.2
MOVES = 0.01
"""Speed [m/s] from which odometry shows motion."""
STANDS = 0.001
STANDS_FOR = 8
"""Odometry in a row that shows no motion before a robot stands: it rocks when it stops."""
LONGEST_PAUSE_S = 0.05
SEED = 4


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the way from cmd_vel to odom, and the network's share of it."""
    count = SAMPLES_WHEN_SHORT if is_short else SAMPLES
    phase = random.Random(SEED)
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found:
        found.circle()
        first = found.robots[0]
        _stop(first)
        took = [_response_ms(first, phase, (-1) ** i * SPEED) for i in range(count)]
        with echo(found.server.bus) as asker:
            floor = [milliseconds(asker.ping) for _ in range(count)]
    yield Figure(
        what="put of cmd_vel to odom that moves",
        unit="ms",
        samples=tuple(took),
        asked=Asked("p99", "<=", 50.0),
    )
    yield Figure(what="floor: put, and put back", unit="ms", samples=tuple(floor))


def _response_ms(robot: Robot, phase: random.Random, speed: float) -> float:
    """Command a robot that stands, wait until it moves, and stop it."""
    time.sleep(phase.uniform(0.0, LONGEST_PAUSE_S))
    robot.read()

    def respond() -> None:
        robot.command(speed)
        soon(lambda: any(_ahead(odom, speed) > MOVES for odom in robot.read()) or None)

    took_ms = milliseconds(respond)
    _stop(robot)
    return took_ms


def _ahead(odom: Odometry, speed: float) -> float:
    """Find the speed in the direction that was commanded."""
    return math.copysign(odom.twist.twist.linear.x, odom.twist.twist.linear.x * speed)


def _stop(robot: Robot) -> None:
    robot.command(0.0)
    stood: list[Odometry] = []

    def stands() -> bool | None:
        for odom in robot.read():
            twist = odom.twist.twist
            if max(abs(twist.linear.x), abs(twist.angular.z)) > STANDS:
                stood.clear()
            else:
                stood.append(odom)
        return len(stood) >= STANDS_FOR or None

    soon(stands)
