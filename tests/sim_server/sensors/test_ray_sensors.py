"""Scans of a room as each type of message, with the limits of REP 117 and those of Gazebo."""

import math

import msgspec
import numpy as np
import pytest

from tests.sim_server.sensors.sensed_worlds import NOISE, SensedWorld, a_lidar, a_robot, a_wall, at
from zensim.proto.codec.message_codec import decode
from zensim.proto.memory_bus import MemorySubscription
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Sensor, Shape
from zensim.proto.messages.sensor_messages import RaySensor, ScanAxis, SensorTopic
from zensim.proto.messages.standard_messages import LaserScan, PointCloud, PointCloud2, Range


def from_yaw(yaw: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)


FAN = ScanAxis(3, -math.pi / 4, math.pi / 4)
WALL_M = 2.0


def sense(sensor: Sensor, *, x: float = 0.0, step: int = 24) -> MemorySubscription:
    """Measure once before a wall that is 2 m ahead of x = 0."""
    world = SensedWorld()
    world.spawn("wall", a_wall(WALL_M), at(0.0))
    world.spawn("r1", a_robot(sensor), at(x))
    world.start("s1")
    heard = world.listen("r1/**")
    world.step_to(step)
    return heard


def a_sensor(topic: str, **changes: object) -> Sensor:
    settings = RaySensor(FAN, range_min_m=0.1, range_max_m=5.0)
    sensor = msgspec.structs.replace(a_lidar(), topics=(SensorTopic(topic, topic),))
    compat = changes.pop("compat", "fixed")
    given = msgspec.structs.replace(settings, **changes)
    return msgspec.structs.replace(sensor, settings=given, compat=compat)


def read_scan(sensor: Sensor, *, x: float = 0.0) -> LaserScan:
    (sample,) = sense(sensor, x=x).take()
    return decode(LaserScan, sample.payload, sample.encoding)


def read_range(sensor: Sensor, *, x: float = 0.0) -> Range:
    (sample,) = sense(sensor, x=x).take()
    return decode(Range, sample.payload, sample.encoding)


def test_scan_has_the_angles_of_its_rays() -> None:
    scan = read_scan(a_sensor("scan"))

    assert scan.angle_min == pytest.approx(-math.pi / 4)
    assert scan.angle_max == pytest.approx(math.pi / 4)
    assert scan.angle_increment == pytest.approx(math.pi / 4)
    assert scan.ranges == pytest.approx((WALL_M * math.sqrt(2.0), WALL_M, WALL_M * math.sqrt(2.0)))
    assert (scan.time_increment, scan.scan_time, scan.intensities) == (0.0, 0.0, ())


def test_ranges_beyond_the_limits_are_infinite() -> None:
    near = read_scan(a_sensor("scan"), x=1.95)
    far = read_scan(a_sensor("scan"), x=-4.0)

    assert near.ranges[1] == -math.inf
    assert far.ranges == (math.inf,) * 3


def test_noise_never_leaves_the_limits() -> None:
    noise = msgspec.structs.replace(NOISE, stddev=5.0)

    scan = read_scan(a_sensor("scan", noise=noise))

    assert all(0.1 <= one <= 5.0 + 1e-6 for one in scan.ranges)
    assert scan.ranges[1] != WALL_M


def test_intensities_of_gazebo_are_the_least_one() -> None:
    gazebo = a_sensor("scan", compat="gazebo11")
    bright = a_sensor("scan", compat="gazebo11", min_intensity=0.5)

    assert read_scan(gazebo).intensities == (0.0,) * 3
    assert read_scan(bright).intensities == (0.5,) * 3


def test_single_ray_has_no_increment() -> None:
    one_ray = ScanAxis(1, 0.0, 0.0)

    fixed = read_scan(a_sensor("scan", horizontal=one_ray))
    gazebo = read_scan(a_sensor("scan", horizontal=one_ray, compat="gazebo11"))

    assert (fixed.angle_min, fixed.angle_max, fixed.angle_increment) == (0.0, 0.0, 0.0)
    assert math.isnan(gazebo.angle_increment)
    assert len(fixed.ranges) == 1


def test_scan_of_several_rows_is_the_middle_row() -> None:
    rows = ScanAxis(3, -0.4, 0.4)

    assert read_scan(a_sensor("scan", vertical=rows)).ranges[1] == pytest.approx(WALL_M)


def test_range_is_the_least_of_all_rays() -> None:
    found = read_range(a_sensor("range", vertical=ScanAxis(2, 0.0, 0.2), radiation_type=0))

    assert found.range == pytest.approx(WALL_M)
    assert found.field_of_view == pytest.approx(math.pi / 2)
    assert found.radiation_type == 0
    assert found.min_range == pytest.approx(0.1)


