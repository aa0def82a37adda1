"""One robot in a world of its own in this process: it stands, drives straight, stops and turns."""

from contextlib import ExitStack
from dataclasses import dataclass

from benchmarks.wheel_models import STRAIGHT, WheelRobot
from zensim.deploy.robot_trial import (
    DRIVE_S,
    SETTLE_S,
    STOP_S,
    LockstepTrial,
    RestMeasurement,
    make_trial_world,
    measure_rest,
    measure_twist,
    spawn_on_ground,
)
from zensim.proto.messages.model_messages import Vec3
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.physics.engine_config import EngineOptions, parse_engine_name

KINEMATIC = "kinematic"


@dataclass(frozen=True)
class Trial:
    """What a robot did; twists are vx, vy [m/s] and wz [rad/s] in the last seconds."""

    rest: RestMeasurement
    straight: Vec3
    turning: Vec3


def run_trial(robot: WheelRobot, engine: str) -> Trial:
    """Drive a robot in an engine: `pybullet`, `mujoco` or `kinematic`.

    Raises:
        EngineRefused: The engine cannot simulate it.
    """
    with ExitStack() as cleanup:
        store = AssetStore()
        cleanup.callback(store.close)
        world = make_trial_world(_choose_options(engine), store)
        cleanup.callback(world.close)
        spawn_on_ground(world, store, robot.model(), robot.urdf)
        trial = LockstepTrial(world)
        straight, turn = ((linear, 0.0, angular) for linear, angular in (STRAIGHT, robot.turn))
        rest = trial.drive(SETTLE_S, straight, share=0.0)
        ahead = trial.drive(DRIVE_S, straight)
        trial.drive(STOP_S, straight, share=0.0)
        turning = trial.drive(DRIVE_S, turn)
    return Trial(
        measure_rest(rest, trial.control_s),
        measure_twist(ahead, trial.control_s),
        measure_twist(turning, trial.control_s),
    )


def _choose_options(engine: str) -> EngineOptions:
    if engine == KINEMATIC:
        return EngineOptions(engine="pybullet", dynamics="kinematic")
    return EngineOptions(engine=parse_engine_name(engine))
