"""slam_toolbox, AMCL and costmaps use the scans of lidars as public robots have them."""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
import pytest

from tests.sim_server.description.plugins.sensor_samples import a_sensor, the_sensor
from tests.sim_server.sensors.scan_consumers import (
    count_expected_readings,
    find_amcl_hits,
    find_costmap_clearings,
    find_costmap_marks,
    find_ray_angles,
)
from tests.sim_server.sensors.sensed_worlds import SensedWorld, a_robot, at, scans_of
from zensim.proto.messages.model_messages import Link, Model, Origin, Sensor, Shape
from zensim.proto.messages.standard_messages import LaserScan
from zensim.proto.se3 import FloatArray

HALF_LENGTH_M, HALF_WIDTH_M = 3.0, 2.0
"""Of the room, inside."""
STEP = 240
SIGMAS = 5.0
FLOAT32_ERROR_M = 1e-5


@dataclass(frozen=True)
class Lidar:
    """Rays of a lidar, and its limits."""

    samples: int
    min_angle: float
    max_angle: float
    range_min: float
    range_max: float
    stddev: float = 0.01


LIDARS = {
    "TurtleBot3 burger (Gazebo SDF)": Lidar(360, 0.0, 6.28, 0.12, 3.5),
    "TurtleBot 4 lite": Lidar(640, -3.141593, 3.141593, 0.164, 12.0),
    "Andino (Gazebo)": Lidar(720, -3.141593, 3.141593, 0.1, 12.0),
    "MiR100": Lidar(541, -2.356194, 2.356194, 0.05, 29.0),
    "linorobot2 2wd": Lidar(360, -3.1416, 3.1416, 0.08, 12.0),
    "Neobotix mp_400 (ROS 1)": Lidar(720, -0.785398, 0.785398, 0.1, 30.0),
    "Neobotix mp_500 (ROS 1)": Lidar(720, -1.48353, 1.48353, 0.1, 30.0),
    "Neobotix mpo_700 (ROS 1)": Lidar(720, -1.48, 1.48, 0.1, 30.0),
    "PR2": Lidar(640, -2.2689, 2.2689, 0.08, 10.0),
    "PR2, 2": Lidar(640, -1.396263, 1.396263, 0.08, 10.0),
    "TurtleBot3 waffle GPS (Nav2)": Lidar(360, 0.0, 6.28, 0.0, 20.0),
    "TurtleBot 4 (Nav2 minimal)": Lidar(360, 0.0, 6.28, 0.164, 20.0),
    "TurtleBot3 waffle (Nav2 minimal)": Lidar(360, 0.0, 6.28, 1e-05, 20.0),
    "ROSbot": Lidar(1600, -3.141593, 3.141593, 0.2, 10.0),
    "ROSbot XL": Lidar(920, -3.141593, 3.141593, 0.04, 40.0),
    "Boxer": Lidar(720, -2.356194, 2.356194, 0.5, 20.0),
    "Boxer, 2": Lidar(90, -0.785398, 0.785398, 0.1, 5.0),
    "LIMO differential": Lidar(720, -2.094395, 2.094395, 0.05, 8.0),
    "Summit XL": Lidar(1081, -2.3562, 2.3562, 0.06, 20.0),
    "Kobuki (ROS 2)": Lidar(50, -0.0436, 0.0436, 0.01, 0.15),
    "TortoiseBot": Lidar(720, -3.14159, 3.14159, 0.05, 20.0),
    "Stretch RE1 (Gazebo)": Lidar(2000, -0.9, 5.0, 0.15, 12.0),
    "TurtleBot3 with OpenMANIPULATOR": Lidar(360, 0.0, 6.28319, 0.12, 3.5),
    "articubot_one": Lidar(360, -3.14, 3.14, 0.3, 12.0),
    "DiffBot (ros-mobile-robots)": Lidar(360, -3.1415, 3.1415, 0.12, 12.0),
    "DeepRacer": Lidar(600, -2.61799, 2.61799, 0.15, 10.0),
    "MIT racecar": Lidar(1081, -2.356194, 2.356194, 0.1, 10.0),
    "Prius": Lidar(640, -2.26889, 2.2689, 0.2, 30.0),
    "Dolly (Gazebo Classic)": Lidar(200, -1.0, 1.0, 0.05, 10.0),
    "CAT Vehicle": Lidar(180, -1.57, 1.57, 1.5, 80.0),
    "NeuronBot 2": Lidar(360, -3.14, 3.14, 0.2, 10.0),
    "box_bot (course)": Lidar(200, -3.14, 3.14, 0.1, 5.0),
    "turtlebot (Gazebo model)": Lidar(180, -2.268928, 2.268928, 0.08, 10.0),
    "box_bot_lidar": Lidar(360, -math.pi, math.pi - math.pi / 180.0, 0.06, 10.0),
    "nearly blind": Lidar(90, -math.pi, math.pi, 2.5, 3.0),
    "without noise": Lidar(360, -math.pi, math.pi - math.pi / 180.0, 0.1, 8.0, stddev=0.0),
}
"""The lidars of public robots, with their numbers, and some of ours."""


