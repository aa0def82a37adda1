"""Which engines stand for a world: one, or many in cells. Only their library is imported."""

import os
from collections.abc import Callable
from functools import partial
from importlib import import_module

from sim_server.physics.choice import EngineChoice, EngineName, engine_of, engines_here
from sim_server.physics.clusters.cells import CellsHere
from sim_server.physics.clusters.clusters import Clusters, Settings
from sim_server.physics.engine import Engine, EngineConfig

ENGINES: dict[EngineName, tuple[str, str]] = {
    "pybullet": ("sim_server.physics.pybullet_engine", "PyBulletEngine"),
    "mujoco": ("sim_server.physics.mujoco_engine", "MujocoEngine"),
}
ALONE = 150
"""Bodies that one cell has before there are several: fewer gain nothing (docs/fleet.md)."""
MOST = 64
READY = 2
"""Parked bodies of a PyBullet cell that stay awake for those who come moving."""
MOST_THREADS = 8


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
    make = _maker(name)
    if choice.clusters == "off":
        return make(config)
    if name == "pybullet":
        cells = CellsHere(partial(make, config, awake=READY))
    else:
        cells = CellsHere(partial(make, config), threads=_threads())
    alone = ALONE if choice.clusters == "auto" else MOST
    return Clusters(config, cells, Settings(alone=alone, most=MOST, period_steps=period_steps))


def _maker(name: EngineName) -> Callable[..., Engine]:
    module, made = ENGINES[name]
    maker: Callable[..., Engine] = getattr(import_module(module), made)
    return maker


def _threads() -> int:
    """How many of this host's cores may step cells of an engine that lets other threads run."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(cores or 1, MOST_THREADS)
