"""Everything on

`zensim up --secure --record FILE` with its page and the ROS 2 side: box_bot_lidars (360 rays at
10 Hz) drive circles in the warehouse, all topics are recorded, and one visitor has the page open. A
sample is a second of wall time after the first ones. Cores are seconds of CPU time per second, of
all processes of a program; memory is what only they use. `client` is the visitor, on the same
cores; `zensim up` also commands the robots. Scans of a robot are counted in the recording, in
simulation time. The rows `defaults` have no further options: PyBullet at 240 Hz, full dynamics,
drive states at 80 Hz, an agent a robot (a pool for a hundred), and the rates of topics that the
model names: odometry and tf with each drive state, 50 Hz of the inertial unit and the bumper. A
user of many robots asks for less: the rows `fleet` are MuJoCo at 100 Hz, full dynamics, drive
states at 50 Hz.
"""

import signal
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import msgspec
import psutil

from benchmarks.figures import Figure, written
from benchmarks.figures import table as format_figures
from benchmarks.fleet_server import program
from benchmarks.machine import used_s
from benchmarks.page_visitor import Second
from benchmarks.secured_server import Deployment, deployed_by, state_folder
from benchmarks.up_programs import find_programs
from tests.integration.processes import END_S
from zensim.proto.endpoints import with_free_port
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.recording.recording_reader import RecordingReader

SECONDS, SECONDS_WHEN_SHORT = 20, 1
WARM_UP, WARM_UP_WHEN_SHORT = 5, 0
"""Seconds before the first sample, in which the scene is sent."""
MODEL = "box_bot_lidar"
SPACING_M = 1.2
MEGABYTES = 1e-6
MANY = 100
FLEET = ("--engine", "mujoco", "--step-hz", "100", "--control-hz", "50")
CLIENT, ALL = "client", "all"


@dataclass(frozen=True)
class Case:
    """A deployment."""

    label: str
    robots: int
    options: tuple[str, ...] = ()


CASES = (
    Case("10 robots, defaults", 10),
    Case("10 robots, pooled", 10, ("--agents", "pooled")),
    Case("100 robots, fleet", MANY, FLEET),
    Case("100 robots, defaults", MANY),
)
CASES_WHEN_SHORT = (Case("2 robots, defaults", 2),)


@dataclass
class Usage:
    """What a deployment took."""

    factors: list[float] = field(default_factory=list)
    cores: dict[str, list[float]] = field(default_factory=dict)
    """Cores that each program took in each second."""
    memory_mb: dict[str, float] = field(default_factory=dict)
    seconds: list[Second] = field(default_factory=list)
    """What the visitor got."""
    span_ns: tuple[int, int] = (0, 0)
    """Simulation time of the first and last sample."""


@dataclass(frozen=True)
class Shares:
    """Who took what in a case."""

    label: str
    usage: Usage


@dataclass(frozen=True)
class _Sample:
    wall_s: float
    time_s: float
    used_s: Mapping[str, float]


def rows(*, is_short: bool) -> Iterator[Figure | Shares]:
    """Measure each case."""
    for case in CASES_WHEN_SHORT if is_short else CASES:
        with state_folder(), tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "run.mcap"
            usage = _run(case, recording, is_short=is_short)
            scans = tuple(_count_scans(recording, case.robots, usage.span_ns))
        yield from _make_figures(case, usage, scans)
        yield Shares(case.label, usage)


def table(found: Iterable[Figure | Shares]) -> str:
    """Format the figures, and a table of who takes what."""
    listed = list(found)
    figures = format_figures(one for one in listed if isinstance(one, Figure))
    shares = [one for one in listed if isinstance(one, Shares)]
    groups = list(dict.fromkeys(group for one in shares for group in one.usage.cores))
    head = f"| cores / MB | {' | '.join((*groups, ALL))} |\n|{'---|' * (len(groups) + 2)}\n"
    return f"{figures}\n{head}" + "".join(_format_shares(one, groups) for one in shares)


