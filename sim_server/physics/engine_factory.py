"""Create the engine of a world or of one cell from configuration; only the chosen library is imported."""

import os
from importlib import import_module

import msgspec

from zensim.sim_server.physics.cells.cell_executor import (
    CellExecutor,
    InProcessCellExecutor,
    WorkerCellExecutor,
)
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import (
    EngineConfig,
    EngineName,
    EngineOptions,
    choose_engine,
    find_installed_engines,
)
from zensim.sim_server.physics.sleeping_engine import wrap_with_sleep

ENGINE_CLASSES: dict[EngineName, tuple[str, str]] = {
    "pybullet": ("zensim.sim_server.physics.bullet.pybullet_engine", "PyBulletEngine"),
    "mujoco": ("zensim.sim_server.physics.mujoco.mujoco_engine", "MujocoEngine"),
}
AWAKE_POOL_BODIES = 2
"""Parked bodies of a PyBullet cell that stay awake for those who come moving."""


class CellConfig(msgspec.Struct, frozen=True):
    """What a cell is to be."""

    engine: EngineName
    config: EngineConfig

    def make(self) -> Engine:
        """Make one."""
        if self.engine == "pybullet":
            return create_engine(self.engine, self.config, awake=AWAKE_POOL_BODIES)
        return create_engine(self.engine, self.config)


def create_engine(name: EngineName, config: EngineConfig, **how: int) -> Engine:
    """Make an engine by its name."""
    module, maker = ENGINE_CLASSES[name]
    engine: Engine = getattr(import_module(module), maker)(config, **how)
    return wrap_with_sleep(engine, config)


MAX_SINGLE_CELL_BODIES = 250
"""Bodies that one cell has before there are several: fewer gain nothing (docs/fleet.md)."""
MAX_SINGLE_CELL_BODIES_PARALLEL = 150
"""The same where cells are stepped at once."""
MAX_CELL_BODIES: dict[EngineName, int] = {"pybullet": 128, "mujoco": 128}
"""Bodies of a cell: smaller ones of PyBullet cost a robot as much, and 30 MB each; smaller ones of
MuJoCo cost more."""
MAX_CELL_BODIES_LARGE_WORLD: dict[EngineName, int] = {"pybullet": 250, "mujoco": 256}
"""Bodies of a cell of a world of a thousand: each robot of PyBullet costs 5-10 % more, but half the
memory; of MuJoCo it costs a fifth less, as Python does less beside it."""
MAX_PARALLEL_CELLS = 8
"""Threads, or processes, unless more are asked for."""


def create_world_engine(
    config: EngineConfig, choice: EngineOptions, *, period_steps: int
) -> Engine:
    """Make the engine of a world.

    Args:
        config: What the world asks for.
        choice: What the server was told.
        period_steps: Between two control steps.

    Raises:
        EngineMissing: Its library is not installed.
    """
    name = choose_engine(choice, find_installed_engines())
    if choice.clusters == "off":
        return create_engine(name, config)
    lets_others_run = name != "pybullet"
    threads = _count_usable_cores() if lets_others_run and not choice.workers else 1
    workers = choice.workers
    if workers is None:
        workers = 0 if lets_others_run else _count_usable_cores() - 1
    alone = MAX_SINGLE_CELL_BODIES_PARALLEL if workers or threads > 1 else MAX_SINGLE_CELL_BODIES
    settings = CellSettings(
        alone=alone if choice.clusters == "auto" else MAX_CELL_BODIES[name],
        most=MAX_CELL_BODIES[name],
        period_steps=period_steps,
        largest=MAX_CELL_BODIES_LARGE_WORLD[name],
    )
    return CelledEngine(
        config, _make_cell_stepper(CellConfig(name, config), threads, workers), settings
    )


def _make_cell_stepper(orders: CellConfig, threads: int, workers: int) -> CellExecutor:
    if workers:
        return WorkerCellExecutor(orders.make, orders, workers=workers)
    return InProcessCellExecutor(orders.make, threads=threads)


def _count_usable_cores() -> int:
    """How many of this host's cores may be used."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(cores or 1, MAX_PARALLEL_CELLS)
