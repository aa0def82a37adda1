"""A process that publishes odometry and transforms of a fleet, as many as can be counted exactly.

Like an agent, it publishes them for subscribers only: of each robot, and of all in few messages.

`python -m tests.chaos.message_source ENDPOINT ROBOTS HZ SECONDS` opens a router there, waits for a
subscriber, and publishes for that time; it ends when its standard input does.
"""

import json
import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.machine import ROOT
from tests.integration.processes import free_endpoint
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, BusQuery, open_bus
from zensim.proto.codec.cdr_layout import find_offsets
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.agent_messages import STATE_COLUMNS, DriveState
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.model_messages import Joint, Link, Model
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Header,
    Odometry,
    TFMessage,
    Time,
    TransformStamped,
)
from zensim.proto.messages.telemetry_messages import (
    EntityModel,
    GetModelsResponse,
    Info,
    WorldClock,
)
from zensim.proto.parent_death import PARENT_PID_VARIABLE, die_with_supervisor
from zensim.proto.service_catalog import GET_MODELS, INFO
from zensim.proto.topic_catalog import CLOCK, FLEET_ODOMETRY, ODOM, TF
from zensim.robot_agent.fleet_odometry import MotionRows
from zensim.robot_agent.fleet_odometry import make_messages as make_fleet_messages

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import BusPublisher

WORLD = "default"
STAMP = struct.Struct("<iI")
ODOM_STAMP_AT, TF_STAMP_AT = 4, 8
POSITIONS = "pose.pose.position.x", "transforms[0].transform.translation.x"
"""Numbers that change: equal messages would compress too well."""
TOPICS_OF_ROBOT = 2
STEP_NS = NANOSECONDS // 240
WHEELS = tuple(
    Joint(f"{side}_joint", "continuous", "base_footprint", f"{side}_wheel", axis=(0.0, 1.0, 0.0))
    for side in ("left", "right")
)
SETTLE_S = 0.5


