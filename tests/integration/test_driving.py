"""Robots follow commands over the network."""

import math
from collections.abc import Iterator

import pytest

from tests.integration.processes import Server, eventually, running_agents, serving
from tests.integration.robots import Robot, drive_for, place, robot
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.standard_messages import Point, Pose, Twist

TEN = tuple(f"box_bot{i}" for i in range(10))
BODY_M = 0.1


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving("--paused") as found:
        layout = ("--robots", "10", "--layout", "grid", "--spacing", "5")
        assert found.zensim("fleet", "box_bot", *layout).returncode == 0
        with running_agents(found, *TEN):
            yield found


@pytest.fixture
def ten(server: Server) -> list[Robot]:
    return [robot(server.bus, name) for name in TEN]


def test_ten_robots_drive_two_metres_at_0_2_for_ten_seconds(
    server: Server, ten: list[Robot]
) -> None:
    drive_results = drive_for(server.client, ten, linear=0.2, angular=0.0, sim_s=10.0)

    assert [drive_result.forward_m for drive_result in drive_results] == pytest.approx(
        [2.0] * 10, rel=0.01
    )
    assert [drive_result.sideways_m for drive_result in drive_results] == pytest.approx(
        [0.0] * 10, abs=0.01
    )


def test_ten_robots_turn_ten_radians_when_turned_at_one_for_ten_seconds(
    server: Server, ten: list[Robot]
) -> None:
    drive_results = drive_for(server.client, ten, linear=0.0, angular=1.0, sim_s=10.0)

    assert [drive_result.turned_rad for drive_result in drive_results] == pytest.approx(
        [10.0] * 10, rel=0.02
    )


def test_robots_block_each_other_when_driven_head_on(server: Server, ten: list[Robot]) -> None:
    left, right = ten[0], ten[1]
    _face(server, "box_bot0", x=100.0, heading=0.0)
    _face(server, "box_bot1", x=101.0, heading=math.pi)

    drive_for(server.client, [left, right], linear=0.2, angular=0.0, sim_s=5.0)

    (x_left, _), (x_right, _) = place(left.newest()), place(right.newest())
    assert BODY_M * 0.95 < x_right - x_left < BODY_M * 1.6


def _face(server: Server, name: str, *, x: float, heading: float) -> None:
    height = server.client.entity_state(name).pose.position.z
    turn = Pose(Point(x, 0.0, height)).orientation
    half = heading / 2.0
    orientation = type(turn)(0.0, 0.0, math.sin(half), math.cos(half))
    pose = Pose(Point(x, 0.0, height), orientation)
    server.client.set_entity_state(name, EntityState(pose=pose, twist=Twist()))
    eventually(
        lambda: abs(server.client.entity_state(name).pose.position.x - x) < 0.01, 5.0, "placing"
    )
