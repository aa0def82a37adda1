"""Replay

A recording of `odom` and `tf` of 100 robots at 50 Hz, 10,000 messages a second, is replayed by
`zensim replay` to a subscriber in another process, which is the router. CPU time includes the start
of the command. Lateness is the wall time at which a message is published less that at which it is
due. At rate 0 nothing waits. The reader is measured alone, too: by log time, and by chunk. The
large file has the same topics, with noise that does not compress; its start is from the start of
the command to the first odometry at the subscriber, at an offset in its middle.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random

import msgspec

from benchmarks.figures import Figure, Limit, table
from tests.integration.processes import free_endpoint
from zensim.proto.bus import Bus, BusConfig, open_bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Header,
    Odometry,
    String,
    TFMessage,
    Time,
    TransformStamped,
)
from zensim.proto.process_limits import PARENT_PID_VARIABLE
from zensim.proto.ros2.liveliness_tokens import LATCHED
from zensim.proto.ros2.message_definitions import write_definition
from zensim.recording.mcap_records import Channel, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import OutputFile
from zensim.recording.recorded_topics import QOS_METADATA, write_qos_profiles
from zensim.recording.recording_reader import RecordingReader

__all__ = ["rows", "table"]

ROBOTS, HZ = 100, 50
SECONDS, SECONDS_WHEN_SHORT = 60, 3
LARGE_BYTES, LARGE_BYTES_WHEN_SHORT = 1_000_000_000, 10_000_000
RUNS = 3
DEPTH = 1_000_000
NOISE_BYTES = 350
"""Random bytes in each odometry of the large file."""
KINDS = (Odometry, TFMessage, String)
ODOM, TF, DESCRIPTION = 1, 2, 3


class FleetRecording:
    """Writes the topics of a fleet to a file."""

    def __init__(self, path: Path, noise_bytes: int) -> None:
        self._output = OutputFile(path)
        self._writer = McapWriter(self._output)
        self._noise, self._noise_bytes = Random(1), noise_bytes
        for number, kind in enumerate(KINDS, 1):
            text = write_definition(kind).encode()
            self._writer.define(Schema(number, str(vars(kind)["ros_type"]), "ros2msg", text))
        for robot in range(ROBOTS):
            name = f"/box_bot{robot}"
            self._define(robot, ODOM, f"{name}/odom")
            self._define(robot, TF, f"{name}/tf")
            self._define(robot, DESCRIPTION, f"{name}/robot_description")
            urdf = encode(String("<robot/>" * 100), Format.CDR)
            self._writer.write_message(robot * len(KINDS) + DESCRIPTION, 0, 0, urdf)

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._output.position

    def write(self, tick: int) -> None:
        """Write a message of each topic."""
        time_ns = tick * NANOSECONDS // HZ
        header = Header(Time(time_ns // NANOSECONDS, time_ns % NANOSECONDS), "odom")
        odometry = encode(Odometry(header, "base_footprint"), Format.CDR)
        transforms = encode(TFMessage((TransformStamped(header, "base"),) * 3), Format.CDR)
        for robot in range(ROBOTS):
            noise = self._noise.randbytes(self._noise_bytes)
            payload = odometry[: len(odometry) - len(noise)] + noise
            first = robot * len(KINDS)
            self._writer.write_message(first + ODOM, time_ns, time_ns, payload)
            self._writer.write_message(first + TF, time_ns, time_ns, transforms)

    def close(self) -> None:
        """Write the summary."""
        self._writer.flush()
        self._writer.close()
        self._output.close()

    def _define(self, robot: int, kind: int, topic: str) -> None:
        qos = {QOS_METADATA: write_qos_profiles(LATCHED)} if kind == DESCRIPTION else {}
        self._writer.define(Channel(robot * len(KINDS) + kind, kind, topic, "cdr", qos))


class ReplayRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run of the command."""

    messages: int
    """Messages that it published, without descriptions."""
    received: int
    wall_s: float
    cpu_s: float
    """CPU time with that of its start."""
    memory_mb: float
    late_p50_s: float
    late_p99_s: float
    first_s: float
    """Time from the start of the command to the first message."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the reader, then replays."""
    with tempfile.TemporaryDirectory() as folder:
        path, seconds = Path(folder) / "fleet.mcap", SECONDS_WHEN_SHORT if is_short else SECONDS
        write_fleet(path, seconds)
        runs = 1 if is_short else RUNS
        yield from measure_reader(path, runs)
        yield from measure_pace(path, seconds, runs)
        yield from measure_rate_0(path, runs)
        path.unlink()
        large = Path(folder) / "large.mcap"
        duration_s = write_large(large, LARGE_BYTES_WHEN_SHORT if is_short else LARGE_BYTES)
        yield from measure_start(large, duration_s, runs)


def write_fleet(path: Path, seconds: float) -> None:
    """Write a recording of a duration."""
    recording = FleetRecording(path, 16)
    for tick in range(round(seconds * HZ)):
        recording.write(tick)
    recording.close()


