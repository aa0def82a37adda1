"""Engines that fail for one body, bare and in every layer."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from tests.engines import STEP_NS
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.cells.cell_executor import (
    CellExecutor,
    InProcessCellExecutor,
    WorkerCellExecutor,
)
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_layer import EngineLayer
from zensim.sim_server.physics.isolating_engine import IsolatingEngine
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.physics.sleeping_engine import wrap_with_sleep

CONFIG = EngineConfig(STEP_NS)
ALWAYS = "always"
"""The engine fails for the body even when it is frozen."""


def make_culprit(model: Model, method: str) -> Model:
    """Make a model for whose bodies a method fails until they are frozen."""
    return msgspec.structs.replace(model, name=f"culprit.{method}")


class FaultyEngine(EngineLayer):
    """An engine that raises what no caller expects, in the methods that a model's name lists."""

    def __init__(self, inner: Engine) -> None:
        super().__init__(inner)
        self.capabilities = inner.capabilities
        self._culprits: dict[int, str] = {}

    def prepare(self, model: Model) -> bool:
        self._fail_for("prepare", model.name)
        return super().prepare(model)

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        self._fail_for("insert", model.name)
        super().insert(body, model, base)
        has_collisions = any(link.collisions for link in model.links)
        if not model.is_static or (ALWAYS in model.name and has_collisions):
            self._culprits[body] = model.name

    def discard(self, body: int) -> None:
        name = self._culprits.pop(body, "")
        super().discard(body)
        self._fail_for("discard", name)

    def find_overlaps(self, body: int) -> Sequence[int]:
        self._check("find_overlaps", [body])
        return super().find_overlaps(body)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        self._check("read", bodies)
        return super().read(bodies)

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        self._check("read_joint_efforts", bodies)
        return super().read_joint_efforts(bodies)

    def set_base_state(self, body: int, base: FloatArray) -> None:
        self._check("set_base_state", [body])
        super().set_base_state(body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        self._check("set_at_rest", [body])
        super().set_at_rest(body, base, positions)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        self._check("set_state", [body])
        super().set_state(body, base, positions, velocities)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        self._check("command", bodies)
        super().command(bodies, targets)

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        self._check("apply_link_wrench", [body])
        super().apply_link_wrench(body, link, wrench)

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        self._check("apply_joint_effort", [body])
        super().apply_joint_effort(body, joint, effort)

    def step(self) -> bool:
        self._check("step", list(self._culprits))
        return super().step()

    def hide(self, body: int) -> None:
        self._check("hide", [body])
        super().hide(body)

    def show(self, bodies: Sequence[int]) -> None:
        self._check("show", bodies)
        super().show(bodies)

    def sleep(self, bodies: Sequence[int]) -> None:
        self._check("sleep", bodies)
        self._inner.sleep(bodies)

    def wake(self, bodies: Sequence[int]) -> None:
        self._check("wake", bodies)
        self._inner.wake(bodies)

    def find_contacts(self, body: int) -> Sequence[int]:
        self._check("find_contacts", [body])
        return self._inner.find_contacts(body)

    def _check(self, method: str, bodies: Sequence[int]) -> None:
        for body in bodies:
            self._fail_for(method, self._culprits.get(body, ""))

    def _fail_for(self, method: str, name: str) -> None:
        if method in name.split("."):
            raise SystemError(f"{method} returned a result with an exception set")


@dataclass(frozen=True)
class FaultyCell:
    """Makes the engine of a cell, in this process or in a worker."""

    name: str

    def make(self) -> Engine:
        """Make an engine that fails for some bodies, in the layers of a cell."""
        raw = PyBulletEngine(CONFIG, awake=2) if self.name == "pybullet" else MujocoEngine(CONFIG)
        return wrap_with_sleep(IsolatingEngine(FaultyEngine(raw)), CONFIG)


def make_celled(cells: CellExecutor) -> Engine:
    settings = CellSettings(single_cell_bodies=1, cell_bodies=1, period_steps=1)
    return TieredEngine(CelledEngine(CONFIG, cells, settings), CONFIG, "full")


def make_with_workers(cell: FaultyCell) -> Engine:
    return make_celled(WorkerCellExecutor(cell.make, cell, workers=1))


BULLET, MUJOCO = FaultyCell("pybullet"), FaultyCell("mujoco")
FAULTY_ENGINES: dict[str, Callable[[], Engine]] = {
    "pybullet": lambda: IsolatingEngine(FaultyEngine(PyBulletEngine(CONFIG))),
    "pybullet, sleeping": BULLET.make,
    "mujoco": MUJOCO.make,
    "tiers": lambda: TieredEngine(BULLET.make(), CONFIG, "full"),
    "kinematic": lambda: TieredEngine(BULLET.make(), CONFIG, "auto"),
    "cells": lambda: make_celled(InProcessCellExecutor(BULLET.make)),
    "cells, threads": lambda: make_celled(InProcessCellExecutor(MUJOCO.make, threads=2)),
    "workers": lambda: make_with_workers(BULLET),
}


class FaultyBullet(FaultyEngine):
    """PyBullet that fails for some bodies, for a server that is told to use it."""

    def __init__(self, config: EngineConfig, **options: int) -> None:
        super().__init__(PyBulletEngine(config, **options))
