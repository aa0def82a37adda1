"""Fleets: MuJoCo by one thread and by two

Engines alone, without a network: 1000 box_bots with full dynamics at 100 Hz drive circles, are
commanded and read 20 times per second of simulation time, and are stepped in cells by one thread or
by two. Plain MuJoCo is the floor: the same robots in four worlds of 250 that share one model, only
MuJoCo's calls and the motors, neither commanded nor read, by one thread and by two. All four take
turns. The rate of two threads is divided by that of one in the same turn; a machine whose second
core is busy shows less, also of plain MuJoCo. Wall time, except where CPU is named.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np

from benchmarks.circling_driver import WHEEL_SPEEDS
from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import SPACING_M
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.cells.cell_executor import StepThreads
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import create_world_engine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine, MujocoReplicas

__all__ = ["rows", "table"]

STEP_HZ, CONTROL_STEPS = 100, 5
ROBOTS, ROBOTS_WHEN_SHORT = 1000, 8
PLAIN_WORLDS = 4
TURNS, TURN_STEPS = 15, 50
TURNS_WHEN_SHORT, TURN_STEPS_WHEN_SHORT = 2, 5
SETTLED = 100
"""Unmeasured steps at the start: robots settle, and overfull cells hand over robots."""
STANDS_AT_M = 0.06
THREADS = (1, 2)
CONFIG = EngineConfig(round(1e9 / STEP_HZ))
Advance = Callable[[int], object]


class Took(NamedTuple):
    """Time of a robot and step."""

    wall_us: float
    cpu_us: float


class PlainWorld:
    """Robots in MuJoCo alone."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robots: int) -> None:
        self._model, self._data = model, data
        self._wheels = np.tile(WHEEL_SPEEDS, robots) * STEP_HZ

    def step(self) -> bool:
        """Advance by one step."""
        model, data = self._model, self._data
        mujoco.mj_step1(model, data)
        data.efc_aref[data.ne : data.ne + data.nf] += self._wheels
        mujoco.mj_step2(model, data)
        return True


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure robots in cells and in plain MuJoCo, by one thread and by two, in turns."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    turns, steps = (TURNS_WHEN_SHORT, TURN_STEPS_WHEN_SHORT) if is_short else (TURNS, TURN_STEPS)
    fleets = {
        (label, threads): make(robots, threads)
        for label, make in (("in cells", _drive_cells), ("plain MuJoCo", _drive_plain))
        for threads in THREADS
    }
    for advance in fleets.values():
        advance(steps if is_short else SETTLED)
    took = [
        {name: _time(advance, steps, robots) for name, advance in fleets.items()}
        for _ in range(turns)
    ]
    for label in ("in cells", "plain MuJoCo"):
        yield from _figures(f"{robots} robots, {label}", label, took)
    for threads in THREADS:
        yield Figure(
            what=f"{robots} robots, threads: {threads}: CPU in cells / plain MuJoCo",
            unit="",
            samples=tuple(
                turn["in cells", threads].cpu_us / turn["plain MuJoCo", threads].cpu_us
                for turn in took
            ),
        )


def _figures(
    name: str, label: str, took: Sequence[Mapping[tuple[str, int], Took]]
) -> Iterator[Figure]:
    for threads in THREADS:
        yield Figure(
            what=f"{name}, threads: {threads}: a robot and step",
            unit="us",
            samples=tuple(turn[label, threads].wall_us for turn in took),
        )
    yield Figure(
        what=f"{name}: rate of two threads / of one",
        unit="",
        samples=tuple(turn[label, 1].wall_us / turn[label, 2].wall_us for turn in took),
        limit=Limit("median", ">=", 1.7) if label == "in cells" else None,
    )


def _time(advance: Advance, steps: int, robots: int) -> Took:
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    advance(steps)
    each = 1e6 / steps / robots
    wall_s, cpu_s = time.perf_counter() - began_s, time.process_time() - began_cpu_s
    return Took(wall_s * each, cpu_s * each)


def _drive_cells(robots: int, threads: int) -> Advance:
    """Make a world in cells, and return what drives it."""
    choice = EngineSettings(engine="mujoco", clusters="on", cores=threads)
    engine = create_world_engine(CONFIG, choice, period_steps=CONTROL_STEPS)
    bodies = _add_robots(engine, robots)
    targets = np.tile(WHEEL_SPEEDS, robots)

    def advance(steps: int) -> None:
        for step in range(steps):
            if step % CONTROL_STEPS == 0:
                engine.read(bodies)
                engine.command(bodies, targets)
            engine.step()

    return advance


def _drive_plain(robots: int, threads: int) -> Advance:
    """Make worlds of plain MuJoCo, and return what drives them."""
    engine, count = MujocoEngine(CONFIG), robots // PLAIN_WORLDS
    replicas = engine.replicate(_add_robots(engine, count), PLAIN_WORLDS)
    assert isinstance(replicas, MujocoReplicas)
    worlds = [PlainWorld(one.model, one.data, count) for one in replicas.engines]
    return partial(StepThreads(threads).step, worlds)


def _add_robots(engine: Engine, count: int) -> tuple[int, ...]:
    model, side = read_urdf(read_builtin_model("box_bot")), int(np.ceil(np.sqrt(count)))
    return tuple(engine.add(model, _place(*divmod(number, side))) for number in range(count))


def _place(row: int, column: int) -> FloatArray:
    base = np.zeros(13)
    base[:3], base[6] = (column * SPACING_M, row * SPACING_M, STANDS_AT_M), 1.0
    return base
