"""Creates the engine of a world or of one cell; imports only the chosen library."""

from importlib import import_module

import msgspec

from zensim.proto.engine_proofs import EngineName
from zensim.proto.process_limits import count_usable_cores
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.physics.cells.cell_executor import (
    CellExecutor,
    InProcessCellExecutor,
    WorkerCellExecutor,
)
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_proof.engine_prover import choose_proven_engine
from zensim.sim_server.physics.isolating_engine import IsolatingEngine
from zensim.sim_server.physics.sleeping_engine import wrap_with_sleep

ENGINE_CLASSES: dict[EngineName, tuple[str, str]] = {
    "pybullet": ("zensim.sim_server.physics.bullet.pybullet_engine", "PyBulletEngine"),
    "mujoco": ("zensim.sim_server.physics.mujoco.mujoco_engine", "MujocoEngine"),
}
AWAKE_POOL_BODIES = 2
"""Pooled bodies of a PyBullet cell that stay awake, for bodies that arrive with a velocity."""


class CellConfig(msgspec.Struct, frozen=True):
    """Engine and configuration of a cell."""

    engine: EngineName
    config: EngineConfig

    def make(self) -> Engine:
        """Create the engine."""
        if self.engine == "pybullet":
            return create_engine(self.engine, self.config, awake=AWAKE_POOL_BODIES)
        return create_engine(self.engine, self.config)


def create_engine(name: EngineName, config: EngineConfig, **options: int) -> Engine:
    """Create an engine that isolates failing bodies, with sleep if it can."""
    module, class_name = ENGINE_CLASSES[name]
    engine: Engine = getattr(import_module(module), class_name)(config, **options)
    return wrap_with_sleep(IsolatingEngine(engine), config)


MAX_SINGLE_CELL_BODIES = 250
"""Bodies up to which there is one cell: cells gain nothing then (docs/cells.md)."""
MAX_SINGLE_CELL_BODIES_PARALLEL = 150
"""Bodies up to which there is one cell, if cells are stepped in parallel."""
MAX_CELL_BODIES: dict[EngineName, int] = {"pybullet": 128, "mujoco": 128}
"""Bodies of a cell: smaller cells of PyBullet are no faster and take 20 MB each; larger ones take
more CPU a body (ADR 109). Smaller cells of MuJoCo are slower."""
MAX_CELL_BODIES_LARGE_WORLD: dict[EngineName, int] = {"pybullet": 128, "mujoco": 256}
"""The same in worlds of about 1000 bodies: MuJoCo takes a fifth less time with more."""
NEW_CELL_BYTES: dict[EngineName, int] = {"pybullet": 30 << 20, "mujoco": 0}
"""Memory that an engine writes to when it is made: four fifths of that time are page faults."""
MAX_PARALLEL_CELLS = 8
"""Default limit of threads or processes."""


def create_world_engine(
    config: EngineConfig, choice: EngineSettings, *, period_steps: int
) -> Engine:
    """Create the engine of a world.

    Args:
        config: Of the world.
        choice: Of the server.
        period_steps: Steps between two control steps.

    Raises:
        EngineUnusable: The library is not installed, or fails a case of its proof.
    """
    name = choose_proven_engine(choice)
    if choice.clusters == "off":
        return create_engine(name, config)
    releases_lock = name != "pybullet"  # of the interpreter, while it steps
    cores = limit_cores(choice)
    threads = cores if releases_lock and not choice.engine_workers else 1
    workers = choice.engine_workers
    if workers is None:
        workers = 0 if releases_lock else cores - 1
    single_cell = (
        MAX_SINGLE_CELL_BODIES_PARALLEL if workers or threads > 1 else MAX_SINGLE_CELL_BODIES
    )
    settings = CellSettings(
        single_cell_bodies=single_cell if choice.clusters == "auto" else MAX_CELL_BODIES[name],
        cell_bodies=MAX_CELL_BODIES[name],
        period_steps=period_steps,
        large_cell_bodies=MAX_CELL_BODIES_LARGE_WORLD[name],
    )
    cell = CellConfig(name, config)
    return CelledEngine(config, _make_cell_executor(cell, threads, workers), settings)


def _make_cell_executor(cell: CellConfig, threads: int, workers: int) -> CellExecutor:
    if workers:
        cell_bytes = NEW_CELL_BYTES[cell.engine]
        return WorkerCellExecutor(cell.make, cell, workers=workers, cell_bytes=cell_bytes)
    return InProcessCellExecutor(cell.make, threads=threads)


def limit_cores(choice: EngineSettings) -> int:
    """Count the cores that cells may use, up to the limit."""
    return min(choice.cores or count_usable_cores(), MAX_PARALLEL_CELLS)
