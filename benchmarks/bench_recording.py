"""Recording

A process publishes odometry (724 B) and transforms of robots that do not exist, at 50 Hz each, and
counts them; `zensim record` writes them through its router. A sample of the recorder is a run. Then
the time from SIGTERM to the end of a recorder of 1000 topics; `zensim bag recover` of a file that
was never closed, by messages in a second of CPU time, and by its memory; and the time in which
odometry becomes a table. At last `zensim up --robots 100` in pairs, without and with a recorder of
all topics, with both engines at their default rates: the real-time factors, and which program takes
how much of a core.
"""

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from benchmarks.bench_replay import write_fleet
from benchmarks.figures import Figure, Limit, table
from benchmarks.message_source import TOPICS_OF_ROBOT, publishing
from tests.integration.processes import (
    command_line,
    free_endpoint,
    read_json_line,
    running,
    zensim,
)
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Odometry
from zensim.recording.bag_info import read_info
from zensim.recording.mcap_records import Channel, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.message_tables import read_tables
from zensim.recording.output_file import OutputFile
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.table_files import find_writer, write_tables

__all__ = ["rows", "table"]

HZ = 50.0
TOPICS = ("*/odom", "*/tf")
SECONDS, SECONDS_WHEN_SHORT = 60.0, 2.0
PAIRS = 3
RUN_S, SETTLED_S = 20.0, 3.0
PROGRAMS = {"agent": "agents", "record": "recorder", "router": "router", "sensors": "sensors"}
"""By a word of their command lines."""
KEPT_HZ = 10.0
MEBI = 1 << 20
RECOVERED_BYTES, RECOVERED_BYTES_WHEN_SHORT = 4 << 30, 20 * MEBI
EXPORTED_S = 10.0
"""Of a hundred robots at 50 Hz: 50,000 messages of odometry."""
PAYLOADS = 64
"""Different messages of the file that is recovered."""
LOST = Limit("max", "<=", 0.0, is_timed=True)


@dataclass(frozen=True)
class Recorded:
    """What a recorder did."""

    lost: int
    cores: float
    memory_mb: float
    gb_per_hour: float
    published_per_s: float


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure recorders, the simulation beside one, and recovery."""
    seconds = SECONDS_WHEN_SHORT if is_short else SECONDS
    for robots, share, disk in ((10, 0.03, 0.3), (100, 0.2, 2.6)):
        yield from _describe(f"{robots} robots", record(robots, seconds), share, disk)
    yield from _thinned(10 if is_short else 1000, seconds)
    yield from _terminated(20 if is_short else 500)
    yield from _recovered(RECOVERED_BYTES_WHEN_SHORT if is_short else RECOVERED_BYTES)
    yield from _exported(0.2 if is_short else EXPORTED_S)
    if not is_short:
        for engine in ("mujoco", "pybullet"):
            yield from _paired(engine)


def record(robots: int, seconds: float, *options: str) -> Recorded:
    """Record what a source publishes."""
    with (
        tempfile.TemporaryDirectory() as folder,
        publishing(robots, HZ, seconds) as source,
    ):
        path = Path(folder) / "run.mcap"
        arguments = (*TOPICS, *options, "-o", str(path), "--connect", source.endpoint, "--json")
        with running("record", *arguments, "--quiet") as process:
            read_json_line(process)
            source.read()
            watched, before_s = psutil.Process(process.pid), time.monotonic()
            used_s = _read_cpu(watched)
            done = source.read()
            took_s = time.monotonic() - before_s
            cores = (_read_cpu(watched) - used_s) / took_s
            memory = _read_peak(process.pid)
            time.sleep(1.0)
            process.send_signal(signal.SIGINT)
            figures = read_json_line(process)
            process.wait()
        return Recorded(
            lost=round(done["sent"]) - int(str(figures["messages"])),
            cores=cores,
            memory_mb=memory / MEBI,
            gb_per_hour=path.stat().st_size / took_s * 3600.0 / 1e9,
            published_per_s=done["sent"] / done["took_s"],
        )


def _read_cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _read_peak(pid: int) -> int:
    """Read the most resident memory of a process [bytes]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def _describe(label: str, found: Recorded, share: float, disk: float) -> Iterator[Figure]:
    yield Figure(what=f"published, {label}", unit="1/s", samples=(found.published_per_s,))
    for what, unit, value, limit in (
        ("lost", "", float(found.lost), LOST),
        ("recorder", "cores", found.cores, Limit("max", "<=", share, is_timed=True)),
        ("most memory", "MiB", found.memory_mb, Limit("max", "<=", 60.0, is_timed=True)),
        ("disk", "GB/h", found.gb_per_hour, Limit("max", "<=", disk)),
    ):
        yield Figure(what=f"{what}, {label}", unit=unit, samples=(value,), limit=limit)


