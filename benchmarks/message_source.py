"""A process that publishes odometry and transforms of a fleet, as many as can be counted exactly.

`python -m benchmarks.message_source ENDPOINT ROBOTS HZ SECONDS` opens a router there, waits for a
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

from benchmarks.machine import ROOT
from tests.integration.processes import free_endpoint
from zensim.proto import keys
from zensim.proto.bus import Bus, BusConfig, BusPublisher, BusQuery, open_bus
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.model_messages import Link, Model
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
from zensim.proto.process_limits import PARENT_PID_VARIABLE, die_with_supervisor
from zensim.proto.service_catalog import GET_MODELS, INFO
from zensim.proto.topic_catalog import CLOCK, ODOM, TF

WORLD = "default"
STAMP = struct.Struct("<iI")
ODOM_STAMP_AT, TF_STAMP_AT = 4, 8
POSITION_AT = 120
"""Within both messages, in numbers that change: equal messages would compress too well."""
TOPICS_OF_ROBOT = 2
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
        [sys.executable, "-m", "benchmarks.message_source", *arguments],
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


class FleetMessages:
    """Publishers of odometry and transforms, and their messages."""

    def __init__(self, bus: Bus, robots: int) -> None:
        self._topics: list[tuple[BusPublisher, bytearray, int]] = []
        for number in range(robots):
            frame, base = f"box_bot{number}/odom", f"box_bot{number}/base_footprint"
            odometry = Odometry(Header(Time(), frame), base)
            transform = TransformStamped(Header(Time(), frame), base)
            for spec, message, at in (
                (ODOM, odometry, ODOM_STAMP_AT),
                (TF, TFMessage((transform,) * 3), TF_STAMP_AT),
            ):
                publisher = bus.advertise(spec.key(f"box_bot{number}"), spec.encoding)
                self._topics.append((publisher, bytearray(encode(message, Format.CDR)), at))

    @property
    def is_matched(self) -> bool:
        """Whether the first topic has a subscriber."""
        return self._topics[0][0].is_matched

    def publish(self, time_ns: int) -> int:
        """Publish all topics with this stamp; return their number."""
        stamp = STAMP.pack(time_ns // NANOSECONDS, time_ns % NANOSECONDS)
        for number, (publisher, payload, at) in enumerate(self._topics):
            payload[at : at + STAMP.size] = stamp
            struct.pack_into("<d", payload, POSITION_AT, time_ns * 1e-9 + number * 0.001)
            publisher.send(bytes(payload))
        return len(self._topics)


def make_models(robots: int) -> GetModelsResponse:
    """Make what a server says of these robots."""
    model = Model("box_bot", (Link("base_footprint"),), drive=DiffDrive())
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
        info = Info(world=WORLD, step_ns=NANOSECONDS // 240, state="playing")
        response = {INFO.name: info, GET_MODELS.name: self._models}.get(call.name)
        if response is None:
            call.drop()
        else:
            call.reply(encode(response, Format.MSGPACK), make_encoding(response, Format.MSGPACK))

    def _encode_clock(self) -> bytes:
        now = Time(self.time_ns // NANOSECONDS, self.time_ns % NANOSECONDS)
        return encode(WorldClock(now), Format.MSGPACK)


def publish(server: SourceServer, messages: FleetMessages, hz: float, seconds: float) -> int:
    """Publish at a rate for a time; return the number of messages."""
    began_s, sent, ticks = time.monotonic(), 0, 0
    while (elapsed_s := time.monotonic() - began_s) < seconds:
        server.update(round(elapsed_s * NANOSECONDS))
        sent += messages.publish(server.time_ns)
        ticks += 1
        time.sleep(max(0.0, began_s + ticks / hz - time.monotonic()))
    return sent


def main() -> None:
    """Publish, and wait for the end of the standard input."""
    die_with_supervisor(os.environ)
    endpoint, robots, hz, seconds = sys.argv[1:]
    has_ended = threading.Event()
    threading.Thread(target=_await_end, args=(has_ended,), daemon=True).start()
    with open_bus(BusConfig(mode="router", listen=(endpoint,))) as bus:
        server, messages = SourceServer(bus, int(robots)), FleetMessages(bus, int(robots))
        _print(listening=1)
        settled_s = float("inf")
        while not has_ended.wait(0.005) and time.monotonic() < settled_s:
            server.update(0)
            if settled_s == float("inf") and messages.is_matched:
                settled_s = time.monotonic() + SETTLE_S
        _print(began_ns=time.time_ns())
        began_s = time.monotonic()
        sent = publish(server, messages, float(hz), float(seconds))
        _print(sent=sent, took_s=time.monotonic() - began_s)
        while not has_ended.wait(0.005):
            server.update(server.time_ns)


def _await_end(has_ended: threading.Event) -> None:
    sys.stdin.read()
    has_ended.set()


def _print(**figures: float) -> None:
    sys.stdout.write(json.dumps(figures) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
