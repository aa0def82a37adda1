"""Python API

A server of `zensim.launch()` with one pool. Times of properties and of commands are CPU time of the
calling thread, a mean of many calls each; commands are sent to a world that runs. `steps` with a
command for each of ten robots is compared with one `run_for` of the same length before it.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from tempfile import TemporaryDirectory

import numpy as np

import zensim
from benchmarks.figures import Figure, Limit, table
from zensim.proto.bus import BusConfig, open_bus
from zensim.proto.topic_catalog import TWISTS

__all__ = ["rows", "table"]

REPEATS = 5
ROBOTS = 10
FLEET = 1000
DRIVES = 50
"""Commands of a repetition."""
BARE, IMPORT = "pass", "import zensim"


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure import, start, properties, commands and the loop of a controller."""
    starts = 1 if is_short else 20
    yield _import_cost(starts)
    yield _plugin_cost(starts)
    repeats = 1 if is_short else REPEATS
    yield _figure("launch to a driven robot", "s", 3.0, [_launch() for _ in range(repeats)])
    with zensim.launch() as sim:
        samples = [_connect(sim.endpoint) for _ in range(1 if is_short else 3 * repeats)]
        yield _figure("connect and close", "s", 0.3, samples)
        yield from _steps(sim, repeats, 20 if is_short else 400)
        sim.reset()
        yield from _fleet(sim, 10 if is_short else FLEET)


def _figure(what: str, unit: str, most: float, samples: list[float]) -> Figure:
    limit = Limit("median", "<=", most, is_timed=True)
    return Figure(what=what, unit=unit, samples=tuple(samples), limit=limit)


def _import_cost(runs: int) -> Figure:
    spent = {code: [_run_python(code) for _ in range(runs)] for code in (BARE, IMPORT)}
    bare = min(spent[BARE])
    return _figure("import zensim", "ms", 20.0, [1e3 * (one - bare) for one in spent[IMPORT]])


def _plugin_cost(runs: int) -> Figure:
    with TemporaryDirectory() as folder:
        command = "import pytest; pytest.main(['-q', '-p', 'no:cacheprovider', {}])"
        without = command.format(f"'-p', 'no:zensim.testing', {folder!r}")
        spent = {
            code: [_run_python(code) for _ in range(runs)]
            for code in (without, command.format(repr(folder)))
        }
    bare = min(spent.pop(without))
    samples = [1e3 * (one - bare) for found in spent.values() for one in found]
    return _figure("start of pytest with the plug-in", "ms", 20.0, samples)


def _run_python(code: str) -> float:
    """Find the CPU time of an interpreter that runs a line."""
    report = f"{code}\nimport time; print(time.process_time())"
    done = subprocess.run(
        [sys.executable, "-c", report],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return float(done.stdout.split()[-1])


def _launch() -> float:
    began_s = time.perf_counter()
    with zensim.launch() as sim:
        sim.spawn("box_bot", name="r1")
        return time.perf_counter() - began_s


def _connect(endpoint: str) -> float:
    began_s = time.perf_counter()
    with zensim.connect(endpoint):
        pass
    return time.perf_counter() - began_s


def _steps(sim: zensim.Sim, repeats: int, count: int) -> Iterator[Figure]:
    fleet = sim.spawn_fleet("box_bot", count=ROBOTS)
    turns = np.linspace(0.1, 0.5, ROBOTS)
    seconds = count * sim.control_period
    shares, used = [], []
    for _ in range(repeats):
        began_s = time.perf_counter()
        sim.run_for(seconds)
        alone_s = time.perf_counter() - began_s
        began_s, began_used_s = time.perf_counter(), time.process_time()
        for _ in sim.steps(seconds=seconds):
            fleet.drive(0.2, turns)
        shares.append(100.0 * alone_s / (time.perf_counter() - began_s))
        used.append(1e3 * (time.process_time() - began_used_s) / count)
    limit = Limit("median", ">=", 75.0, is_timed=True)
    what = f"steps with {ROBOTS} commands, speed against one run_for"
    yield Figure(what=what, unit="%", samples=tuple(shares), limit=limit)
    yield _figure("CPU of the caller per control step, all threads", "ms", 0.3, used)


def _fleet(sim: zensim.Sim, count: int) -> Iterator[Figure]:
    fleet = sim.spawn_fleet("box_bot", count=count, timeout_s=60.0)
    robot, turns = fleet[0], np.linspace(0.1, 0.5, count)
    yield _figure("robot.pose", "us", 5.0, _time(lambda: robot.pose, 1000))
    yield _figure("robot.twist", "us", 5.0, _time(lambda: robot.twist, 1000))
    yield _figure(f"fleet.poses() of {count}", "us", 50.0, _time(fleet.poses, 200))
    with open_bus(BusConfig(connect=(sim.endpoint,))) as bus:
        messages = bus.subscribe(TWISTS.key("default"), 2 * REPEATS * DRIVES)
        sim.play()
        spent = _time(lambda: fleet.drive(0.2, turns), DRIVES)
        sim.pause()
        # A reply follows all messages that were published before its request.
        bus.list_tokens("sim/**")
        received = len(messages.take())
    yield _figure(f"fleet.drive of {count}", "us", 500.0, spent)
    yield Figure(
        what=f"messages of a fleet.drive of {count}",
        unit="",
        samples=(received / (REPEATS * DRIVES),),
        limit=Limit("max", "<=", 1.0),
    )


def _time(call: Callable[[], object], count: int) -> list[float]:
    """Find the CPU time of a call [us], a mean for each repetition."""
    samples = []
    for _ in range(REPEATS):
        began_s = time.thread_time()
        for _ in range(count):
            call()
        samples.append(1e6 * (time.thread_time() - began_s) / count)
    return samples
