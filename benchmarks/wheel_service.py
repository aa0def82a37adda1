"""Robots of the wheel benchmark in a server process, each with an agent, commanded over Zenoh."""

import math
from collections.abc import Sequence

from benchmarks.wheel_models import STRAIGHT, WheelRobot
from benchmarks.wheel_trial import KINEMATIC
from tests.integration.processes import Server, eventually, running_agents, serving
from zensim.deploy.robot_trial import COUNTED_S, DRIVE_S, SETTLE_S, STOP_S
from zensim.proto.bus import BusPublisher
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Header,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Twist,
    Vector3,
)
from zensim.proto.topic_catalog import CMD_VEL

SPACING_M = 10.0
CONNECT_S = 20.0

Place = tuple[float, float, float]
"""x, y [m] and yaw [rad]."""
SpeedAndTurn = tuple[float, float]
"""Speed [m/s] of driving straight, turn [rad/s] of turning."""


def drive_in_service(robots: Sequence[WheelRobot], engine: str) -> list[SpeedAndTurn]:
    """Drive robots that have the same commands, as `run_trial` does, through the whole service."""
    options = ("--dynamics", KINEMATIC) if engine == KINEMATIC else ("--engine", engine)
    names = [robot.name.replace(".", "_") for robot in robots]
    with serving("--lockstep", "--rtf", "0", "--paused", *options) as server:
        for row, (robot, name) in enumerate(zip(robots, names, strict=True)):
            _spawn(server, robot, name, row)
        with running_agents(server, *names, options=("--quiet", "--cmd-vel-timeout", "0")):
            publishers = [
                server.bus.advertise(CMD_VEL.key(name), make_encoding(Twist, Format.CDR))
                for name in names
            ]
            eventually(
                lambda: all(one.is_matched for one in publishers), CONNECT_S, "agents that listen"
            )
            return _drive(server, names, publishers, robots[0].turn)


def _spawn(server: Server, robot: WheelRobot, name: str, row: int) -> None:
    pose = Pose(Point(y=row * SPACING_M), Quaternion(w=1.0))
    server.client.spawn(
        SpawnEntityOrder(
            name=name,
            entity_resource=Resource(resource_string=robot.urdf),
            initial_pose=PoseStamped(Header(), pose),
            snap_to_ground=True,
            drive=robot.order,
        )
    )


def _drive(
    server: Server,
    names: Sequence[str],
    publishers: Sequence[BusPublisher],
    turn: tuple[float, float],
) -> list[SpeedAndTurn]:
    def command(linear: float, angular: float, duration_s: float) -> None:
        twist = encode(Twist(Vector3(x=linear), Vector3(z=angular)), Format.CDR)
        for one in publishers:
            one.send(twist)
        now_s = server.client.info().sim_time_s
        server.client.run_to(round((now_s + duration_s) * NANOSECONDS))

    def measure(linear: float, angular: float) -> list[tuple[Place, Place]]:
        command(linear, angular, DRIVE_S - COUNTED_S)
        before = [_find_place(server, name) for name in names]
        command(linear, angular, COUNTED_S)
        return list(zip(before, (_find_place(server, name) for name in names), strict=True))

    assert server.client.simulation_state() == State.PAUSED
    command(0.0, 0.0, SETTLE_S)
    straight = measure(*STRAIGHT)
    command(0.0, 0.0, STOP_S)
    turned = measure(*turn)
    return [
        (math.dist(start[:2], end[:2]) / COUNTED_S, (last[2] - first[2]) / COUNTED_S)
        for (start, end), (first, last) in zip(straight, turned, strict=True)
    ]


def _find_place(server: Server, name: str) -> Place:
    pose = server.client.entity_state(name).pose
    q = pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return pose.position.x, pose.position.y, yaw
