"""Each drive follows its command, from twist through physics to odometry."""

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import msgspec
import pytest

from tests.models import TRACK_M, WHEEL_RADIUS_M, a_cart, a_state
from tests.robot_track import Track
from zensim.proto.messages.model_messages import Model, Origin, Shape
from zensim.proto.se3 import from_rpy
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

HEIGHTS = {"omni_bot": 0.05, "skid_bot": 0.06, "car_bot": 0.05, "trike_bot": 0.05}
CAR_WHEELBASE_M = 0.3
CAR_BASE_AHEAD_M = 0.15
"""Of its rear axle."""
TRIKE_WHEELBASE_M = 0.3
TRIKE_BASE_AHEAD_M = 0.1
LAID = tuple(from_rpy(math.pi / 2.0, 0.0, 0.0).tolist())
StartTrack = Callable[..., Track]


@pytest.fixture
def start() -> Iterator[StartTrack]:
    with ExitStack() as stack:

        def begin(model: Model | str, height_m: float | None = None, heading: float = 0.0) -> Track:
            height = HEIGHTS.get(model, 0.0) if isinstance(model, str) else 0.0
            read = read_urdf(read_builtin_model(model)) if isinstance(model, str) else model
            lift = height if height_m is None else height_m
            track = Track(read, a_state((0.0, 0.0, lift), turn=(0.0, 0.0, heading)))
            stack.callback(track.close)
            return track

        yield begin


@pytest.mark.parametrize("name", HEIGHTS)
def test_robot_follows_its_command_and_stops(start: StartTrack, name: str) -> None:
    track = start(name, heading=0.7)
    track.drive(2.0, x=0.3)

    ahead, stopped = track.drive(4.0, x=0.3), track.drive(2.0)

    assert ahead.ahead_m == pytest.approx(1.2, rel=0.01)
    assert (ahead.left_m, ahead.turned_rad) == pytest.approx((0.0, 0.0), abs=0.01)
    assert ahead.motion.linear_x == pytest.approx(0.3, rel=0.01)
    assert abs(stopped.row[7:]).max() < 0.02


def test_omni_bot_moves_sideways_while_it_turns(start: StartTrack) -> None:
    track = start("omni_bot")

    sideways = track.drive(5.0, y=0.4)
    turned = track.drive(5.0, x=0.2, y=-0.2, yaw=1.0)

    assert (sideways.ahead_m, sideways.left_m) == pytest.approx((0.0, 2.0), abs=0.02)
    assert sideways.turned_rad == pytest.approx(0.0, abs=0.01)
    assert turned.turned_rad == pytest.approx(5.0, rel=0.01)
    assert turned.length_m == pytest.approx(math.hypot(0.2, 0.2) * 5.0, rel=0.01)
    assert turned.motion.linear_y == pytest.approx(-0.2, rel=0.02)


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_skid_bot_turns_on_the_spot(start: StartTrack, turn: float) -> None:
    drive_result = start("skid_bot").drive(10.0, yaw=turn)

    # It skids: the lost turn depends on friction, as in Gazebo.
    assert 5.0 < drive_result.turned_rad * turn < 10.0
    assert math.hypot(drive_result.ahead_m, drive_result.left_m) < 0.1


@pytest.mark.parametrize("steer", [0.3, -0.3, 0.6])
def test_car_bot_drives_the_circle_of_its_steering_angle(start: StartTrack, steer: float) -> None:
    track = start("car_bot")
    track.drive(2.0, x=0.4, yaw=steer)

    drive_result = track.drive(10.0, x=0.4, yaw=steer)

    radius = math.hypot(CAR_WHEELBASE_M / math.tan(steer), CAR_BASE_AHEAD_M)
    assert drive_result.length_m / drive_result.turned_rad == pytest.approx(
        math.copysign(radius, steer), rel=0.05
    )
    assert abs(drive_result.turned_rad) == pytest.approx(
        4.0 * math.tan(abs(steer)) / CAR_WHEELBASE_M, rel=0.05
    )


def test_car_bot_steers_within_its_limit(start: StartTrack) -> None:
    track = start("car_bot")
    track.drive(2.0, x=0.4, yaw=3.0)

    drive_result = track.drive(5.0, x=0.4, yaw=3.0)

    radius = math.hypot(CAR_WHEELBASE_M / math.tan(0.6), CAR_BASE_AHEAD_M)
    assert drive_result.length_m / drive_result.turned_rad == pytest.approx(radius, rel=0.05)


@pytest.mark.parametrize("steer", [0.5, -0.5])
def test_trike_bot_drives_the_circle_of_its_steering_angle(start: StartTrack, steer: float) -> None:
    track = start("trike_bot")
    track.drive(2.0, x=0.4, yaw=steer)

    drive_result = track.drive(10.0, x=0.4, yaw=steer)

    radius = math.hypot(TRIKE_WHEELBASE_M / math.tan(steer), TRIKE_BASE_AHEAD_M)
    assert drive_result.length_m / drive_result.turned_rad == pytest.approx(
        math.copysign(radius, steer), rel=0.05
    )


def a_cart_on_cylinders(width_m: float) -> Model:
    cart = a_cart()
    tyre = Shape("cylinder", (WHEEL_RADIUS_M, width_m, 0.0), Origin(orientation=LAID))
    wheels = tuple(msgspec.structs.replace(w, collisions=(tyre,)) for w in cart.links[1:])
    return msgspec.structs.replace(cart, links=(cart.links[0], *wheels))


@pytest.mark.parametrize("width_m", [0.001, 0.04])
def test_robot_on_cylinders_drives_two_metres_and_turns_ten_radians(
    start: StartTrack, width_m: float
) -> None:
    track = start(a_cart_on_cylinders(width_m), WHEEL_RADIUS_M)

    ahead, turned = track.drive(10.0, x=0.2), track.drive(10.0, yaw=1.0)

    assert 2.0 * width_m < TRACK_M
    assert (ahead.ahead_m, ahead.length_m) == pytest.approx((2.0, 2.0), rel=0.01)
    assert abs(ahead.left_m) < 0.01
    assert turned.turned_rad == pytest.approx(10.0, rel=0.02)
    assert math.hypot(turned.ahead_m, turned.left_m) < 0.01


def test_box_bot_legacy_drives_2_8_times_as_fast_as_commanded(start: StartTrack) -> None:
    track = start("box_bot_legacy", 0.01)
    track.drive(3.0, x=0.2)

    ahead = track.drive(5.0, x=0.2)
    track.drive(1.0, yaw=1.0)
    turned = track.drive(5.0, yaw=1.0)

    assert ahead.length_m / 5.0 == pytest.approx(0.56, rel=0.05)
    assert ahead.motion.linear_x == pytest.approx(0.56, rel=0.05)
    assert turned.turned_rad == pytest.approx(2.8 * 5.0, rel=0.05)
