"""Robots at rest

The engine of a server alone (cells where they pay, no workers), without a network: box_bots on a
grid are commanded and read at each step. First they drive circles, then they are commanded to stand
and are measured once they sleep, and while half of them drive. The floor is PyBullet in one world
whose robots stand and never sleep. CPU time of this process.
"""

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.bodies import standing_at
from benchmarks.circling_driver import WHEEL_SPEEDS
from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import SPACING_M
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import create_world_engine
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

__all__ = ["rows", "table"]

STEP_HZ = 100
SIZES, SIZES_WHEN_SHORT = (100, 1000), (2,)
TURNS, TURNS_WHEN_SHORT = 7, 2
ROBOT_STEPS = 6000
"""Length of a turn: robots times steps."""
DOZE_STEPS = 200
"""Steps after which robots at rest sleep."""
CONFIG = EngineConfig(round(1e9 / STEP_HZ))
SHARE = Limit("median", "<=", 0.1)


class Fleet:
    """An engine and its robots."""

    def __init__(self, engine: Engine, robots: int) -> None:
        self.engine = engine
        self._model = read_urdf(read_builtin_model("box_bot"))
        places = make_fleet_layout("box_bot", robots, "grid", SPACING_M)
        self.bodies = tuple(self._add(place.x, place.y) for place in places)

    def turns(self, speeds: FloatArray, settle_steps: int, *, is_short: bool) -> tuple[float, ...]:
        """Advance with these wheel speeds; return CPU time [us per robot and step]."""
        self._go(speeds, settle_steps)
        turns = TURNS_WHEN_SHORT if is_short else TURNS
        steps = 5 if is_short else max(10, ROBOT_STEPS // len(self.bodies))
        return tuple(self._go(speeds, steps) for _ in range(turns))

    def _go(self, speeds: FloatArray, steps: int) -> float:
        cpu_s = time.process_time()
        for _ in range(steps):
            self.engine.command(self.bodies, speeds)
            self.engine.step()
            self.engine.read(self.bodies)
        return (time.process_time() - cpu_s) * 1e6 / max(1, steps) / len(self.bodies)

    def _add(self, x: float, y: float) -> int:
        base = standing_at(x)
        base[1] = y
        return self.engine.add(self._model, base)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure fleets that drive, fleets at rest, and fleets with one half driving."""
    for robots in SIZES_WHEN_SHORT if is_short else SIZES:
        yield from _of(robots, is_short=is_short)


def _of(robots: int, *, is_short: bool) -> Iterator[Figure]:
    drive, stand = np.tile(WHEEL_SPEEDS, robots), np.zeros(2 * robots)
    half = np.where(np.arange(2 * robots) < robots, drive, stand)
    choice = EngineSettings(engine="pybullet", engine_workers=0)
    fleet = Fleet(create_world_engine(CONFIG, choice, period_steps=2), robots)
    try:
        driving = fleet.turns(drive, 20, is_short=is_short)
        standing = fleet.turns(stand, DOZE_STEPS, is_short=is_short)
        partly = fleet.turns(half, 20, is_short=is_short)
    finally:
        fleet.engine.close()
    awake = Fleet(PyBulletEngine(CONFIG), robots)
    try:
        floor = awake.turns(stand, 20, is_short=is_short)
    finally:
        awake.engine.close()
    for what, samples in (
        ("driving", driving),
        ("standing", standing),
        ("half of them driving", partly),
        ("floor: standing in one world, never asleep", floor),
    ):
        yield Figure(what=f"{robots} robots {what}: a robot and step", unit="us", samples=samples)
    yield Figure(
        what=f"{robots} robots: standing / driving",
        unit="",
        samples=tuple(one / other for one, other in zip(standing, driving, strict=True)),
        limit=None if is_short else SHARE,
    )
