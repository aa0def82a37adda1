"""Making the engine of one cell, here or in a worker. Only its own library is imported."""

from importlib import import_module

import msgspec

from zensim.sim_server.physics.choice import EngineName
from zensim.sim_server.physics.engine import Engine, EngineConfig
from zensim.sim_server.physics.sleeping import with_sleep

ENGINES: dict[EngineName, tuple[str, str]] = {
    "pybullet": ("zensim.sim_server.physics.pybullet_engine", "PyBulletEngine"),
    "mujoco": ("zensim.sim_server.physics.mujoco_engine", "MujocoEngine"),
}
READY = 2
"""Parked bodies of a PyBullet cell that stay awake for those who come moving."""


class CellOrders(msgspec.Struct, frozen=True):
    """What a cell is to be."""

    engine: EngineName
    config: EngineConfig

    def make(self) -> Engine:
        """Make one."""
        if self.engine == "pybullet":
            return made(self.engine, self.config, awake=READY)
        return made(self.engine, self.config)


def made(name: EngineName, config: EngineConfig, **how: int) -> Engine:
    """Make an engine by its name."""
    module, maker = ENGINES[name]
    engine: Engine = getattr(import_module(module), maker)(config, **how)
    return with_sleep(engine, config)
