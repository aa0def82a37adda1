"""Recording

A process publishes odometry (724 B) and transforms of robots that do not exist, at 50 Hz each, and
counts them; `zensim record` writes them through its router. A sample of the recorder is a run: a
minute of a hundred robots, and 20 s of others. Then the time from SIGTERM to the end of a recorder
of 1000 topics, and `zensim up --robots 100` with both engines at their default rates, in pairs of
10 s without and with a recorder of all topics: the real-time factors, and which program takes how
much of a core.
"""

import signal
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

from benchmarks.figures import Figure, table
from tests.chaos.message_source import TOPICS_OF_ROBOT, publishing
from tests.integration.processes import read_json_line, running, running_up
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.service_catalog import INFO
from zensim.recording.bag_info import read_info

__all__ = ["rows", "table"]

HZ = 50.0
TOPICS = ("*/odom", "*/tf")
SECONDS, SECONDS_OF_OTHERS, SECONDS_WHEN_SHORT = 60.0, 20.0, 1.0
PAIRS = 3
RUN_S, SETTLED_S = 10.0, 2.0
PROGRAMS = {"agent": "agents", "record": "recorder", "router": "router", "sensors": "sensors"}
"""Names of programs by a word of their command lines."""
KEPT_HZ = 10.0
MEBI = 1 << 20


@dataclass(frozen=True)
class Recorded:
    """What a recorder did."""

    lost: int
    cores: float
    memory_mb: float
    gb_per_hour: float
    published_per_s: float


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure recorders, and the simulation beside one."""
    seconds, of_others = (SECONDS_WHEN_SHORT,) * 2 if is_short else (SECONDS, SECONDS_OF_OTHERS)
    yield from _describe("10 robots", record(10, of_others))
    fleet = 3 if is_short else 100
    yield from _describe(f"{fleet} robots", record(fleet, seconds))
    yield from _thinned(10 if is_short else 1000, of_others)
    yield from _terminated(20 if is_short else 500)
    if not is_short:
        for engine in ("mujoco", "pybullet"):
            yield from _paired(engine)


def record(robots: int, seconds: float, *options: str) -> Recorded:
    """Record what a source publishes."""
    with tempfile.TemporaryDirectory() as folder, publishing(robots, HZ, seconds) as source:
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


def _describe(label: str, found: Recorded) -> Iterator[Figure]:
    for what, unit, value in (
        ("published", "1/s", found.published_per_s),
        ("lost", "", float(found.lost)),
        ("recorder", "cores", found.cores),
        ("most memory", "MiB", found.memory_mb),
        ("disk", "GB/h", found.gb_per_hour),
    ):
        yield Figure(what=f"{what}, {label}", unit=unit, samples=(value,))


def _thinned(robots: int, seconds: float) -> Iterator[Figure]:
    found = record(robots, seconds, "--rate", str(KEPT_HZ))
    kept = found.published_per_s * seconds - found.lost
    expected = robots * TOPICS_OF_ROBOT * KEPT_HZ * seconds
    label = f"{robots} robots, --rate 10"
    yield Figure(what=f"published, {label}", unit="1/s", samples=(found.published_per_s,))
    yield Figure(what=f"kept of what is to be kept, {label}", unit="", samples=(kept / expected,))
    yield Figure(what=f"recorder, {label}", unit="cores", samples=(found.cores,))


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
    yield Figure(what=label, unit="s", samples=(took_s,))
    is_whole = not info.unclosed and len(info.topics) == topics
    yield Figure(what="whole files after it", unit="", samples=(float(is_whole),))


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
