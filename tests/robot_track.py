"""Robots driven in one process, with real physics and without a network."""

import math
from dataclasses import dataclass

import numpy as np

from tests.engines import STEP_NS, MakeEngine
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.se3 import to_yaw
from zensim.robot_agent.base_controller import BaseController
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import BaseMotion
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig

CONTROL_STEPS = 3


@dataclass(frozen=True)
class TrackResult:
    """Motion of a robot during a command.

    Attributes:
        ahead_m: Displacement along the heading at the start.
        left_m: Displacement to the left of that heading.
        length_m: Length of the path.
        turned_rad: Accumulated turn.
        motion: Final odometry.
        row: Final state row.
    """

    ahead_m: float
    left_m: float
    length_m: float
    turned_rad: float
    motion: BaseMotion
    row: FloatArray


class Track:
    """One robot on a plane, with its base controller."""

    def __init__(self, model: Model, start: FloatArray, make: MakeEngine = PyBulletEngine) -> None:
        self._engine = make(EngineConfig(STEP_NS))
        self._body = self._engine.add(model, start)
        self._base = BaseController(model)
        self._steps = 0

    def close(self) -> None:
        self._engine.close()

    def drive(
        self, seconds: float, *, x: float = 0.0, y: float = 0.0, yaw: float = 0.0
    ) -> TrackResult:
        """Command one twist for some simulation time."""
        twist = Twist(Vector3(x, y), Vector3(0.0, 0.0, yaw))
        start = before = self._row()
        length = turned = 0.0
        for _ in range(round(seconds * 1e9 / STEP_NS / CONTROL_STEPS)):
            self._control(twist)
            row = self._row()
            length += float(np.hypot(*(row[:2] - before[:2])))
            change = float(to_yaw(row[3:7]) - to_yaw(before[3:7]))
            turned += (change + math.pi) % (2.0 * math.pi) - math.pi
            before = row
        heading = float(to_yaw(start[3:7]))
        dx, dy = (before - start)[:2].tolist()
        return TrackResult(
            dx * math.cos(heading) + dy * math.sin(heading),
            dy * math.cos(heading) - dx * math.sin(heading),
            length,
            turned,
            self._base.motion,
            before,
        )

    def _control(self, twist: Twist) -> None:
        state = self._engine.read([self._body])
        reading = RobotState(
            self._steps * STEP_NS,
            tuple(state.base[0].tolist()),
            tuple(state.joint_positions.tolist()),
            tuple(state.joint_velocities.tolist()),
        )
        self._base.update(reading, twist)
        self._engine.command([self._body], np.array(self._base.targets))
        for _ in range(CONTROL_STEPS):
            self._engine.step()
        self._steps += CONTROL_STEPS

    def joint_velocities(self) -> list[float]:
        """Velocities of all joints [rad/s]."""
        found: list[float] = self._engine.read([self._body]).joint_velocities.tolist()
        return found

    def _row(self) -> FloatArray:
        return np.asarray(self._engine.read([self._body]).base[0])
