"""Ten driving robots, and their recovery time after a fault."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from subprocess import Popen

from tests.integration.processes import START_S, eventually, running, zensim
from tests.integration.robots import Robot, robot
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.topic_catalog import CLOCK
from zensim.spawner.client.sim_client import SimClient

ROBOTS, ROBOTS_WHEN_SHORT = 10, 2
MOVED_M = 0.01
BACK_S = 30.0


@dataclass
class Clock:
    """The published simulation clock, checked for steps back."""

    last: tuple[int, int] = (0, 0)
    steps_back: int = 0
    received: list[tuple[float, int]] = field(default_factory=list)
    """Wall time [s] and step of messages since the list was cleared."""

    def note(self, now_s: float, epoch: int, step: int) -> None:
        """Record the received messages."""
        self.steps_back += (epoch, step) < self.last
        self.last = (epoch, step)
        self.received.append((now_s, step))


@dataclass
class DrivenFleet:
    """Robots with one agent each, observed by a session that must also reconnect."""

    bus: Bus
    client: SimClient
    agents: list[Popen[str]]
    robots: list[Robot]
    clock: Clock
    read_clock: Callable[[], None]

    def drive_s(self) -> float:
        """Command all robots until each has moved; return the time of the last one [s]."""
        begin_s = time.monotonic()
        for found in self.robots:
            found.read()
            found.last = None
        starts: dict[str, tuple[float, float]] = {}

        def all_moved() -> bool:
            self.read_clock()
            # Command every robot, even if another has not moved yet.
            return sum(self._has_moved(found, starts) for found in self.robots) == len(self.robots)

        eventually(all_moved, BACK_S, "driving again")
        return time.monotonic() - begin_s

    def _has_moved(self, found: Robot, starts: dict[str, tuple[float, float]]) -> bool:
        found.command(0.2, 0.5)
        found.read()
        if found.last is None:
            return False
        point = found.last.pose.pose.position
        x, y = starts.setdefault(found.namespace, (point.x, point.y))
        return (point.x - x) ** 2 + (point.y - y) ** 2 > MOVED_M**2


@contextmanager
def run_driven_fleet(endpoint: str, count: int) -> Iterator[DrivenFleet]:
    """Spawn robots on a running server, and run an agent for each."""
    connected = ("--connect", endpoint)
    names = [f"box_bot{i}" for i in range(count)]
    with ExitStack() as stack:
        bus = stack.enter_context(open_bus(BusConfig(connect=(endpoint,))))
        client = SimClient(bus, timeout_s=START_S)
        client.wait_for_server(START_S)
        done = zensim("fleet", "box_bot", "--robots", str(count), "--spacing", "3", *connected)
        assert done.returncode == 0, done.stderr
        agents = [
            stack.enter_context(running("agent", name, "--quiet", *connected)) for name in names
        ]
        clock, received = Clock(), bus.subscribe(CLOCK.key("default"), 4096)

        def read_clock() -> None:
            for sample in received.take():
                message = decode(WorldClock, sample.payload, sample.encoding)
                clock.note(time.monotonic(), message.epoch, message.step)

        robots = [robot(bus, name) for name in names]
        yield DrivenFleet(bus, client, agents, robots, clock, read_clock)
