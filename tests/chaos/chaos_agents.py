"""Agents that are killed

A robot drives; its agent is killed with SIGKILL at a random moment. The server detects it by
the liveliness token and stops the wheels at once. Measured is the time from the kill until the
wheels are at rest, in simulation time at real-time factor 1. Then a new agent takes over.
"""

import random
from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

from benchmarks.figures import Figure, Limit
from tests.chaos.one_robot import (
    ROBOT,
    STANDING_M_S,
    drive_until_moving,
    find_speed,
    serve_one_robot,
)
from tests.integration.processes import Server, agent_of, eventually, running
from tests.integration.robots import Robot, robot

if TYPE_CHECKING:
    import subprocess

ROUNDS, ROUNDS_WHEN_SHORT = 100, 1
TIMEOUT_S = 0.5
"""Timeout after which a robot without commands stops anyway."""
MARGIN_S = 0.05
SEED = 11


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill agents of a driving robot."""
    phase = random.Random(SEED)
    with serve_one_robot() as server:
        driver: Robot | None = None
        took = []
        for _ in range(ROUNDS_WHEN_SHORT if is_short else ROUNDS):
            with ExitStack() as stack:
                process = stack.enter_context(running("agent", ROBOT, "--connect", server.endpoint))
                eventually(lambda: agent_of(server, ROBOT), 30.0, "claiming")
                driver = driver or robot(server.bus, ROBOT)
                took.append(_stop_s(server, driver, process, phase))
    yield Figure(
        what="kill of the agent to wheels at zero",
        unit="s",
        samples=tuple(took),
        limit=Limit("max", "<=", TIMEOUT_S + MARGIN_S, is_timed=True),
    )


def _stop_s(
    server: Server, driver: Robot, process: "subprocess.Popen[str]", phase: random.Random
) -> float:
    drive_until_moving(server, driver, phase.uniform(0.0, 0.3))
    process.kill()
    killed_s = server.client.info().sim_time_s
    process.wait()
    eventually(lambda: find_speed(server) < STANDING_M_S, 10.0, "standing")
    return server.client.info().sim_time_s - killed_s
