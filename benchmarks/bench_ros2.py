"""ROS 2

A server and a pool that drives 100 robots in circles, with odometry and tf at every state, without
ROS 2 (the floor, `--ros-domain off`) and with it, in turns: without subscribers, with one
subscriber to everything on ROS 2 keys, and with one subscriber to those and the plain keys of the
floor. The server's tick is CPU time of the loop thread per step. Below it is what
the subscriber makes the server's other threads route and the pool publish, beyond what they do
without one; there the floor is the cost of the same messages on plain keys.
"""

import json
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
import zenoh

from benchmarks.figures import Figure, table
from benchmarks.machine import thread_used_s, used_s
from benchmarks.motion import MOVES
from benchmarks.ten_robots import CIRCLE, MILLISECONDS, SPACING_M
from tests.integration.processes import Server, eventually, running, serving, wait_for_agents
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.messages.telemetry_messages import Snapshot
from zensim.proto.network_protocols import Sample
from zensim.proto.topic_catalog import CMD_VEL, SNAPSHOT
from zensim.spawner.spawn.spawn_client import spawn_fleet
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 100, 3
WINDOWS, WINDOW_S = 8, 2.0
MOVED_S = 60.0
FACE = ("0/**",)
PLAIN = ("*/*", "tf", *(f"sim/default/{name}" for name in ("clock", "model_states", "link_states")))
"""Key expressions without ROS 2."""
TICK, ROUTER, POOL = "the tick", "the server's other threads", "the pool"
ALL = "both processes"


@dataclass(frozen=True)
class Driven:
    """A server and a pool that drives all its robots."""

    server: Server
    pool: int
    """Process of the server."""

    def used_s(self) -> dict[str, float]:
        """Get the accumulated CPU time of each part."""
        # The loop runs in the main thread.
        pid = self.server.process.pid
        tick_s = thread_used_s(pid, pid)
        return {TICK: tick_s, ROUTER: used_s(pid) - tick_s, POOL: used_s(self.pool)}


Costs = dict[str, float]
"""CPU time of each part per step [ms]."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure both in turns."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    windows, window_s = (1, 0.2) if is_short else (WINDOWS, WINDOW_S)
    with ExitStack() as stack:
        both = [stack.enter_context(_driven(robots, domain)) for domain in ("off", "0")]
        quiet = _turns(both, windows, window_s)
        with _looking(both[1].server, FACE):
            seen = _turns(both, windows, window_s)
            with _looking(both[0].server, PLAIN):
                alike = _turns(both, windows, window_s)
    yield from _ticks(f"{robots} robots, no subscriber", quiet)
    yield from _ticks(f"{robots} robots, one subscriber to all", seen)
    yield from _passing_on(f"{robots} robots, one subscriber to all", quiet, alike)


def _ticks(label: str, turns: Sequence[tuple[Costs, Costs]]) -> Iterator[Figure]:
    for number, face in enumerate(("floor, no ROS 2", "ROS 2")):
        samples = tuple(turn[number][TICK] for turn in turns)
        yield Figure(what=f"{label}: {TICK}, {face}", unit="CPU ms a step", samples=samples)
    ratio = tuple(faced[TICK] / plain[TICK] for plain, faced in turns)
    yield Figure(what=f"{label}: {TICK}, ROS 2 / floor", unit="", samples=ratio)


def _passing_on(
    label: str, quiet: Sequence[tuple[Costs, Costs]], seen: Sequence[tuple[Costs, Costs]]
) -> Iterator[Figure]:
    """Find the additional cost of a subscriber for each part."""
    for part in (ROUTER, POOL):
        anyway = [statistics.median(turn[number][part] for turn in quiet) for number in (0, 1)]
        extra = [
            [one[part] - idle for one, idle in zip(turn, anyway, strict=True)] for turn in seen
        ]
        for number, face in enumerate(("floor, plain keys", "ROS 2")):
            samples = tuple(one[number] for one in extra)
            yield Figure(what=f"{label}: {part}, {face}", unit="CPU ms a step", samples=samples)
        ratio = tuple(faced / plain for plain, faced in extra)
        yield Figure(what=f"{label}: {part}, ROS 2 / floor", unit="", samples=ratio)
    ratio = tuple(sum(faced.values()) / sum(plain.values()) for plain, faced in seen)
    yield Figure(what=f"{label}: {ALL}, ROS 2 / floor, plain keys", unit="", samples=ratio)


@contextmanager
def _driven(robots: int, domain: str) -> Iterator[Driven]:
    with serving("--ros-domain", domain) as server:
        places = make_fleet_layout("box_bot", robots, "grid", SPACING_M)
        spawn_fleet(server.client, "box_bot", places, lambda _: None)
        arguments = ("agent", "--pool", "0", "--connect", server.endpoint, "--quiet")
        for_ever = ("--cmd-vel-timeout", "0")
        with running(*arguments, *for_ever, "--ros-domain", domain) as pool:
            names = [place.name for place in places]
            wait_for_agents(server, names)
            _circle(server.bus, names)
            yield Driven(server, pool.pid)


def _circle(bus: Bus, names: Sequence[str]) -> None:
    """Drive all in circles: robots at rest sleep, and cost nothing."""
    encoding = make_encoding(Twist, Format.CDR)
    outlets = [bus.advertise(CMD_VEL.key(name), encoding) for name in names]
    snapshots = bus.subscribe(SNAPSHOT.key("default"))
    linear, angular = CIRCLE
    payload = encode(Twist(Vector3(x=linear), Vector3(z=angular)), Format.CDR)

    def move() -> bool:
        for outlet in outlets:
            outlet.send(payload)
        return (sample := snapshots.newest()) is not None and _all_move(sample)

    eventually(move, MOVED_S, "driving circles")
    snapshots.close()
    for outlet in outlets:
        outlet.close()


def _all_move(sample: Sample) -> bool:
    found = decode(Snapshot, sample.payload, sample.encoding)
    base = np.frombuffer(found.base, "<f8").reshape(-1, STATE_COLUMNS)
    return bool((np.hypot(base[:, 7], base[:, 8]) > MOVES).all())


@contextmanager
def _looking(server: Server, patterns: Sequence[str]) -> Iterator[None]:
    """Subscribe, and discard all messages."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([server.endpoint]))
    with zenoh.open(config) as session:
        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(1)
        subscribers = [session.declare_subscriber(one, channel) for one in patterns]
        # Publishers are declared when a subscriber matches.
        time.sleep(WINDOW_S)
        yield
        for subscriber in subscribers:
            subscriber.undeclare()


def _turns(both: Sequence[Driven], windows: int, window_s: float) -> list[tuple[Costs, Costs]]:
    return [(_costs(both[0], window_s), _costs(both[1], window_s)) for _ in range(windows)]


def _costs(running_agents: Driven, window_s: float) -> Costs:
    steps, before_s = running_agents.server.steps(), running_agents.used_s()
    time.sleep(window_s)
    steps = running_agents.server.steps() - steps
    return {
        part: (spent_s - before_s[part]) / steps * MILLISECONDS
        for part, spent_s in running_agents.used_s().items()
    }
