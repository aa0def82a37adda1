"""Tiered engines for tests, and common queries on them."""

from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Dynamics, Model
from zensim.proto.se3 import to_yaw
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine

STEP_NS = 10_000_000
DT_S = 0.01


@contextmanager
def two_tiers(default: Dynamics = "auto", *, step_ns: int = STEP_NS) -> Iterator[TieredEngine]:
    """Make a tiered engine over PyBullet; it is closed at the end."""
    config = EngineConfig(step_ns)
    engine = TieredEngine(PyBulletEngine(config), config, default)
    try:
        yield engine
    finally:
        engine.close()


def shipped(name: str) -> Model:
    return read_urdf(read_builtin_model(name))


def with_dynamics(model: Model, dynamics: Dynamics) -> Model:
    return msgspec.structs.replace(model, dynamics=dynamics)


def steps(engine: TieredEngine, count: int) -> None:
    for _ in range(count):
        engine.step()


def places(engine: TieredEngine, bodies: list[int]) -> FloatArray:
    """Read the positions (n, 2) of bodies."""
    return np.asarray(engine.read(tuple(bodies)).base[:, :2])


def heading(engine: TieredEngine, body: int) -> float:
    return float(to_yaw(engine.read((body,)).base[0, 3:7]))
