"""Recording

A process publishes odometry (724 B) and transforms of robots that do not exist, at 50 Hz each, and
counts them; `zensim record` writes them through its router. A sample of the recorder is a run: a
minute of a hundred robots, and 20 s of others. Then the time from SIGTERM to the end of a recorder
of 1000 topics; `zensim bag recover` of files that were never closed: messages in a second of CPU
time where a chunk has 1450, as of odometry, and memory of a file with as many chunks as if it had
been compressed to an eighth; and the time in which odometry becomes a table. At last `zensim up
--robots 100` with both engines at their default rates, in pairs of 10 s without and with a recorder
of all topics: the real-time factors, and which program takes how much of a core.
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
    read_json_line,
    running,
    running_up,
    zensim,
)
from zensim.proto.bus import Bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.service_catalog import INFO
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
SECONDS, SECONDS_OF_OTHERS, SECONDS_WHEN_SHORT = 60.0, 20.0, 1.0
PAIRS = 3
RUN_S, SETTLED_S = 10.0, 2.0
PROGRAMS = {"agent": "agents", "record": "recorder", "router": "router", "sensors": "sensors"}
"""Names of programs by a word of their command lines."""
KEPT_HZ = 10.0
TARGET = "whole.mcap"
MEBI = 1 << 20
RECOVERED_BYTES, RECOVERED_BYTES_WHEN_SHORT = 4 << 30, 20 * MEBI
TIMED_BYTES, TIMED_BYTES_WHEN_SHORT = 128 * MEBI, 2 * MEBI
FEW_MESSAGES, FULL_EVERY = 120, 50
"""Messages of a small chunk, which random bytes fill as odometry does that is compressed to an
eighth; and the interval of full chunks, as memory depends on the size of chunks, too."""
EXPORTED_S = 10.0
"""Length of a recording of a hundred robots at 50 Hz: 50,000 messages of odometry."""
PAYLOADS, PAYLOADS_OF_LARGE = 64, 4096
"""Different messages of a file that is recovered: a chunk of many compresses to a tenth, and one of
as many as it has messages does not."""
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
    seconds, of_others = (SECONDS_WHEN_SHORT,) * 2 if is_short else (SECONDS, SECONDS_OF_OTHERS)
    yield from _describe("10 robots", record(10, of_others), 0.03, 0.3)
    fleet = 3 if is_short else 100
    yield from _describe(f"{fleet} robots", record(fleet, seconds), 0.2, 2.6)
    yield from _thinned(10 if is_short else 1000, of_others)
    yield from _terminated(20 if is_short else 500)
    yield from _timed_recovery(TIMED_BYTES_WHEN_SHORT if is_short else TIMED_BYTES)
    yield from _large_recovery(RECOVERED_BYTES_WHEN_SHORT if is_short else RECOVERED_BYTES)
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
            time.sleep(1.0)
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


def _timed_recovery(size: int) -> Iterator[Figure]:
    """Time the recovery of a file of odometry that was never closed."""
    with tempfile.TemporaryDirectory() as folder:
        messages, cpu_s, _ = _recover(Path(folder), size, is_large=False)
    yield Figure(
        what=f"messages in a second of CPU time, recover of {size / 1e9:.1f} GB",
        unit="1/s",
        samples=(messages / cpu_s,),
        limit=Limit("min", ">=", 200_000.0, is_timed=True),
    )


def _large_recovery(size: int) -> Iterator[Figure]:
    """Recover a large file that was never closed, and count its messages."""
    with tempfile.TemporaryDirectory() as folder:
        messages, _, peak = _recover(Path(folder), size, is_large=True)
        target = str(Path(folder) / TARGET)
        found = json.loads(zensim("bag", "info", target, "--json").stdout)["messages"]
    label = f"recover of {size / 1e9:.1f} GB"
    yield Figure(
        what=f"most memory, {label}",
        unit="MiB",
        samples=(peak / MEBI,),
        limit=Limit("max", "<=", 64.0),
    )
    lost = Limit("max", "<=", 0.0)
    yield Figure(what=f"lost, {label}", unit="", samples=(float(messages - found),), limit=lost)


def _recover(folder: Path, size: int, *, is_large: bool) -> tuple[int, float, int]:
    """Write a file that is not closed, and recover it; return its messages, CPU time and memory."""
    path, target = folder / "run.mcap", folder / TARGET
    messages = write_unclosed(path, size, is_large=is_large)
    arguments = ("bag", "recover", str(path), "-o", str(target), "--json")
    return messages, *run_measured(command_line(arguments))


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


def write_unclosed(path: Path, size: int, *, is_large: bool) -> int:
    """Write odometry to a file that is not closed; return its messages.

    Args:
        path: New file.
        size: Bytes of it.
        is_large: Whether its messages do not compress, and most chunks have few of them.
    """
    output = OutputFile(path)
    writer = McapWriter(output)
    writer.define(Schema(1, Odometry.ros_type, "ros2msg", b""))
    writer.define(*(Channel(one, 1, f"/r{one}/odom", "cdr", {}) for one in range(1, 101)))
    whole = len(encode(Odometry(), Format.CDR))
    payloads = [os.urandom(whole) for _ in range(PAYLOADS_OF_LARGE if is_large else PAYLOADS)]
    number = 0
    while output.position < size:
        writer.write_message(
            1 + number % 100, number * 10**6, number, payloads[number % len(payloads)]
        )
        number += 1
        if is_large and not number % FEW_MESSAGES and number // FEW_MESSAGES % FULL_EVERY:
            writer.flush()
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
    plain, recorded = run_pairs(engine)
    ratios = [
        two.real_time_factor / one.real_time_factor
        for one, two in zip(plain, recorded, strict=True)
    ]
    label = f"100 robots, {engine}"
    yield Figure(
        what=f"real-time factor with a recorder, of that without, {label}",
        unit="",
        samples=tuple(ratios),
        limit=Limit("median", ">=", 0.97, is_timed=True),
    )
    factors = tuple(one.real_time_factor for one in plain)
    yield Figure(what=f"real-time factor without a recorder, {label}", unit="", samples=factors)
    for what, runs in (("without", plain), ("with", recorded)):
        for program in dict.fromkeys(name for one in runs for name in one.cores):
            cores = tuple(one.cores.get(program, 0.0) for one in runs)
            yield Figure(what=f"{program}, {what} a recorder, {label}", unit="cores", samples=cores)


@dataclass(frozen=True)
class FleetRun:
    """Some seconds of `zensim up`."""

    real_time_factor: float
    cores: dict[str, float]
    """Share of a core of each program, while robots drive."""


def run_pairs(engine: str) -> tuple[list[FleetRun], list[FleetRun]]:
    """Run a hundred robots that drive circles, at a wanted factor of 1 and the default rates.

    Returns:
        Runs without a recorder, and with one; all are of one simulation, in turns.
    """
    arguments = ("--robots", "100", "--behaviour", "circle", "--engine", engine, "--no-viewer")
    plain, recorded = [], []
    with running_up(*arguments) as (up, _, bus), tempfile.TemporaryDirectory() as folder:
        time.sleep(SETTLED_S)
        for number in range(PAIRS):
            plain.append(_measure_run(bus, up.pid))
            output = str(Path(folder) / f"run{number}.mcap")
            options = ("-o", output, "--connect", bus.endpoint, "--json", "--quiet")
            with running("record", "--all", *options) as recorder:
                read_json_line(recorder)
                time.sleep(SETTLED_S)
                recorded.append(_measure_run(bus, up.pid, recorder.pid))
    return plain, recorded


def _measure_run(bus: Bus, *pids: int) -> FleetRun:
    """Measure the programs below `zensim up`, and a recorder, for a while."""
    before, began_ns, began_s = read_programs(*pids), _read_clock(bus), time.monotonic()
    time.sleep(RUN_S)
    after, ended_ns, took_s = read_programs(*pids), _read_clock(bus), time.monotonic() - began_s
    cores = {name: (used_s - before.get(name, 0.0)) / took_s for name, used_s in after.items()}
    return FleetRun((ended_ns - began_ns) * 1e-9 / took_s, cores)


def _read_clock(bus: Bus) -> int:
    """Read the simulation time [ns]."""
    return round(bus.call(INFO, InfoRequest(), world="default").sim_time_s * 1e9)


def read_programs(pid: int, *others: int) -> dict[str, float]:
    """Read the CPU time [s] of the processes of `zensim up` and of others, by program."""
    found: dict[str, float] = {}
    processes = [*psutil.Process(pid).children(recursive=True), *map(psutil.Process, others)]
    for process in processes:
        words = process.cmdline()
        name = next((name for word, name in PROGRAMS.items() if word in words), "server")
        found[name] = found.get(name, 0.0) + _read_cpu(process)
    return found
