"""Which engines stand for a world: one, or many in cells, by threads or by workers."""

import os

from zensim.sim_server.physics.choice import EngineChoice, EngineName, engine_of, engines_here
from zensim.sim_server.physics.clusters.cells import Cells, CellsHere
from zensim.sim_server.physics.clusters.clusters import Clusters, Settings
from zensim.sim_server.physics.clusters.workers import CellsOfWorkers
from zensim.sim_server.physics.engine import Engine, EngineConfig
from zensim.sim_server.physics.making import CellOrders, made

ALONE = 250
"""Bodies that one cell has before there are several: fewer gain nothing (docs/fleet.md)."""
ALONE_AT_ONCE = 150
"""The same where cells are stepped at once."""
MOST: dict[EngineName, int] = {"pybullet": 128, "mujoco": 128}
"""Bodies of a cell: smaller ones of PyBullet cost a robot as much, and 30 MB each; smaller ones of
MuJoCo cost more."""
LARGEST: dict[EngineName, int] = {"pybullet": 250, "mujoco": 256}
"""Bodies of a cell of a world of a thousand: each robot of PyBullet costs 5-10 % more, but half the
memory; of MuJoCo it costs a fifth less, as Python does less beside it."""
MOST_AT_ONCE = 8
"""Threads, or processes, unless more are asked for."""


def chosen_engine(config: EngineConfig, choice: EngineChoice, *, period_steps: int) -> Engine:
    """Make the engine of a world.

    Args:
        config: What the world asks for.
        choice: What the server was told.
        period_steps: Between two control steps.

    Raises:
        EngineMissing: Its library is not installed.
    """
    name = engine_of(choice, engines_here())
    if choice.clusters == "off":
        return made(name, config)
    lets_others_run = name != "pybullet"
    threads = _cores() if lets_others_run and not choice.workers else 1
    workers = choice.workers
    if workers is None:
        workers = 0 if lets_others_run else _cores() - 1
    alone = ALONE_AT_ONCE if workers or threads > 1 else ALONE
    settings = Settings(
        alone=alone if choice.clusters == "auto" else MOST[name],
        most=MOST[name],
        period_steps=period_steps,
        largest=LARGEST[name],
    )
    return Clusters(config, _cells(CellOrders(name, config), threads, workers), settings)


def _cells(orders: CellOrders, threads: int, workers: int) -> Cells:
    if workers:
        return CellsOfWorkers(orders.make, orders, workers=workers)
    return CellsHere(orders.make, threads=threads)


def _cores() -> int:
    """How many of this host's cores may be used."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(cores or 1, MOST_AT_ONCE)
