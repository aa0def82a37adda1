"""Worlds in cells

Engines alone, without a network, in turns: box_bots, one per square metre, drive random arcs, a new
one each simulated second, and meet now and then. All are commanded and read at each step. "One
world" is the same engine without cells. CPU time of this process, which has all cells, except in
the last rows: there a worker has half of them, and wall time is compared with the same cells
without a worker. Fleet sizes are compared within a turn. The last row steps eight worlds of 125
robots one after another, once each, and then each ten times in a row: what the cache of the
processor gives to a world that it still holds, and a server cannot have, as each step has to end
before the next one is due.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import numpy as np

from benchmarks.figures import Figure, Limit, table
from zensim.proto.settings.engine_settings import Clustering, EngineSettings
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.cells.cell_executor import StepThreads
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import create_world_engine

__all__ = ["rows", "table"]

STEP_HZ = 100
ARC_STEPS = 100
APART_M = 1.0
WHEEL_RAD_S = 8.0
STANDS_AT_M = 0.06
TURNS, ROBOT_STEPS = 9, 12_000
"""Number of turns, and their length: robots times steps."""
SETTLED = 60
"""Unmeasured steps at the start: overfull cells hand over robots."""
CELLS, CELL_ROBOTS, STEPS_IN_A_ROW = 8, 125, 10
CELLS_WHEN_SHORT, CELL_ROBOTS_WHEN_SHORT = 2, 2
CASES: tuple[tuple[str, int, Clustering], ...] = (
    ("one world", 100, "off"),
    ("one world", 400, "off"),
    ("one world", 1000, "off"),
    ("in cells", 400, "on"),
    ("in cells", 1000, "on"),
)
SHORT_CASES: tuple[tuple[str, int, Clustering], ...] = (
    ("one world", 4, "off"),
    ("in cells", 4, "on"),
)


class Fleet:
    """An engine and its robots."""

    def __init__(self, robots: int, clusters: Clustering, workers: int) -> None:
        choice = EngineSettings(engine="pybullet", clusters=clusters, engine_workers=workers)
        config = EngineConfig(round(1e9 / STEP_HZ))
        self.engine = create_world_engine(config, choice, period_steps=1)
        self.draws = np.random.default_rng(1)
        self.steps = 0
        model, side = read_urdf(read_builtin_model("box_bot")), int(np.ceil(np.sqrt(robots)))
        self.bodies = tuple(
            self.engine.add(model, self._place(*divmod(number, side))) for number in range(robots)
        )
        self.targets = self._targets()

    def go(self, steps: int) -> tuple[float, float]:
        """Drive; return CPU and wall time [us per robot and step]."""
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        for _ in range(steps):
            self.steps += 1
            if self.steps % ARC_STEPS == 0:
                self.targets = self._targets()
            self.engine.command(self.bodies, self.targets)
            self.engine.step()
            self.engine.read(self.bodies)
        each = 1e6 / steps / len(self.bodies)
        return (time.process_time() - cpu_s) * each, (time.perf_counter() - wall_s) * each

    def _place(self, row: int, column: int) -> FloatArray:
        yaw = self.draws.uniform(-np.pi, np.pi) / 2.0
        base = np.zeros(13)
        base[:3] = column * APART_M, row * APART_M, STANDS_AT_M
        base[5], base[6] = np.sin(yaw), np.cos(yaw)
        return base

    def _targets(self) -> FloatArray:
        return self.draws.uniform(-WHEEL_RAD_S, WHEEL_RAD_S, 2 * len(self.bodies))


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the cost per robot in one world and in cells, without and with a worker."""
    cases = SHORT_CASES if is_short else CASES
    spent = _in_turns([(robots, clusters, 0) for _, robots, clusters in cases], is_short=is_short)
    cpu = [[cpu_us for cpu_us, _ in turns] for turns in spent]
    for (how, robots, _), turns in zip(cases, cpu, strict=True):
        yield Figure(what=f"{robots} robots {how}: a robot and step", unit="us", samples=(*turns,))
    few, many = cases[0][1], cases[-1][1]
    yield Figure(
        what=f"a robot among {many} in cells, to one among {few} in one world",
        unit="",
        samples=_ratios(cpu[-1], cpu[0]),
        limit=None if is_short else Limit("median", "<=", 1.3),
    )
    yield from _with_a_worker(many, is_short=is_short)
    yield _compare_orders(is_short=is_short)


def _with_a_worker(robots: int, *, is_short: bool) -> Iterator[Figure]:
    fleets: list[tuple[int, Clustering, int]] = [(robots, "on", 0), (robots, "on", 1)]
    alone, shared = (
        [wall_us for _, wall_us in turns] for turns in _in_turns(fleets, is_short=is_short)
    )
    yield Figure(
        what=f"{robots} robots in cells: wall's time without a worker, to that with one",
        unit="",
        samples=_ratios(alone, shared),
    )
    yield Figure(
        what=f"{robots} robots in cells with a worker: real-time factor at {STEP_HZ} Hz",
        unit="",
        samples=tuple(1e6 / STEP_HZ / robots / each for each in shared),
    )


def _compare_orders(*, is_short: bool) -> Figure:
    cells, robots = CELLS, CELL_ROBOTS
    if is_short:
        cells, robots = CELLS_WHEN_SHORT, CELL_ROBOTS_WHEN_SHORT
    with ExitStack() as ending:
        fleets = [Fleet(robots, "off", 0) for _ in range(cells)]
        for fleet in fleets:
            ending.callback(fleet.engine.close)
            fleet.go(2 if is_short else SETTLED)
        engines, threads = [fleet.engine for fleet in fleets], StepThreads(1)
        took: list[tuple[float, float]] = []
        for _ in range(2 if is_short else TURNS):
            start_s = time.process_time()
            for _ in range(STEPS_IN_A_ROW):
                threads.step(engines, 1)
            middle_s = time.process_time()
            threads.step(engines, STEPS_IN_A_ROW)
            took.append((middle_s - start_s, time.process_time() - middle_s))
    return Figure(
        what=f"{cells} worlds of {robots} robots: a step of each in turn, to ten of each in a row",
        unit="",
        samples=_ratios(*zip(*took, strict=True)),
    )


def _in_turns(
    fleets: Sequence[tuple[int, Clustering, int]], *, is_short: bool
) -> list[list[tuple[float, float]]]:
    with ExitStack() as ending:
        made: list[Fleet] = []
        for robots, clusters, workers in fleets:
            made.append(Fleet(robots, clusters, workers))
            ending.callback(made[-1].engine.close)
        turns, robot_steps = (2, 20) if is_short else (TURNS, ROBOT_STEPS)
        for fleet in made:
            fleet.go(2 if is_short else SETTLED)
        taken = [
            [fleet.go(max(2, robot_steps // len(fleet.bodies))) for fleet in made]
            for _ in range(turns)
        ]
    return [list(of_one) for of_one in zip(*taken, strict=True)]


def _ratios(these: Sequence[float], those: Sequence[float]) -> tuple[float, ...]:
    return tuple(this / that for this, that in zip(these, those, strict=True))