@dataclass(frozen=True)
class Source:
    """A running source."""

    process: "subprocess.Popen[str]"
    endpoint: str

    def read(self) -> dict[str, float]:
        """Read the next line: `began_ns` (time of day), and then `sent` and `took_s`."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("the source has ended")
        found: dict[str, float] = json.loads(line)
        return found


@contextmanager
def publishing(robots: int, hz: float, seconds: float) -> Iterator[Source]:
    """Run a source; it publishes as soon as it has a subscriber."""
    endpoint = free_endpoint()
    arguments = (endpoint, str(robots), str(hz), str(seconds))
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.chaos.message_source", *arguments],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, PARENT_PID_VARIABLE: str(os.getpid())},
    )
    try:
        source = Source(process, endpoint)
        source.read()
        yield source
    finally:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()


class RobotTopics:
    """Publishers of odometry and transforms of robots, and their last messages."""

    def __init__(self, bus: Bus, robots: int) -> None:
        self._topics: list[tuple[BusPublisher, bytearray, int, int]] = []
        self._calls = [bus.serve(f"*/{one}", is_complete=False) for one in (ODOM.name, TF.name)]
        self._messages: dict[str, tuple[bytes, str]] = {}
        for number in range(robots):
            for spec, message, at, position in zip(
                (ODOM, TF), make_messages(), (ODOM_STAMP_AT, TF_STAMP_AT), POSITIONS, strict=True
            ):
                key, payload = spec.key(f"box_bot{number}"), encode(message, Format.CDR)
                publisher = bus.advertise(key, spec.encoding)
                places = at, find_offsets(message)[position]
                self._topics.append((publisher, bytearray(payload), *places))
                self._messages[key] = payload, spec.encoding

    @property
    def count(self) -> int:
        """Number of topics."""
        return len(self._topics)

    @property
    def is_matched(self) -> bool:
        """Whether the first topic has a subscriber."""
        return self._topics[0][0].is_matched

    def publish(self, time_ns: int) -> None:
        """Publish all topics with this stamp."""
        stamp = STAMP.pack(time_ns // NANOSECONDS, time_ns % NANOSECONDS)
        for number, (publisher, payload, at, position_at) in enumerate(self._topics):
            payload[at : at + STAMP.size] = stamp
            struct.pack_into("<d", payload, position_at, time_ns * 1e-9 + number * 0.001)
            publisher.send(bytes(payload))

    def reply(self) -> None:
        """Reply to queries with the last messages."""
        for call in (one for calls in self._calls for one in calls.take()):
            found = [(key, *one) for key, one in self._messages.items() if call.covers(key)]
            if not found:
                call.drop()
                continue
            call.reply_each([(key, payload) for key, payload, _ in found], found[0][2])


def make_messages() -> tuple[Odometry, TFMessage]:
    """Make the messages of a box_bot at its origin."""
    base = "base_footprint"
    transforms = [TransformStamped(Header(Time(), "odom"), base)]
    transforms += [TransformStamped(Header(Time(), one.parent), one.child) for one in WHEELS]
    return Odometry(Header(Time(), "odom"), base), TFMessage(tuple(transforms))


class FleetTopic:
    """The odometry of all robots in few messages, as of two pools."""

    def __init__(self, bus: Bus, robots: int) -> None:
        names = [f"box_bot{number}" for number in range(robots)]
        self._halves = names[::2], names[1::2]
        self._publishers = [
            bus.advertise(FLEET_ODOMETRY.key(WORLD, f"pool{number}"), FLEET_ODOMETRY.encoding)
            for number in range(len(self._halves))
        ]

    @property
    def is_matched(self) -> bool:
        """Whether there is a subscriber."""
        return self._publishers[0].is_matched

    def publish(self, time_ns: int) -> None:
        """Publish all robots with this stamp."""
        state = DriveState(0, time_ns // STEP_NS, time_ns, b"", b"", b"", b"")
        for publisher, names in zip(self._publishers, self._halves, strict=True):
            motions = np.zeros((len(names), STATE_COLUMNS))
            motions[:, 0] = time_ns * 1e-9 + np.arange(len(names)) * 0.001
            motions[:, 6] = 1.0
            joints = np.full((len(names), len(WHEELS)), time_ns * 1e-9)
            rows = MotionRows(names, motions.tobytes(), joints.tobytes())
            for message in make_fleet_messages(state, [rows]):
                publisher.send(encode(message, Format.MSGPACK))


def make_models(robots: int) -> GetModelsResponse:
    """Make what a server says of these robots."""
    links = ("base_footprint", *(one.child for one in WHEELS))
    drive = DiffDrive(publish_odom=True, publish_odom_tf=True)
    model = Model("box_bot", tuple(map(Link, links)), WHEELS, drive=drive)
    names = (f"box_bot{number}" for number in range(robots))
    entities = tuple(EntityModel(name, name, 0, "pool") for name in names)
    return GetModelsResponse(entities=entities, models=(model,))


class SourceServer:
    """Clock and status of the world that the messages seem to come from."""

    def __init__(self, bus: Bus, robots: int) -> None:
        self._models = make_models(robots)
        self._calls = bus.serve(keys.services(WORLD))
        self._clock_calls = bus.serve(CLOCK.key(WORLD))
        self._clock = bus.advertise(CLOCK.key(WORLD), CLOCK.encoding)
        self.time_ns = 0

    def update(self, time_ns: int) -> None:
        """Publish the clock, and reply to requests."""
        self.time_ns = time_ns
        self._clock.send(self._encode_clock())
        self.reply()

    def reply(self) -> None:
        """Reply to requests."""
        for call in self._clock_calls.take():
            call.reply(self._encode_clock(), CLOCK.encoding)
        for call in self._calls.take():
            self._reply_to(call)

    def _reply_to(self, call: BusQuery) -> None:
        info = Info(world=WORLD, step_ns=STEP_NS, state="playing")
        response = {INFO.name: info, GET_MODELS.name: self._models}.get(call.name)
        if response is None:
            call.drop()
        else:
            call.reply(encode(response, Format.MSGPACK), make_encoding(response, Format.MSGPACK))

    def _encode_clock(self) -> bytes:
        now = Time(self.time_ns // NANOSECONDS, self.time_ns % NANOSECONDS)
        return encode(WorldClock(now), Format.MSGPACK)


class Fleet:
    """All topics of the robots."""

    def __init__(self, bus: Bus, robots: int) -> None:
        self._server = SourceServer(bus, robots)
        self._robots = RobotTopics(bus, robots)
        self._fleet = FleetTopic(bus, robots)

    @property
    def is_matched(self) -> bool:
        """Whether robots or their fleet have a subscriber."""
        return self._robots.is_matched or self._fleet.is_matched

    def update(self, time_ns: int) -> None:
        """Publish the clock, and reply to queries."""
        self._server.update(time_ns)
        self._robots.reply()

    def publish(self, hz: float, seconds: float) -> int:
        """Publish at a rate for a time; return the number of messages of robots, as if each had
        a subscriber of its own.
        """
        began_s, ticks = time.monotonic(), 0
        while (elapsed_s := time.monotonic() - began_s) < seconds:
            time_ns = round(elapsed_s * NANOSECONDS)
            self.update(time_ns)
            for one in (self._robots, self._fleet):
                if one.is_matched:
                    one.publish(time_ns)
            ticks += 1
            time.sleep(max(0.0, began_s + ticks / hz - time.monotonic()))
        return ticks * self._robots.count

    def rest(self) -> None:
        """Publish the clock of the last time."""
        self.update(self._server.time_ns)


def main() -> None:
    """Publish, and wait for the end of the standard input."""
    die_with_supervisor(os.environ)
    endpoint, robots, hz, seconds = sys.argv[1:]
    has_ended = threading.Event()
    threading.Thread(target=_await_end, args=(has_ended,), daemon=True).start()
    with open_bus(BusConfig(mode="router", listen=(endpoint,))) as bus:
        fleet = Fleet(bus, int(robots))
        _print(listening=1)
        settled_s = float("inf")
        while not has_ended.wait(0.005) and time.monotonic() < settled_s:
            fleet.update(0)
            if settled_s == float("inf") and fleet.is_matched:
                settled_s = time.monotonic() + SETTLE_S
        _print(began_ns=time.time_ns())
        began_s = time.monotonic()
        sent = fleet.publish(float(hz), float(seconds))
        _print(sent=sent, took_s=time.monotonic() - began_s)
        while not has_ended.wait(0.005):
            fleet.rest()


def _await_end(has_ended: threading.Event) -> None:
    sys.stdin.read()
    has_ended.set()


def _print(**figures: float) -> None:
    sys.stdout.write(json.dumps(figures) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
