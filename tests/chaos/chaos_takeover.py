"""Agents that are suspended, replaced and resumed

An agent drives a robot and is suspended with SIGSTOP; when its lease has expired another agent
claims the robot and stops it. The first is resumed: it must be fenced, so that the robot stays at
rest and the second keeps its claim. When the second exits, the first must drive again. On a busy
host the second may get no core for 0.4 s: it counts as hung, too, and the first may take the robot.
"""

import signal
from collections.abc import Iterator
from typing import NamedTuple

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
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.network_protocols import Sample
from zensim.proto.topic_catalog import EVENTS

ROUNDS, ROUNDS_WHEN_SHORT = 50, 1
CALM_S = 0.3
WATCHED_S = 0.5
"""Simulation time of observation after the first agent resumed."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Suspend, replace and resume agents."""
    strayed, intruded, returned, hung = [], [], [], []
    with serve_one_robot() as server:
        for _ in range(ROUNDS_WHEN_SHORT if is_short else ROUNDS):
            found = _round(server)
            intruded.append(0.0 if found.is_second_hung else float(found.intrusions))
            strayed.append(found.fastest_m_s)
            returned.append(found.back_s)
            hung.append(float(found.is_second_hung))
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
    yield Figure(
        what="rounds in which the new agent counted as hung, so that the woken one might take over",
        unit="",
        samples=(sum(hung),),
    )


class Takeover(NamedTuple):
    """What a round showed; times are simulation time."""

    intrusions: int
    fastest_m_s: float
    is_second_hung: bool
    back_s: float


def _round(server: Server) -> Takeover:
    events = server.bus.subscribe(EVENTS.key("default"), 64)
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
                events.take()
                kill(first.pid, signal.SIGCONT)
                intrusions, fastest = _observe(server)
                is_hung = any(map(_is_second_hung, events.take()))
        finally:
            kill(first.pid, signal.SIGCONT)
        left_s = server.client.info().sim_time_s
        eventually(lambda: agent_of(server, ROBOT) == "first", 30.0, "taking back")
        drive_until_moving(server, driver)
        events.close()
        return Takeover(intrusions, fastest, is_hung, server.client.info().sim_time_s - left_s)


def _is_second_hung(sample: Sample) -> bool:
    event = decode(Event, sample.payload, sample.encoding)
    return (event.kind, event.agent) == ("timed_out", "second")


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
