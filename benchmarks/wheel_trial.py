"""One robot in a world of its own in this process: it stands, drives straight, stops and turns."""

from dataclasses import dataclass

from tests.sim_server.description.wheel_models import STRAIGHT, WheelRobot
from zensim.deploy.robot_trial import (
    AT_REST,
    DRIVE_S,
    NAME,
    SETTLE_S,
    STOP_S,
    RestMeasurement,
    drive_robot,
    measure_rest,
    measure_twist,
    open_trial_world,
)
from zensim.proto.messages.model_messages import Dynamics, Vec3
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.service_catalog import SPAWN_ENTITY

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
        SpawnRefused: The engine cannot simulate it.
    """
    dynamics: Dynamics = "kinematic" if engine == KINEMATIC else "full"
    with open_trial_world("pybullet" if engine == KINEMATIC else engine) as world:
        world.call(
            SPAWN_ENTITY,
            SpawnEntityOrder(
                name=NAME,
                entity_resource=Resource(resource_string=robot.urdf),
                snap_to_ground=True,
                drive=robot.order,
                dynamics=dynamics,
            ),
        )
        spawned, period_s = world.robots[NAME], world.control_period
        straight, turn = ((linear, 0.0, angular) for linear, angular in (STRAIGHT, robot.turn))
        rest = drive_robot(world, spawned, SETTLE_S, AT_REST)
        ahead = drive_robot(world, spawned, DRIVE_S, straight)
        drive_robot(world, spawned, STOP_S, AT_REST)
        turning = drive_robot(world, spawned, DRIVE_S, turn)
    return Trial(
        measure_rest(rest, period_s),
        measure_twist(ahead, period_s),
        measure_twist(turning, period_s),
    )
