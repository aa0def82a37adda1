"""Box_bots in the physics engine alone: no server, no network, no agents."""

import numpy as np

from benchmarks.ten_robots import SPACING_M
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.server_config import ServerConfig, make_server_bus_config

CONFIG = ServerConfig(bus=make_server_bus_config("", ""))
"""Default settings of a server."""
HEIGHT_M = 0.06
"""Height of the root when the wheels touch the ground."""
WHEELS = 2
WHEEL_SPEED = 5.0


class Bodies:
    """A row of box_bots in a PyBullet engine of this process."""

    def __init__(self, count: int) -> None:
        model = read_urdf(read_builtin_model("box_bot"))
        self.engine = PyBulletEngine(EngineConfig(CONFIG.step_ns))
        self._bodies = [self.engine.add(model, standing_at(i * SPACING_M)) for i in range(count)]
        self._targets = np.full(count * WHEELS, WHEEL_SPEED)
        self.drive()

    def drive(self) -> None:
        """Set the wheel speeds of all robots."""
        self.engine.command(self._bodies, self._targets)

    def step(self, steps: int) -> None:
        """Step without commands."""
        for _ in range(steps):
            self.engine.step()


def standing_at(x: float) -> FloatArray:
    """Make the state row of a box_bot at rest on the ground."""
    base = np.zeros(13)
    base[:3] = x, 0.0, HEIGHT_M
    base[6] = 1.0
    return base
