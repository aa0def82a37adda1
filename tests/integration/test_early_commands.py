"""A command between two drive states moves the robot before the next one."""

import math

from tests.integration.processes import Server, eventually, running_agents, serving
from tests.integration.robots import Robot, robot
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time

NAME = "box_bot0"
PERIOD_NS = NANOSECONDS
MOVES_MPS = 0.05
TRIES = 5
SOON_S = 20.0


def test_robot_moves_before_the_next_drive_state_when_commanded_between_states() -> None:
    with serving("--control-hz", "1") as server:
        assert server.zensim("fleet", "box_bot", "--robots", "1").returncode == 0
        with running_agents(server, NAME, options=("--cmd-vel-timeout", "0")):
            found = robot(server.bus, NAME)

            waits = [_waited_ns(server, found, 0.2 * (-1) ** i) for i in range(TRIES)]

            # The first state follows the claim; a state delayed by load is no evidence.
            assert min(waits[1:]) < PERIOD_NS


def _waited_ns(server: Server, found: Robot, speed: float) -> int:
    """Command right after odometry; return the simulation time from it to motion [ns]."""
    told_ns = ns_from_time(found.now().header.stamp)
    found.command(speed)

    def moved_ns() -> int | None:
        state = server.client.entity_state(NAME)
        moves = math.copysign(1.0, speed) * state.twist.linear.x > MOVES_MPS
        return ns_from_time(state.header.stamp) if moves else None

    return eventually(moved_ns, SOON_S, "motion") - told_ns
