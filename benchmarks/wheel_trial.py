"""One robot in a world of its own in this process: it stands, drives straight, stops and turns."""

from dataclasses import dataclass

import numpy as np

from benchmarks.wheel_models import STRAIGHT, WheelRobot
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.model_messages import Dynamics, Model
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.robot_agent.base_controller import BaseController
from zensim.robot_agent.drive_state_decoder import DriveStateLayout
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig, EngineName, EngineOptions
from zensim.sim_server.physics.engine_factory import create_world_engine
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.world.simulated_world import World
from zensim.sim_server.world.spawn_request import ValidatedSpawn

STEP_NS = 4_166_667
CONTROL_STEPS = 3
"""As a server has them."""
DT_S = STEP_NS * CONTROL_STEPS * 1e-9
AGENT = "bench"
STAND_S, DRIVE_S, STOP_S = 1.5, 4.0, 1.0
COUNTED_S = 2.0
"""At the end of each drive."""
REST_S = 0.5
"""Counted at the end of standing."""
KINEMATIC = "kinematic"


@dataclass(frozen=True)
class Motion:
    """Mean motion of the root link: speeds ahead and aside [m/s], turn [rad/s]."""

    ahead: float
    aside: float
    turn: float


@dataclass(frozen=True)
class Trial:
    """What a robot did.

    Attributes:
        straight, turning: In the last seconds of each.
        creep_mm_s: While it stood.
        tilt_rad: While it stood.
    """

    straight: Motion
    turning: Motion
    creep_mm_s: float
    tilt_rad: float


class LockstepRobot:
    """A robot and its controller, stepped together."""

    def __init__(self, model: Model, engine: str) -> None:
        self.world = _make_world(engine)
        base = np.zeros(13)
        base[2], base[6] = -find_ground_clearance(model), 1.0
        try:
            self.world.spawn(
                ValidatedSpawn(
                    name="robot",
                    namespace="",
                    model=model,
                    base=base,
                    description="",
                    allow_renaming=False,
                    born_ns=0,
                )
            )
        except BaseException:
            self.world.close()
            raise
        (self._claim,) = self.world.claim(AGENT, ("robot",), "stop")
        self._controller = BaseController(model)
        self._layout = DriveStateLayout([len(model.joints)])

    def drive(self, duration_s: float, linear: float, angular: float) -> FloatArray:
        """Drive for a time; return base states (n, 13), one per control step."""
        twist = Twist(Vector3(x=linear), Vector3(z=angular))
        rows = []
        for _ in range(round(duration_s / DT_S)):
            for _, state in self.world.drive_states():
                (own,) = self._layout.split(state)
                self._controller.update(own, twist)
                targets = np.array(self._controller.targets).tobytes()
                command = DriveCommand(state.epoch, state.step, state.claims, targets)
                self.world.command(AGENT, command)
                rows.append(own.base)
            for _ in range(CONTROL_STEPS):
                self.world.step()
        return np.array(rows)


def _make_world(engine: str) -> World:
    config = EngineConfig(STEP_NS)
    name: EngineName = "mujoco" if engine == "mujoco" else "pybullet"
    full = create_world_engine(
        config, EngineOptions(engine=name, clusters="off", workers=0), period_steps=CONTROL_STEPS
    )
    dynamics: Dynamics = "kinematic" if engine == KINEMATIC else "full"
    return World(
        TieredEngine(full, config, dynamics),
        name="bench",
        step_ns=STEP_NS,
        control_steps=CONTROL_STEPS,
    )


def run_trial(robot: WheelRobot, engine: str) -> Trial:
    """Drive a robot in an engine: `pybullet`, `mujoco` or `kinematic`.

    Raises:
        EngineRefused: The engine cannot simulate it.
    """
    driven = LockstepRobot(robot.model(), engine)
    try:
        rest = driven.drive(STAND_S, 0.0, 0.0)[-round(REST_S / DT_S) :]
        straight = driven.drive(DRIVE_S, *STRAIGHT)
        driven.drive(STOP_S, 0.0, 0.0)
        turning = driven.drive(DRIVE_S, *robot.turn)
    finally:
        driven.world.close()
    moved = float(np.linalg.norm(rest[-1, :2] - rest[0, :2]))
    return Trial(
        _find_motion(straight),
        _find_motion(turning),
        creep_mm_s=moved / ((len(rest) - 1) * DT_S) * 1e3,
        tilt_rad=_find_tilt(rest[-1]),
    )


def _find_motion(rows: FloatArray) -> Motion:
    """Find the mean motion of the last seconds, by the path."""
    counted = rows[-round(COUNTED_S / DT_S) - 1 :]
    yaw = np.unwrap(_find_yaws(counted))
    dx, dy = np.diff(counted[:, 0]), np.diff(counted[:, 1])
    middle = (yaw[1:] + yaw[:-1]) / 2.0
    duration_s = len(dx) * DT_S
    return Motion(
        float((dx * np.cos(middle) + dy * np.sin(middle)).sum()) / duration_s,
        float((dy * np.cos(middle) - dx * np.sin(middle)).sum()) / duration_s,
        float(yaw[-1] - yaw[0]) / duration_s,
    )


def _find_yaws(rows: FloatArray) -> FloatArray:
    x, y, z, w = rows[:, 3:7].T
    found: FloatArray = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return found


def _find_tilt(row: FloatArray) -> float:
    x, y = row[3:5]
    return float(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))
