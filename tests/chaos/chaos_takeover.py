"""Agents that are suspended, replaced and resumed

An agent drives a robot and is suspended with SIGSTOP; when its lease has expired another agent
claims the robot and stops it. The first is resumed: it must be fenced, so that the robot stays at
rest and the second keeps its claim. When the second exits, the first must drive again.
"""

import signal
from collections.abc import Iterator

from benchmarks.figures import Figure, Limit
from tests.chaos.one_robot import (
    ROBOT,
    STANDING_M_S,
    drive_until_moving,
    find_speed,
    serve_one_robot,
)
from tests.integration.processes import Server, agent_of, eventually, kill, running
from tests.integration.robots import robot

ROUNDS, ROUNDS_WHEN_SHORT = 50, 1
CALM_S = 0.3
WATCHED_S = 0.5
"""Simulation time of observation after the first agent resumed."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Suspend, replace and resume agents."""
    strayed, intruded, returned = [], [], []
    with serve_one_robot() as server:
        for _ in range(ROUNDS_WHEN_SHORT if is_short else ROUNDS):
            first, moved, back = _round(server)
            intruded.append(float(first))
            strayed.append(moved)
            returned.append(back)
    yield Figure(
        what="times that the woken agent was accepted beside the new one",
        unit="",
        samples=tuple(intruded),
        limit=Limit("max", "<=", 0.0),
    )
    yield Figure(
        what="fastest that the robot moved although its holder let it stand",
        unit="m/s",
        samples=tuple(strayed),
        limit=Limit("max", "<=", STANDING_M_S),
    )
    yield Figure(
        what="second agent gone to first agent driving again",
        unit="s",
        samples=tuple(returned),
        limit=Limit("max", "<=", 5.0, is_timed=True),
    )


def _round(server: Server) -> tuple[int, float, float]:
    connected = ("--connect", server.endpoint, "--cmd-vel-timeout", "0")
    with running("agent", ROBOT, "--name", "first", *connected) as first:
        eventually(lambda: agent_of(server, ROBOT) == "first", 30.0, "claiming")
        driver = robot(server.bus, ROBOT)
        drive_until_moving(server, driver)
        kill(first.pid, signal.SIGSTOP)
        try:
            with running("agent", ROBOT, "--name", "second", *connected):
                eventually(lambda: agent_of(server, ROBOT) == "second", 30.0, "taking over")
                _wait_until_at_rest(server)
                kill(first.pid, signal.SIGCONT)
                intrusions, fastest = _observe(server)
        finally:
            kill(first.pid, signal.SIGCONT)
        left_s = server.client.info().sim_time_s
        eventually(lambda: agent_of(server, ROBOT) == "first", 30.0, "taking back")
        drive_until_moving(server, driver)
        return intrusions, fastest, server.client.info().sim_time_s - left_s


def _wait_until_at_rest(server: Server) -> None:
    """Wait until the robot is at rest; it rocks when it stops."""
    since_s = server.client.info().sim_time_s

    def is_calm() -> bool:
        nonlocal since_s
        now_s = server.client.info().sim_time_s
        if find_speed(server) > STANDING_M_S / 2:
            since_s = now_s
        return now_s > since_s + CALM_S

    eventually(is_calm, 20.0, "standing")


def _observe(server: Server) -> tuple[int, float]:
    begin_s, intrusions, fastest = server.client.info().sim_time_s, 0, 0.0
    while server.client.info().sim_time_s < begin_s + WATCHED_S:
        intrusions += agent_of(server, ROBOT) != "second"
        fastest = max(fastest, find_speed(server))
    return intrusions, fastest
