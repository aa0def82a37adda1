"""Engines for tests: an ideal one, and all that fulfil the contract."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import multiply, to_yaw
from zensim.sim_server.physics.actuation import impose_planar_twists, make_actuation
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.cells.cell_executor import InProcessCellExecutor
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine import BodyStates, Engine, EngineRefused, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.isolating_engine import IsolatingEngine
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.physics.sleeping_engine import SleepingEngine

STEP_NS = 4_166_667
TOUCHING_M = 0.1
MakeEngine = Callable[[EngineConfig], Engine]


@dataclass
class _Body:
    model: Model
    base: FloatArray
    positions: FloatArray
    velocities: FloatArray
    targets: FloatArray | None = None


class ObedientEngine(Engine):
    """Ideal kinematics: targets are reached at once; nothing falls or collides."""

    name = "obedient"

    def __init__(self, config: EngineConfig) -> None:
        self._dt_s = config.step_ns * 1e-9
        self._bodies: dict[int, _Body] = {}
        self.is_closed = False

    @property
    def bodies(self) -> tuple[int, ...]:
        return tuple(self._bodies)

    def prepare(self, model: Model) -> bool:  # noqa: ARG002
        return True

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        for joint in model.joints:
            if joint.kind in ("floating", "planar"):
                raise EngineRefused(f"joint kind '{joint.kind}' is not supported; use continuous")
        zeros = np.zeros(len(model.joints))
        self._bodies[body] = _Body(model, base.copy(), zeros, zeros.copy())

    def discard(self, body: int) -> None:
        del self._bodies[body]

    def forget_removed(self) -> None:
        pass

    def find_overlaps(self, body: int) -> Sequence[int]:
        place = self._bodies[body].base[:3]
        return [
            number
            for number, other in self._bodies.items()
            if number != body and float(np.linalg.norm(other.base[:3] - place)) < TOUCHING_M
        ]

    def read(self, bodies: Sequence[int]) -> BodyStates:
        found = [self._bodies[body] for body in bodies]
        none = np.zeros(0)
        return BodyStates(
            np.array([body.base for body in found]).reshape(len(found), 13),
            np.concatenate([none, *(body.positions for body in found)]),
            np.concatenate([none, *(body.velocities for body in found)]),
        )

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        return np.full(sum(len(self._bodies[body].positions) for body in bodies), np.nan)

    def set_base_state(self, body: int, base: FloatArray) -> None:
        self._bodies[body].base = base.copy()

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        self.set_base_state(body, base)
        self._bodies[body].positions[:] = 0.0 if positions is None else positions
        self._bodies[body].velocities[:] = 0.0
        self._bodies[body].targets = None

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        self.set_base_state(body, base)
        self._bodies[body].positions[:] = positions
        self._bodies[body].velocities[:] = velocities

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        at = 0
        for number in bodies:
            body = self._bodies[number]
            width = body.model.target_count
            body.targets = targets[at : at + width] if width else None
            at += width

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        pushed = self._bodies[body]
        if link == 0 and not pushed.model.is_static:
            inertial = pushed.model.links[0].inertial
            ixx, _, _, iyy, _, izz = inertial.inertia
            pushed.base[7:10] += wrench[:3] * self._dt_s / inertial.mass_kg
            pushed.base[10:13] += wrench[3:] * self._dt_s / np.array([ixx, iyy, izz])

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        self._bodies[body].velocities[joint] += effort * self._dt_s

    def step(self) -> bool:
        for body in self._bodies.values():
            self._advance(body)
        return True

    def close(self) -> None:
        self.is_closed = True

    def _advance(self, body: _Body) -> None:
        if body.targets is not None:
            _apply_targets(body, body.targets)
        if isinstance(body.model.drive, DiffDrive):
            body.base[7:13] = _wheel_twist(body, body.model.drive)
        body.positions += body.velocities * self._dt_s
        if body.model.is_static:
            return
        body.base[:3] += body.base[7:10] * self._dt_s
        if body.base[10:13].any():
            body.base[3:7] = multiply(_rotation_by(body.base[10:13] * self._dt_s), body.base[3:7])


def _apply_targets(body: _Body, targets: FloatArray) -> None:
    plan = make_actuation(body.model)
    body.velocities[plan.speeds.joints] = targets[plan.speeds.columns]
    body.positions[plan.angles.joints] = targets[plan.angles.columns]
    if plan.twist is not None:
        twist = targets[plan.twist : plan.twist + 3]
        rows = impose_planar_twists(
            body.base[None, 7:], body.base[None, 3:7], np.zeros((1, 3)), twist[None]
        )
        body.base[7:13] = rows[0]


def _wheel_twist(body: _Body, drive: DiffDrive) -> FloatArray:
    pair = drive.pairs[0]
    names = [joint.name for joint in body.model.joints]
    left, right = (
        body.velocities[names.index(name)] * pair.diameter_m / 2.0
        for name in (pair.left_joint, pair.right_joint)
    )
    forward = (left + right) / 2.0
    heading = float(to_yaw(body.base[3:7]))
    return np.array(
        [
            forward * math.cos(heading),
            forward * math.sin(heading),
            0.0,
            0.0,
            0.0,
            (right - left) / pair.separation_m,
        ]
    )


def _rotation_by(angles: FloatArray) -> FloatArray:
    angle = float(np.linalg.norm(angles))
    return np.append(angles / angle * math.sin(angle / 2.0), math.cos(angle / 2.0))


class Celled:
    """Makes engines that use a second cell from two bodies on."""

    def __init__(self, make: MakeEngine, name: str) -> None:
        self.name = f"celled-{name}"
        self._make = make

    def __call__(self, config: EngineConfig) -> Engine:
        cells = InProcessCellExecutor(lambda: self._make(config))
        return CelledEngine(config, cells, CellSettings(single_cell_bodies=1, cell_bodies=2))


class TieredFull(TieredEngine):
    """Two tiers; the kinematic one stays empty."""

    def __init__(self, config: EngineConfig) -> None:
        super().__init__(PyBulletEngine(config), config, "full")


class TieredAuto(TieredEngine):
    """Two tiers; robots are kinematic if possible."""

    def __init__(self, config: EngineConfig) -> None:
        super().__init__(PyBulletEngine(config), config, "auto")


class SleepingBullet(SleepingEngine):
    """PyBullet with sleep."""

    def __init__(self, config: EngineConfig) -> None:
        super().__init__(PyBulletEngine(config), config)


PHYSICAL: tuple[MakeEngine, ...] = (PyBulletEngine, SleepingBullet, MujocoEngine)
"""Engines with forces, masses and friction."""


class IsolatingBullet(IsolatingEngine):
    """PyBullet whose faults are isolated."""

    def __init__(self, config: EngineConfig) -> None:
        super().__init__(PyBulletEngine(config))


ENGINES: tuple[MakeEngine, ...] = (
    PyBulletEngine,
    SleepingBullet,
    MujocoEngine,
    ObedientEngine,
    Celled(partial(PyBulletEngine, awake=2), "pybullet"),
    Celled(MujocoEngine, "mujoco"),
    TieredFull,
    TieredAuto,
)
REAL_ENGINES: tuple[MakeEngine, ...] = (
    *(make for make in ENGINES if make is not ObedientEngine),
    IsolatingBullet,
)
"""Engines with contacts and efforts."""


@contextmanager
def running(make: MakeEngine, config: EngineConfig | None = None) -> Iterator[Engine]:
    """Make an engine, and close it; defaults to 240 Hz, gravity and ground."""
    engine = make(config or EngineConfig(STEP_NS))
    try:
        yield engine
    finally:
        engine.close()


def advance(engine: Engine, steps: int) -> None:
    for _ in range(steps):
        engine.step()