def _format_shares(shares: Shares, groups: Iterable[str]) -> str:
    cores = {group: _mean(found) for group, found in shares.usage.cores.items()}
    memory = shares.usage.memory_mb
    cells = [
        f"{cores[group]:.2f} / {written(memory[group])}" if group in cores else ""
        for group in groups
    ]
    whole = f"{sum(cores.values()):.2f} / {written(sum(memory.values()))}"
    return f"| {' | '.join((shares.label, *cells, whole))} |\n"


def _mean(numbers: list[float]) -> float:
    return sum(numbers) / len(numbers)


def _run(case: Case, recording: Path, *, is_short: bool) -> Usage:
    endpoint = with_free_port("tls/127.0.0.1:0")
    words = (
        *("up", "--secure", "--record", str(recording), "--robots", str(case.robots)),
        *("--model", MODEL, "--world", "warehouse", "--layout", "grid"),
        *("--spacing", str(SPACING_M), "--listen", endpoint, "--port", "0", "--no-open"),
        *("--json", *case.options),
    )
    with deployed_by(words, endpoint) as found:
        usage = _observe(found, is_short=is_short)
        found.process.send_signal(signal.SIGINT)
        found.process.wait(END_S)
    return usage


def _observe(found: Deployment, *, is_short: bool) -> Usage:
    """Measure each second while a visitor has the page open."""
    pids = {group: listed for group, listed in find_programs(found.process).items() if listed}
    usage = Usage()
    samples: list[_Sample] = []
    with program("page_visitor", str(found.ready["viewer"]), "1") as visitor:
        assert visitor.stdout is not None
        pids[CLIENT] = (visitor.pid,)
        skipped = WARM_UP_WHEN_SHORT if is_short else WARM_UP
        for number in range(skipped + 1 + (SECONDS_WHEN_SHORT if is_short else SECONDS)):
            second = msgspec.json.decode(visitor.stdout.readline(), type=Second)
            if number >= skipped:
                samples.append(_take_sample(found, pids))
                usage.seconds.append(second)
        usage.memory_mb = {group: _sum_memory(listed) for group, listed in pids.items()}
    for before, after in pairwise(samples):
        _add(usage, before, after)
    usage.span_ns = (
        round(samples[0].time_s * NANOSECONDS),
        round(samples[-1].time_s * NANOSECONDS),
    )
    return usage


def _take_sample(found: Deployment, pids: Mapping[str, tuple[int, ...]]) -> _Sample:
    used = {group: sum(map(used_s, listed)) for group, listed in pids.items()}
    return _Sample(time.monotonic(), found.client.info().sim_time_s, used)


def _add(usage: Usage, before: _Sample, after: _Sample) -> None:
    lasted_s = after.wall_s - before.wall_s
    usage.factors.append((after.time_s - before.time_s) / lasted_s)
    for group, spent_s in after.used_s.items():
        cores = (spent_s - before.used_s[group]) / lasted_s
        usage.cores.setdefault(group, []).append(cores)


def _sum_memory(pids: Iterable[int]) -> float:
    return sum(psutil.Process(pid).memory_full_info().uss for pid in pids) * MEGABYTES


def _count_scans(recording: Path, robots: int, span_ns: tuple[int, int]) -> Iterator[float]:
    """Count the recorded scans of each robot in a second of simulation time."""
    reader, (start_ns, end_ns) = RecordingReader(recording), span_ns
    counts = dict.fromkeys((f"/{MODEL}{number}/scan" for number in range(robots)), 0)
    messages = reader.messages(lambda topic: topic.name in counts, start_ns=start_ns, end_ns=end_ns)
    for topic, *_ in messages:
        counts[topic.name] += 1
    for count in counts.values():
        yield count * NANOSECONDS / (end_ns - start_ns)


def _make_figures(case: Case, usage: Usage, scans: tuple[float, ...]) -> Iterator[Figure]:
    totals = tuple(map(sum, zip(*usage.cores.values(), strict=True)))
    updates = tuple(second.updates for second in usage.seconds)
    for what, unit, samples in (
        ("real-time factor", "", tuple(usage.factors)),
        ("all programs", "cores", totals),
        ("recorded scans of each robot", "Hz", scans),
        ("updates of the page", "1/s", updates),
    ):
        yield Figure(what=f"{case.label}: {what}", unit=unit, samples=samples)