def a_room() -> Model:
    """Four walls of 1 m."""
    ends = Shape("box", (1.0, 20.0, 5.0))
    sides = Shape("box", (20.0, 1.0, 5.0))
    walls = [
        *(_moved(ends, x=side * (HALF_LENGTH_M + 0.5)) for side in (-1.0, 1.0)),
        *(_moved(sides, y=side * (HALF_WIDTH_M + 0.5)) for side in (-1.0, 1.0)),
    ]
    return Model("room", (Link("base", collisions=tuple(walls)),), is_static=True)


def _moved(shape: Shape, x: float = 0.0, y: float = 0.0) -> Shape:
    return msgspec.structs.replace(shape, origin=Origin((x, y, 0.0)))


def read_lidar(lidar: Lidar) -> Sensor:
    """Read the lidar from a description, and put it in the middle of a robot."""
    text = a_sensor(
        "ray",
        f"""<update_rate>10</update_rate><ray>
        <scan><horizontal><samples>{lidar.samples}</samples><min_angle>{lidar.min_angle!r}</min_angle>
        <max_angle>{lidar.max_angle!r}</max_angle></horizontal></scan>
        <range><min>{lidar.range_min}</min><max>{lidar.range_max}</max></range>
        <noise><type>gaussian</type><stddev>{lidar.stddev}</stddev></noise></ray>""",
    )
    return msgspec.structs.replace(
        the_sensor(text), link="base", frame="base", frame_id="base", origin=Origin()
    )


def find_true_ranges(scan: LaserScan) -> FloatArray:
    angles = find_ray_angles(scan)
    with np.errstate(divide="ignore"):
        ends = HALF_LENGTH_M / np.abs(np.cos(angles))
        sides = HALF_WIDTH_M / np.abs(np.sin(angles))
    return np.minimum(ends, sides)


@pytest.fixture(params=LIDARS)
def given(request: pytest.FixtureRequest) -> tuple[Lidar, LaserScan]:
    """A lidar and its scan in the middle of the room."""
    lidar = LIDARS[request.param]
    world = SensedWorld()
    world.spawn("room", a_room(), at(0.0))
    world.spawn("r1", a_robot(read_lidar(lidar)), at(0.0))
    world.start("s1")
    heard = world.listen("r1/scan")
    world.step_to(STEP)
    ((_, scan),) = scans_of(heard)
    return lidar, scan


def test_slam_toolbox_accepts_the_count_of_readings(given: tuple[Lidar, LaserScan]) -> None:
    lidar, scan = given

    assert len(scan.ranges) == lidar.samples
    assert count_expected_readings(scan) == lidar.samples


def test_amcl_uses_each_ray_that_hits_and_no_other(given: tuple[Lidar, LaserScan]) -> None:
    lidar, scan = given
    exact, margin = find_true_ranges(scan), SIGMAS * lidar.stddev + FLOAT32_ERROR_M

    hits = find_amcl_hits(scan)

    is_hit = np.isfinite(hits)
    is_inside = (exact > lidar.range_min + margin) & (exact < lidar.range_max - margin)
    is_outside = (exact < lidar.range_min - margin) | (exact > lidar.range_max + margin)
    assert is_hit[is_inside].all()
    assert not is_hit[is_outside].any()
    assert np.abs(hits - exact)[is_hit].max(initial=0.0) <= margin


def test_costmaps_mark_the_walls_only(given: tuple[Lidar, LaserScan]) -> None:
    lidar, scan = given
    angles, margin = find_ray_angles(scan), SIGMAS * lidar.stddev + FLOAT32_ERROR_M

    marks = find_costmap_marks(scan)

    x, y = np.abs(marks * np.cos(angles)), np.abs(marks * np.sin(angles))
    off = np.minimum(np.abs(x - HALF_LENGTH_M), np.abs(y - HALF_WIDTH_M))
    assert off[np.isfinite(marks)].max(initial=0.0) <= margin


def test_costmaps_clear_nothing_behind_the_walls(given: tuple[Lidar, LaserScan]) -> None:
    lidar, scan = given
    margin = SIGMAS * lidar.stddev + FLOAT32_ERROR_M

    cleared = find_costmap_clearings(scan)

    used = np.isfinite(cleared)
    assert (cleared[used] <= find_true_ranges(scan)[used] + margin).all()


def test_readings_are_in_the_limits_or_infinite(given: tuple[Lidar, LaserScan]) -> None:
    lidar, scan = given
    ranges = np.array(scan.ranges, dtype=np.float32)
    least, most = np.float32(lidar.range_min), np.float32(lidar.range_max)

    finite = ranges[np.isfinite(ranges)]

    assert not np.isnan(ranges).any()
    assert ((finite >= least) & (finite <= most)).all()