def write_large(path: Path, size: int) -> float:
    """Write a recording of a size [bytes]; return its duration [s]."""
    recording, tick = FleetRecording(path, NOISE_BYTES), 0
    while recording.size < size:
        recording.write(tick)
        tick += 1
    recording.close()
    return tick / HZ


def measure_reader(path: Path, runs: int) -> Iterator[Figure]:
    """Measure how many messages are read in a second of CPU time."""
    by_time, by_chunk = [], []
    for _ in range(runs):
        reader = RecordingReader(path)
        began_s = time.process_time()
        count = sum(1 for _ in reader.messages())
        between_s = time.process_time()
        sum(map(len, reader.chunks()))
        by_time.append(count / (between_s - began_s) / 1000)
        by_chunk.append(count / (time.process_time() - between_s) / 1000)
    unit = "thousand messages per CPU second"
    yield Figure(what="read by log time", unit=unit, samples=tuple(by_time))
    yield Figure(what="read by chunk", unit=unit, samples=tuple(by_chunk))


def measure_pace(path: Path, seconds: float, runs: int) -> Iterator[Figure]:
    """Measure rate 1."""
    done = [replay(path) for _ in range(runs)]
    late_p50 = tuple(one.late_p50_s * 1000 for one in done)
    late_p99 = tuple(one.late_p99_s * 1000 for one in done)
    shares = tuple(one.cpu_s / seconds for one in done)
    lost = tuple(float(one.messages - one.received) for one in done)
    timed = Limit("median", "<=", 10.0, is_timed=True)
    share = Limit("median", "<=", 0.35, is_timed=True)
    yield Figure(what="rate 1: median lateness", unit="ms", samples=late_p50)
    yield Figure(what="rate 1: p99 of lateness", unit="ms", samples=late_p99, limit=timed)
    yield Figure(what="rate 1: CPU", unit="cores", samples=shares, limit=share)
    yield Figure(what="rate 1: lost", unit="messages", samples=lost, limit=Limit("max", "<=", 0.0))
    memory = tuple(one.memory_mb for one in done)
    yield Figure(what="rate 1: memory", unit="MB", samples=memory)


def measure_rate_0(path: Path, runs: int) -> Iterator[Figure]:
    """Measure how fast it goes."""
    done = [replay(path, "--rate", "0") for _ in range(runs)]
    yield Figure(
        what="rate 0: published",
        unit="messages/s",
        samples=tuple(one.messages / one.wall_s for one in done),
        limit=Limit("median", ">=", 25_000.0, is_timed=True),
    )
    lost = tuple(float(one.messages - one.received) for one in done)
    yield Figure(what="rate 0: lost at the subscriber", unit="messages", samples=lost)


def measure_start(path: Path, duration_s: float, runs: int) -> Iterator[Figure]:
    """Measure the start in the middle of a large file."""
    options = ("--start-offset", f"{duration_s / 2:g}", "--playback-duration", "0.5")
    done = [replay(path, *options) for _ in range(runs)]
    yield Figure(
        what=f"start in a file of {path.stat().st_size / 1e9:.2g} GB",
        unit="s",
        samples=tuple(one.first_s for one in done),
        limit=Limit("median", "<=", 1.0, is_timed=True),
    )
    memory = tuple(one.memory_mb for one in done)
    yield Figure(what="memory at that", unit="MB", samples=memory)


def replay(path: Path, *options: str) -> ReplayRun:
    """Run the command, and count what it publishes."""
    endpoint = free_endpoint()
    with open_bus(BusConfig(mode="router", listen=(endpoint,))) as bus:
        return run_command(bus, (str(path), "--connect", endpoint, *options))


def run_command(bus: Bus, arguments: tuple[str, ...]) -> ReplayRun:
    """Run the command to its end."""
    subscriptions = [bus.subscribe(f"**/{suffix}", DEPTH) for suffix in ("odom", "tf")]
    began_s, first_s, received = time.monotonic(), float("inf"), 0
    process = subprocess.Popen(
        [sys.executable, "-m", "zensim", "replay", *arguments, "--json"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, PARENT_PID_VARIABLE: str(os.getpid())},
    )
    usage = None
    while usage is None:
        pid, status, found = os.wait4(process.pid, os.WNOHANG)
        if pid:
            usage, process.returncode = found, os.waitstatus_to_exitcode(status)
        count = sum(len(one.take()) for one in subscriptions)
        if count and not received:
            first_s = time.monotonic() - began_s
        received += count
        time.sleep(0.005)
    received += sum(len(one.take()) for one in subscriptions)
    assert process.stdout is not None
    facts = json.loads(process.stdout.read().splitlines()[-1])
    process.stdout.close()
    return ReplayRun(
        messages=facts["messages"] - facts["latched"],
        received=received,
        wall_s=facts["wall_s"],
        cpu_s=usage.ru_utime + usage.ru_stime,
        memory_mb=usage.ru_maxrss / 1000,
        late_p50_s=facts["late_p50_s"],
        late_p99_s=facts["late_p99_s"],
        first_s=first_s,
    )