def _thinned(robots: int, seconds: float) -> Iterator[Figure]:
    found = record(robots, seconds, "--rate", str(KEPT_HZ))
    kept = found.published_per_s * seconds - found.lost
    expected = robots * TOPICS_OF_ROBOT * KEPT_HZ * seconds
    label = f"{robots} robots, --rate 10"
    yield Figure(what=f"published, {label}", unit="1/s", samples=(found.published_per_s,))
    yield Figure(
        what=f"kept of what is to be kept, {label}",
        unit="",
        samples=(kept / expected,),
        limit=Limit("min", ">=", 0.98, is_timed=True),
    )
    limit = Limit("max", "<=", 0.4, is_timed=True)
    yield Figure(what=f"recorder, {label}", unit="cores", samples=(found.cores,), limit=limit)


def _terminated(robots: int) -> Iterator[Figure]:
    """Terminate a recorder; its file has to be whole."""
    with tempfile.TemporaryDirectory() as folder, publishing(robots, 5.0, 600.0) as source:
        path = Path(folder) / "run.mcap"
        with running("record", *TOPICS, "-o", str(path), "--connect", source.endpoint) as process:
            source.read()
            time.sleep(3.0)
            began_s = time.monotonic()
            process.terminate()
            process.wait()
            took_s = time.monotonic() - began_s
        info = read_info(path)
    topics = robots * TOPICS_OF_ROBOT
    label = f"SIGTERM to the end, {topics} topics"
    limit = Limit("max", "<=", 0.5, is_timed=True)
    yield Figure(what=label, unit="s", samples=(took_s,), limit=limit)
    is_whole = not info.unclosed and len(info.topics) == topics
    yield Figure(
        what="whole files after it",
        unit="",
        samples=(float(is_whole),),
        limit=Limit("min", ">=", 1.0),
    )


def _recovered(size: int) -> Iterator[Figure]:
    """Recover a file of this size that was never closed."""
    with tempfile.TemporaryDirectory() as folder:
        path, target = Path(folder) / "run.mcap", Path(folder) / "whole.mcap"
        messages = write_unclosed(path, size)
        cpu_s, peak = run_measured(
            command_line(("bag", "recover", str(path), "-o", str(target), "--json"))
        )
        found = json.loads(zensim("bag", "info", str(target), "--json").stdout)["messages"]
    label = f"recover of {size / 1e9:.1f} GB"
    yield Figure(
        what=f"messages in a second of CPU time, {label}",
        unit="1/s",
        samples=(messages / cpu_s,),
        limit=Limit("min", ">=", 200_000.0, is_timed=True),
    )
    yield Figure(
        what=f"most memory, {label}",
        unit="MiB",
        samples=(peak / MEBI,),
        limit=Limit("max", "<=", 64.0),
    )
    lost = Limit("max", "<=", 0.0)
    yield Figure(what=f"lost, {label}", unit="", samples=(float(messages - found),), limit=lost)


def _exported(seconds: float) -> Iterator[Figure]:
    """Write a table of the odometry of a hundred robots, as `zensim bag export` does."""
    times_s = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        write_fleet(path, seconds)
        find_writer("parquet")  # imports pyarrow
        for number in range(PAIRS):
            began_s = time.perf_counter()
            tables = read_tables(RecordingReader(path), lambda topic: topic.name.endswith("/odom"))
            (facts,) = write_tables(tables, Path(folder) / f"tables{number}", "parquet")
            times_s.append(time.perf_counter() - began_s)
    yield Figure(
        what=f"table of {facts.rows} odometry messages, Parquet",
        unit="s",
        samples=tuple(times_s),
        limit=Limit("median", "<=", 1.0, is_timed=True),
    )


