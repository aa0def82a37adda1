"""Worlds in process

`zensim.World` with MuJoCo and box_bot, 240 Hz, a control step each 3 steps. CPU time.
"Engine alone" makes the same steps in the same run without drives, odometry and services, as the
floor. A further world is made, gets its robots and makes one control step after another was made.
The loop of a controller orders a twist for each of ten robots at each control step. Restoring puts
ten robots back that have driven since, into the world that the snapshot is of.
"""

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import zensim
from benchmarks.figures import Figure, table
from zensim.api.in_process_world import InProcessAccess
from zensim.api.simulation import Simulation
from zensim.api.world_host import WorldHost
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.start_settings import StartSettings
from zensim.sim_server.server_config import ServerConfig

__all__ = ["rows", "table"]

COLD = """
import time, sys, zensim
zensim.World().spawn("box_bot")
print(time.process_time(), len({"zenoh", "scipy", "trimesh"} & sys.modules.keys()))
"""
SIZES = (1, 10, 100)
"""Numbers of robots."""
PAGE_KIB = 4.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the cold start, further worlds and control steps."""
    cold = [_run_cold() for _ in range(1 if is_short else 5)]
    yield _figure("import zensim; World().spawn, cold", "s", [spent for spent, _ in cold])
    yield Figure(
        what="of zenoh, scipy and trimesh, loaded by it",
        unit="",
        samples=tuple(count for _, count in cold),
    )
    yield from _further_worlds(2 if is_short else 40)
    yield _figure("a world of 10 robots for 1 simulated s", "s", _time_tests())
    yield from _snapshots(3 if is_short else 100)
    yield _loop_overhead(5 if is_short else 200)
    for robots in SIZES[: 2 if is_short else None]:
        yield from _control_steps(robots, 2 if is_short else 200)


def _figure(what: str, unit: str, samples: list[float]) -> Figure:
    return Figure(what=what, unit=unit, samples=tuple(samples))


def _run_cold() -> tuple[float, float]:
    done = subprocess.run(
        [sys.executable, "-c", COLD], capture_output=True, text=True, check=True, timeout=300
    )
    spent, loaded = done.stdout.split()
    return float(spent), float(loaded)


def _further_worlds(count: int) -> Iterator[Figure]:
    first = _make_world(10)
    gc.collect()
    worlds, spent, before = [], [], _read_resident_kib()
    for _ in range(count):
        began = time.process_time()
        worlds.append(_make_world(10))
        worlds[-1].step(3)
        spent.append(1e3 * (time.process_time() - began))
    used = (_read_resident_kib() - before) / count / 1024.0
    yield _figure("a further world of 10 robots", "ms", spent)
    yield _figure("memory of a further world of 10 robots", "MiB", [used])
    for world in (first, *worlds):
        world.close()


def _time_tests() -> list[float]:
    """Find the CPU time of what a test does that uses `zensim_world` [s]."""

    def run() -> None:
        with _make_world(10) as world:
            world.run_for(1.0)

    return [1e-3 * spent for spent in _time(run, 1)]


def _snapshots(count: int) -> Iterator[Figure]:
    with _make_world(10) as world:
        world.fleet(list(world.robots)).drive(0.3, 0.4)
        world.run_for(1.0)
        saved = world.snapshot()
        taken, restored = [], []
        for _ in range(count):
            world.step(3)
            began = time.process_time()
            world.snapshot()
            between = time.process_time()
            world.restore(saved)
            restored.append(1e3 * (time.process_time() - between))
            taken.append(1e3 * (between - began))
    yield Figure(what="snapshot of 10 robots", unit="ms", samples=tuple(taken))
    yield _figure("restore of 10 robots", "ms", restored)


def _loop_overhead(count: int) -> Figure:
    """Compare the loop of a controller with steps of the same length."""
    samples = []
    with _make_world(10) as world:
        fleet, turns = world.fleet(list(world.robots)), np.linspace(0.1, 0.5, 10)
        fleet.drive(0.3, turns)
        world.run_for(1.0)
        for _ in range(5):
            began = time.process_time()
            world.step(3 * count)
            between = time.process_time()
            for _ in world.steps(seconds=count * world.control_period):
                fleet.drive(0.3, turns)
            looped = time.process_time() - between
            samples.append(100.0 * (looped / (between - began) - 1.0))
    return _figure("steps() with 10 commands, beyond step(n)", "%", samples)


def _make_world(robots: int) -> zensim.World:
    world = zensim.World()
    world.spawn_fleet("box_bot", count=robots)
    return world


def _read_resident_kib() -> float:
    return PAGE_KIB * int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])


def _control_steps(robots: int, count: int) -> Iterator[Figure]:
    with zensim.World() as world:
        fleet = world.spawn_fleet("box_bot", count=robots)
        fleet.drive(0.3, 0.4)
        world.run_for(1.0)
        whole = _time(lambda: world.step(3 * count), count)
    yield _figure(f"control step, {robots} robots", "ms", whole)
    alone = _time_engine(robots, count)
    yield Figure(what=f"engine alone, {robots} robots", unit="ms", samples=tuple(alone))


def _time_engine(robots: int, count: int) -> list[float]:
    """Find the CPU time of the engine's part of a control step [ms]."""
    config = ServerConfig(
        settings=ServerSettings(
            start=StartSettings(paused=True),
            physics=EngineSettings(engine="mujoco", engine_workers=0),
        )
    )
    server = WorldHost(config)
    simulation = Simulation(InProcessAccess(server))
    simulation.spawn_fleet("box_bot", count=robots).drive(0.3, 0.4)
    simulation.run_for(1.0)
    engine = server.world.engine
    spent = _time(lambda: [engine.step() for _ in range(3 * count)], count)
    simulation.close()
    return spent


def _time(call: Callable[[], object], count: int) -> list[float]:
    """Find the CPU time of a part of a call [ms], five times."""
    samples = []
    for _ in range(5):
        began = time.process_time()
        call()
        samples.append(1e3 * (time.process_time() - began) / count)
    return samples
