"""Agents that hang

A robot drives, and its agent hangs at a random moment: in one half of the rounds the process is
suspended with SIGSTOP, in the other its main thread sleeps while its session stays alive. The
server stops the wheels 0.4 s after the last command, in simulation time, and publishes the event
`timed_out` with the robot and the agent. Measured are the time from the hang until the wheels are
set to zero, which is the step of that event, and until the robot is at rest, which adds its braking
and the time of two requests; and the time until another agent that waits for the robot has it. All
are simulation time at real-time factor 1.
"""

import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import takewhile
from typing import NamedTuple

from benchmarks.figures import Figure, Limit
from tests.chaos.chaos_agents import MARGIN_S, TIMEOUT_S
from tests.chaos.one_robot import (
    ROBOT,
    STANDING_M_S,
    drive_until_moving,
    find_speed,
    serve_one_robot,
)
from tests.integration.processes import Server, agent_of, end, eventually, kill, running
from tests.integration.robots import robot
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.topic_catalog import EVENTS

ROUNDS, ROUNDS_WHEN_SHORT = 100, 2
TAKEOVERS, TAKEOVERS_WHEN_SHORT = 20, 1
TAKEOVER_S = 2.0
SEED = 17
TIMED_OUT = "timed_out", ROBOT, "driver"
SLEEP_ON_SIGNAL = """
import signal, sys, time
signal.signal(signal.SIGUSR1, lambda *_: time.sleep(60.0))
from zensim.__main__ import main
sys.argv[0] = "zensim"
main()
"""


class Hang(NamedTuple):
    """What one hang led to: times [s] from the hang, and the number of events."""

    zeroed_s: float
    rest_s: float
    events: int


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Hang agents of a driving robot."""
    phase = random.Random(SEED)
    rounds = ROUNDS_WHEN_SHORT if is_short else ROUNDS
    with serve_one_robot() as server:
        found = [_hang(server, signal_of_round(i), phase) for i in range(rounds)]
        takeovers = TAKEOVERS_WHEN_SHORT if is_short else TAKEOVERS
        took = [_take_over_s(server) for _ in range(takeovers)]
    yield Figure(
        what="hang of the agent to wheels set to zero",
        unit="s",
        samples=tuple(hang.zeroed_s for hang in found),
        limit=Limit("max", "<=", TIMEOUT_S + MARGIN_S, is_timed=True),
    )
    yield Figure(
        what="hang of the agent to robot at rest",
        unit="s",
        samples=tuple(hang.rest_s for hang in found),
    )
    yield Figure(
        what="events of a hang that name the robot and the agent",
        unit="",
        samples=tuple(float(hang.events) for hang in found),
        limit=Limit("min", ">=", 1.0),
    )
    yield Figure(
        what="suspended agent to claim of another one that waits",
        unit="s",
        samples=tuple(took),
        limit=Limit("max", "<=", TAKEOVER_S, is_timed=True),
    )


@contextmanager
def _agent(server: Server) -> Iterator["subprocess.Popen[bytes]"]:
    """Run an agent whose main thread sleeps at SIGUSR1."""
    arguments = ("agent", ROBOT, "--name", "driver", "--connect", server.endpoint)
    process = subprocess.Popen(
        [sys.executable, "-c", SLEEP_ON_SIGNAL, *arguments], stderr=subprocess.DEVNULL
    )
    try:
        eventually(lambda: agent_of(server, ROBOT) == "driver", 30.0, "claiming")
        yield process
    finally:
        process.kill()
        process.wait()
        eventually(lambda: not agent_of(server, ROBOT), 30.0, "releasing")


def signal_of_round(number: int) -> signal.Signals:
    """Choose how the agent of a round hangs."""
    return signal.SIGUSR1 if number % 2 else signal.SIGSTOP


def _hang(server: Server, how: signal.Signals, phase: random.Random) -> Hang:
    """Hang an agent, and wait until its robot rests and the event is there."""
    events = server.bus.subscribe(EVENTS.key("default"), 64)
    with _agent(server) as process:
        drive_until_moving(server, robot(server.bus, ROBOT), phase.uniform(0.0, 0.3))
        process.send_signal(how)
        hung = server.client.info()
        eventually(lambda: find_speed(server) < STANDING_M_S, 10.0, "standing")
        rest_s = server.client.info().sim_time_s - hung.sim_time_s
        steps: list[int] = []

        def is_timed_out() -> bool:
            # A robot whose last `cmd_vel` expired first rests before the server stops it.
            for one in events.take():
                event = decode(Event, one.payload, one.encoding)
                if (event.kind, event.entity, event.agent) == TIMED_OUT:
                    steps.append(event.step)
            return bool(steps)

        eventually(is_timed_out, 10.0, "an event")
    events.close()
    zeroed_s = (steps[0] - hung.steps) * hung.step_ns * 1e-9
    return Hang(zeroed_s=zeroed_s, rest_s=rest_s, events=len(steps))


def _wait_until_refused(agent: "subprocess.Popen[str]") -> None:
    """Wait until an agent has asked for its robot, and says that another one has it."""
    assert agent.stderr is not None
    said = list(takewhile(lambda line: "waiting" not in line, agent.stderr))
    assert agent.poll() is None, said


def _take_over_s(server: Server) -> float:
    connected = ("--connect", server.endpoint)
    with _agent(server) as process:
        with running("agent", ROBOT, "--name", "second", "--wait", "60", *connected) as second:
            _wait_until_refused(second)
            drive_until_moving(server, robot(server.bus, ROBOT))
            kill(process.pid, signal.SIGSTOP)
            hung_s = server.client.info().sim_time_s
            eventually(lambda: agent_of(server, ROBOT) == "second", 30.0, "taking over")
            took_s = server.client.info().sim_time_s - hung_s
            end(second)
        return took_s
