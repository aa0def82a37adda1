"""The demo of `zensim up` moves its robots until something commands them."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from tests.integration.processes import eventually
from zensim.api.connections import connect, launch
from zensim.api.sim import Sim
from zensim.deploy.circle_demo import CircleDemo
from zensim.deploy.demo_patterns import PoseBehaviour
from zensim.deploy.fleet_demo import FleetDemo, make_demo_motion
from zensim.deploy.other_commands import find_commanded_robot
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, BusPublisher, open_bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.topic_catalog import CMD_VEL
from zensim.scenario.robot_behaviours import FleetState
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

PLACES = make_fleet_layout("r", 3, "row", 1.0)


@pytest.fixture
def playing() -> Iterator[Sim]:
    with launch(rtf=1.0, timeout_s=120.0) as sim:
        sim.spawn_fleet("box_bot", poses=[(one.x, one.y) for one in PLACES], prefix="r")
        yield sim


def update_until(demo: CircleDemo | FleetDemo, condition: Callable[[], bool]) -> None:
    def look() -> bool:
        demo.update()
        return condition()

    eventually(look, 120.0, "what the demo does")


@pytest.mark.parametrize(
    ("key", "robot"),
    [
        ("r0/cmd_vel", "r0"),
        ("0/r0/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_9c", "r0"),
        ("cmd_vel", ""),
        ("r0/odom", ""),
    ],
)
def test_robot_of_a_command_is_found(key: str, robot: str) -> None:
    assert find_commanded_robot(key) == robot


@pytest.mark.parametrize("behaviour", ["waypoints", "random_walk"])
def test_pattern_commands_each_robot(behaviour: PoseBehaviour) -> None:
    motion = make_demo_motion(PLACES, behaviour)
    poses = np.array([(one.x, one.y, one.yaw) for one in PLACES])

    twists = motion.command(FleetState(0.0, 0.01, poses, np.zeros((3, 6))))

    assert twists.shape == (3, 2)
    assert (twists[:, 0] > 0.0).all()


def make_circles(bus: Bus, endpoint: str) -> CircleDemo:
    return CircleDemo(bus, endpoint, "default", [one.name for one in PLACES])


def make_squares(bus: Bus, endpoint: str) -> FleetDemo:
    return FleetDemo(bus, endpoint, "default", PLACES, "waypoints")


@pytest.mark.parametrize("make", [make_circles, make_squares])
def test_robots_move_each_until_it_is_commanded(
    playing: Sim, make: Callable[[Bus, str], CircleDemo | FleetDemo]
) -> None:
    fleet = playing.fleet(["r0", "r1", "r2"])
    endpoint = playing.endpoint
    start = fleet.poses2d()

    with open_bus(BusConfig(connect=(endpoint,))) as bus, make(bus, endpoint) as demo:
        update_until(demo, lambda: bool((np.abs(fleet.poses2d() - start).max(axis=1) > 0.1).all()))
        command = bus.advertise(CMD_VEL.key("r0"), CMD_VEL.encoding)
        update_until(demo, lambda: _drive_back(command) and fleet.twists()[0, 0] < -0.05)
        with connect(endpoint) as other:
            other.robots["r1"].drive(-0.1, 0.0)
            update_until(demo, lambda: bool(fleet.twists()[1, 0] < -0.05))
            seen_s = playing.time
            update_until(demo, lambda: playing.time > seen_s + 0.5)
            assert fleet.twists()[1, 0] < -0.05

        update_until(demo, lambda: bool(fleet.twists()[2, 0] > 0.2))
        assert not demo.is_over


def test_circles_begin_when_a_paused_world_plays(playing: Sim) -> None:
    playing.pause()
    fleet, endpoint = playing.fleet(["r0", "r1", "r2"]), playing.endpoint

    with open_bus(BusConfig(connect=(endpoint,))) as bus, make_circles(bus, endpoint) as demo:
        demo.update()
        playing.step(20)
        assert np.abs(fleet.twists()[:, 0]).max() < 0.01
        playing.play()
        update_until(demo, lambda: bool((fleet.twists()[:, 0] > 0.2).all()))


def _drive_back(command: BusPublisher) -> bool:
    payload = encode(Twist(linear=Vector3(x=-0.1)), Format.CDR)
    command.send(payload)
    return True