def test_range_of_nothing_is_infinite_or_that_of_gazebo() -> None:
    fixed = read_range(a_sensor("range"), x=-9.0)
    gazebo = read_range(a_sensor("range", compat="gazebo11"), x=-9.0)

    assert fixed.range == math.inf
    assert gazebo.range == pytest.approx(3.4028235e38)


def test_points_are_finite_and_in_the_axes_of_the_sensor() -> None:
    (sample,) = sense(a_sensor("points", range_max_m=2.5)).take()
    cloud = decode(PointCloud2, sample.payload, sample.encoding)

    points = np.frombuffer(cloud.data, "<f4").reshape(-1, 4)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "intensity"]
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, 1, 16, 16)
    assert cloud.is_dense
    assert points.tolist() == [pytest.approx([WALL_M, 0.0, 0.0, 0.0])]


def test_points_have_the_least_intensity() -> None:
    (sample,) = sense(a_sensor("points", min_intensity=5.0)).take()
    cloud = decode(PointCloud2, sample.payload, sample.encoding)

    assert set(np.frombuffer(cloud.data, "<f4")[3::4].tolist()) == {5.0}


def test_points_of_gz_sim_have_a_row_for_each_ring() -> None:
    rows = ScanAxis(3, -math.pi / 8, math.pi / 8)
    sensor = a_sensor("points", vertical=rows, range_max_m=2.5, is_organized=True)
    (sample,) = sense(sensor).take()
    cloud = decode(PointCloud2, sample.payload, sample.encoding)

    layout = np.dtype([("point", "<f4", 4), ("ring", "<u2")])
    points = np.frombuffer(cloud.data, layout).reshape(cloud.height, cloud.width)
    assert [(one.name, one.offset, one.datatype) for one in cloud.fields] == [
        *((name, 4 * number, 7) for number, name in enumerate(("x", "y", "z", "intensity"))),
        ("ring", 16, 4),
    ]
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (3, 3, 18, 54)
    assert not cloud.is_dense
    assert points["ring"].tolist() == [[0] * 3, [1] * 3, [2] * 3]
    assert points["point"][1, 1].tolist() == pytest.approx([WALL_M, 0.0, 0.0, 0.0])
    assert np.isinf(points["point"][1, [0, 2], :2]).all()


def test_point_cloud_has_the_same_points() -> None:
    (sample,) = sense(a_sensor("point_cloud")).take()
    cloud = decode(PointCloud, sample.payload, sample.encoding)

    assert [one.x for one in cloud.points] == pytest.approx([WALL_M] * 3, rel=1e-6)
    assert [one.y for one in cloud.points] == pytest.approx([-WALL_M, 0.0, WALL_M])


def test_both_topics_of_a_lidar_come_from_one_measurement() -> None:
    both = msgspec.structs.replace(
        a_sensor("scan", noise=NOISE),
        topics=(SensorTopic("scan", "scan"), SensorTopic("points", "scan/points")),
    )

    samples = {sample.key: sample for sample in sense(both).take()}

    scan = decode(LaserScan, samples["r1/scan"].payload, samples["r1/scan"].encoding)
    found = samples["r1/scan/points"]
    points = np.frombuffer(decode(PointCloud2, found.payload, found.encoding).data, "<f4")
    lengths = np.linalg.norm(points.reshape(-1, 4)[:, :3], axis=1)
    assert lengths == pytest.approx(scan.ranges, rel=1e-5)


def test_sensor_moves_with_the_joint_that_carries_it() -> None:
    turned = Origin((0.5, 0.0, 0.0), from_yaw(math.pi))
    mast = Joint("mast", "fixed", "base", "head", turned)
    sensor = msgspec.structs.replace(a_sensor("scan"), link="head", frame="head")
    model = Model("r", (Link("base"), Link("head")), (mast,), sensors=(sensor,))
    world = SensedWorld()
    world.spawn("wall", a_wall(WALL_M), at(0.0))
    behind = Shape("box", (0.1, 4.0, 1.0), Origin((-1.05, 0.0, 0.0)))
    world.spawn("back", Model("b", (Link("base", collisions=(behind,)),), is_static=True), at(0.0))
    world.spawn("r1", model, at(0.0))
    world.joints = 1
    world.start("s1")
    heard = world.listen("r1/scan")
    world.step_to(24)

    (sample,) = heard.take()
    assert decode(LaserScan, sample.payload, sample.encoding).ranges[1] == pytest.approx(1.5)
