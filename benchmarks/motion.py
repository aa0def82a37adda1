"""Time from a command to motion in the robot's odometry."""

import math
import random
import time

from benchmarks.ten_robots import milliseconds, poll_until
from tests.integration.robots import Robot
from zensim.proto.messages.standard_messages import Odometry

SPEED = 0.2
MOVES = 0.01
"""Speed [m/s] from which odometry shows motion."""
REST_SPEED = 0.001
REST_MESSAGES = 8
"""Consecutive odometry messages without motion at rest; robots rock when they stop."""
LONGEST_PAUSE_S = 0.05
PATIENCE_S = 20.0
"""Simulation time is slow for large fleets."""


def response_ms(robot: Robot, phase: random.Random, speed: float) -> float:
    """Command a robot at rest, wait until it moves, and stop it."""
    time.sleep(phase.uniform(0.0, LONGEST_PAUSE_S))
    robot.read()

    def respond() -> None:
        robot.command(speed)
        poll_until(
            lambda: any(_ahead(odom, speed) > MOVES for odom in robot.read()) or None, PATIENCE_S
        )

    took_ms = milliseconds(respond)
    stop(robot)
    return took_ms


def _ahead(odom: Odometry, speed: float) -> float:
    """Find the speed in the commanded direction."""
    return math.copysign(odom.twist.twist.linear.x, odom.twist.twist.linear.x * speed)


def stop(robot: Robot) -> None:
    """Stop a robot, and wait until it is at rest."""
    robot.command(0.0)
    at_rest: list[Odometry] = []

    def is_at_rest() -> bool | None:
        for odom in robot.read():
            twist = odom.twist.twist
            if max(abs(twist.linear.x), abs(twist.angular.z)) > REST_SPEED:
                at_rest.clear()
            else:
                at_rest.append(odom)
        return len(at_rest) >= REST_MESSAGES or None

    poll_until(is_at_rest, PATIENCE_S)
