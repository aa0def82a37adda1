"""Ordered drives move robots as commanded, in every engine and over the network."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.engines import MakeEngine, TieredAuto
from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import (
    Server,
    free_endpoint,
    running,
    running_agents,
    serving,
    wait_for_agents,
)
from tests.integration.robots import drive_for, place, robot, stamp_s
from tests.models import a_state
from tests.robot_track import Track
from tests.sim_server.description.plugins.driven_robots import (
    BALLS,
    ORDERED_ROBOTS,
    a_diff_robot,
    a_four_wheeler,
    read_driven,
)
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.messages.drive_messages import DiffDrive, OmniDrive
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

WHEEL_RADIUS_M = 0.1
ENGINES = (PyBulletEngine, MujocoEngine, TieredAuto)
CONTROLLERS = """
base:
  type: diff_drive_controller/DiffDriveController
  left_wheel: left
  right_wheel: right
"""
StartTrack = Callable[[str, MakeEngine], Track]


@pytest.fixture
def start() -> Iterator[StartTrack]:
    with ExitStack() as stack:

        def begin(name: str, make: MakeEngine) -> Track:
            text, order = ORDERED_ROBOTS[name]
            model = read_driven(text, order=parse_drive_order(order))
            track = Track(model, a_state((0.0, 0.0, WHEEL_RADIUS_M)), make)
            stack.callback(track.close)
            return track

        yield begin


@pytest.mark.parametrize("make", ENGINES, ids=lambda make: make.__name__)
@pytest.mark.parametrize("name", ORDERED_ROBOTS)
def test_ordered_drive_moves_as_commanded(start: StartTrack, name: str, make: MakeEngine) -> None:
    track = start(name, make)
    track.drive(2.0, x=0.3)

    straight = track.drive(2.0, x=0.3)
    track.drive(1.0, x=0.3, yaw=0.3)
    turned = track.drive(2.0, x=0.3, yaw=0.3)

    assert straight.ahead_m == pytest.approx(0.6, rel=0.01)
    assert (straight.left_m, straight.turned_rad) == pytest.approx((0.0, 0.0), abs=0.01)
    assert turned.turned_rad == pytest.approx(0.6, rel=0.02)
    assert turned.motion.linear_x == pytest.approx(0.3, rel=0.02)


@pytest.mark.parametrize("make", ENGINES, ids=lambda make: make.__name__)
@pytest.mark.parametrize("name", ["mecanum", "omni"])
def test_wheels_with_rollers_let_a_robot_move_sideways_and_turn_along(
    start: StartTrack, name: str, make: MakeEngine
) -> None:
    track = start(name, make)
    track.drive(1.0, y=0.2)

    sideways = track.drive(2.0, y=0.2)

    assert (sideways.ahead_m, sideways.left_m) == pytest.approx((0.0, 0.4), abs=0.01)
    # The wheels of the omni robot stand along its sides.
    expected = [-2.0, 2.0, 2.0, -2.0] if name == "mecanum" else [0.0] * 4
    assert track.joint_velocities() == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("agent", [("agent", "r"), ("agent", "--pool", "0")], ids=["one", "pool"])
def test_mecanum_robot_strafes_over_the_network(agent: tuple[str, ...]) -> None:
    with serving() as server:
        spawn(server, a_four_wheeler(), drive="mecanum:fl,fr,rl,rr")
        with running(*agent, "--connect", server.endpoint):
            wait_for_agents(server, ["r"])
            driver = robot(server.bus, "r")
            begin_s = stamp_s(driver.now())

            while stamp_s(driver.now()) < begin_s + 2.0:
                driver.cmd_vel.send(encode(Twist(Vector3(0.0, 0.3)), Format.CDR))

            ahead, left = place(driver.now())
            assert left > 0.3
            assert abs(ahead) < 0.05


def spawn(server: Server, text: str, *, drive: str = "", controllers: str = "") -> None:
    server.client.spawn(
        SpawnEntityOrder(
            "r",
            entity_namespace="r",
            entity_resource=Resource(resource_string=text),
            snap_to_ground=True,
            drive=parse_drive_order(drive),
            controllers=(controllers,) if controllers else (),
        )
    )


def test_robot_of_a_controllers_file_drives_after_the_server_was_killed(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with serving_with_journal(tmp_path, endpoint) as server:
        spawn(server, a_diff_robot(BALLS), controllers=CONTROLLERS)
        kill_hard(server)

    with serving_with_journal(tmp_path, endpoint) as server:
        assert isinstance(server.client.models(("r",)).models[0].drive, DiffDrive)
        with running_agents(server, "r"):
            driven = [robot(server.bus, "r")]
            (moved,) = drive_for(server.client, driven, linear=0.3, angular=0.0, sim_s=2.0)

    assert moved.forward_m == pytest.approx(0.6, rel=0.1)


def test_one_description_has_the_drive_of_each_spawn() -> None:
    with serving() as server:
        spawn(server, a_four_wheeler(), drive="diff:fl+rl,fr+rr")
        first = server.client.models(("r",)).models[0].drive
        server.client.delete("r")
        spawn(server, a_four_wheeler(), drive="omni:fl,fr,rl,rr")
        second = server.client.models(("r",)).models[0].drive

    assert isinstance(first, DiffDrive)
    assert isinstance(second, OmniDrive)
