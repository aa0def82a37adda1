"""Which engines stand for a world: one, or many in cells."""

from functools import partial

from sim_server.physics.choice import EngineChoice
from sim_server.physics.clusters.cells import CellsHere
from sim_server.physics.clusters.clusters import Clusters, Settings
from sim_server.physics.engine import Engine, EngineConfig
from sim_server.physics.pybullet_engine import PyBulletEngine

ALONE = 150
"""Bodies that one cell has before there are several: fewer gain nothing (docs/fleet.md)."""
MOST = 64
READY = 2
"""Parked bodies of a cell that stay awake for those who come moving."""


def chosen_engine(config: EngineConfig, choice: EngineChoice, *, period_steps: int) -> Engine:
    """Make the engine of a world.

    Args:
        config: What the world asks for.
        choice: What the server was told.
        period_steps: Between two control steps.
    """
    if choice.clusters == "off":
        return PyBulletEngine(config)
    cells = CellsHere(partial(PyBulletEngine, config, awake=READY))
    alone = ALONE if choice.clusters == "auto" else MOST
    return Clusters(config, cells, Settings(alone=alone, most=MOST, period_steps=period_steps))