def write_unclosed(path: Path, size: int) -> int:
    """Write odometry that does not compress to a file that is not closed; return its messages."""
    output = OutputFile(path)
    writer = McapWriter(output)
    writer.define(Schema(1, Odometry.ros_type, "ros2msg", b""))
    writer.define(*(Channel(one, 1, f"/r{one}/odom", "cdr", {}) for one in range(1, 101)))
    whole = len(encode(Odometry(), Format.CDR))
    payloads = [os.urandom(whole) for _ in range(PAYLOADS)]
    number = 0
    while output.position < size:
        writer.write_message(1 + number % 100, number * 10**6, number, payloads[number % PAYLOADS])
        number += 1
    writer.flush()
    output.close()
    return number


def run_measured(command: Sequence[str]) -> tuple[float, int]:
    """Run a command; return its CPU time [s] and its most resident memory [bytes]."""
    pid = os.posix_spawn(sys.executable, list(command), os.environ)
    _, status, usage = os.wait4(pid, 0)
    if status:
        raise RuntimeError(f"{command[2:]} ended with status {status}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024


def _paired(engine: str) -> Iterator[Figure]:
    """Compare the real-time factor of a fleet without and with a recorder of all its topics."""
    ratios: list[float] = []
    plain_runs, recorded_runs = [], []
    for _ in range(PAIRS):
        with tempfile.TemporaryDirectory() as folder:
            plain_runs.append(run_fleet(engine))
            recorded_runs.append(run_fleet(engine, "--record", str(Path(folder) / "run.mcap")))
        ratios.append(recorded_runs[-1].real_time_factor / plain_runs[-1].real_time_factor)
    label = f"100 robots, {engine}"
    yield Figure(
        what=f"real-time factor with a recorder, of that without, {label}",
        unit="",
        samples=tuple(ratios),
        limit=Limit("median", ">=", 0.97, is_timed=True),
    )
    factors = tuple(one.real_time_factor for one in plain_runs)
    yield Figure(what=f"real-time factor without a recorder, {label}", unit="", samples=factors)
    for what, runs in (("without", plain_runs), ("with", recorded_runs)):
        for program in dict.fromkeys(name for one in runs for name in one.cores):
            cores = tuple(one.cores.get(program, 0.0) for one in runs)
            yield Figure(what=f"{program}, {what} a recorder, {label}", unit="cores", samples=cores)


@dataclass(frozen=True)
class FleetRun:
    """A run of `zensim up`."""

    real_time_factor: float
    cores: dict[str, float]
    """Share of a core of each program, while robots drive."""


def run_fleet(engine: str, *options: str) -> FleetRun:
    """Run a hundred robots that drive circles, at a wanted factor of 1 and the default rates."""
    arguments = ("--robots", "100", "--behaviour", "circle", "--engine", engine, "--no-viewer")
    with running("up", *arguments, "--listen", free_endpoint(), "--json", *options) as process:
        read_json_line(process)
        time.sleep(SETTLED_S)
        before, began_s = read_programs(process.pid), time.monotonic()
        time.sleep(RUN_S)
        after, took_s = read_programs(process.pid), time.monotonic() - began_s
        process.send_signal(signal.SIGINT)
        figures = read_json_line(process)
        process.wait()
    cores = {name: (used_s - before.get(name, 0.0)) / took_s for name, used_s in after.items()}
    return FleetRun(float(str(figures["real_time_factor"])), cores)


def read_programs(pid: int) -> dict[str, float]:
    """Read the CPU time [s] of the processes of `zensim up`, by program."""
    found: dict[str, float] = {}
    for process in psutil.Process(pid).children(recursive=True):
        words = process.cmdline()
        name = next((name for word, name in PROGRAMS.items() if word in words), "server")
        found[name] = found.get(name, 0.0) + _read_cpu(process)
    return found
