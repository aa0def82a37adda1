"""Faults of topics: what is published in place of each message."""

import math
import struct

import pytest

from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.fault_messages import TopicFault, TopicFaultKind
from zensim.proto.messages.standard_messages import (
    Header,
    Imu,
    LaserScan,
    Point32,
    PointCloud,
    PointCloud2,
    Range,
    Time,
)
from zensim.proto.topic_faults import TopicFaults

KEY = "r/scan"
PERIOD_NS = 100_000_000


def scan_at(number: int, distance: float = 1.0) -> LaserScan:
    header = Header(stamp=Time(0, number * PERIOD_NS % 10**9), frame_id="lidar")
    return LaserScan(header, -1.0, 1.0, 0.5, ranges=(distance,) * 5)


def publish(kind: TopicFaultKind, count: int, value: float = 0.0, **more: float) -> list[LaserScan]:
    """Scans 0, 1, 2, ... with ranges 1, 2, 3, ... during a fault."""
    faults = TopicFaults()
    fault = TopicFault((KEY,), kind, value, **more)  # type: ignore[arg-type]
    found: list[bytes] = []
    for number in range(count):
        faults.update((fault,), number * PERIOD_NS)
        payload = encode(scan_at(number, number + 1.0), Format.CDR)
        found += faults.change(KEY, LaserScan, payload)
    return [decode(LaserScan, one, Format.CDR.value) for one in found]


def distances(scans: list[LaserScan]) -> list[float]:
    return [scan.ranges[0] for scan in scans]


def stamps(scans: list[LaserScan]) -> list[int]:
    return [scan.header.stamp.nanosec // PERIOD_NS for scan in scans]


def test_without_faults_nothing_changes() -> None:
    faults = TopicFaults()

    assert not faults
    assert not faults.affects(KEY)
    assert list(faults.change(KEY, LaserScan, b"abc")) == [b"abc"]


def test_sensor_that_is_off_publishes_nothing() -> None:
    assert publish("sensor_off", 5) == []


def test_other_topics_are_untouched() -> None:
    faults = TopicFaults()
    faults.update((TopicFault((KEY,), "sensor_off"),), 0)

    assert not faults.affects("r/odom")
    assert list(faults.change("r/odom", LaserScan, b"abc")) == [b"abc"]


def test_stuck_sensor_repeats_its_first_measurement_with_new_stamps() -> None:
    scans = publish("sensor_stuck", 4)

    assert distances(scans) == [1.0] * 4
    assert stamps(scans) == [0, 1, 2, 3]
    assert {scan.header.frame_id for scan in scans} == {"lidar"}


def test_slow_sensor_publishes_every_nth() -> None:
    assert stamps(publish("sensor_slow", 9, 3.0)) == [0, 3, 6]


def test_late_messages_keep_their_stamps_and_order() -> None:
    scans = publish("sensor_delay", 6, 0.2)

    assert stamps(scans) == [0, 1, 2, 3]


def test_lost_messages_are_a_share_and_the_same_again() -> None:
    first, second = (publish("sensor_intermittent", 1000, 0.3) for _ in range(2))

    assert len(first) == pytest.approx(700, abs=50)
    assert first == second


def test_seed_changes_what_is_lost() -> None:
    first, second = (publish("sensor_intermittent", 100, 0.5, seed=seed) for seed in (1, 2))

    assert first != second


def test_noise_has_its_deviation() -> None:
    scans = publish("sensor_noise", 400, 0.1)

    errors = [one - number - 1.0 for number, scan in enumerate(scans) for one in scan.ranges]
    mean = sum(errors) / len(errors)
    assert mean == pytest.approx(0.0, abs=0.01)
    assert math.sqrt(sum(one * one for one in errors) / len(errors)) == pytest.approx(0.1, abs=0.01)


def test_bias_is_added() -> None:
    assert distances(publish("sensor_bias", 3, -0.25)) == [0.75, 1.75, 2.75]


def test_rays_of_a_sector_hit_nothing() -> None:
    (scan,) = publish("sensor_sector", 1, low=-0.6, high=0.1)

    assert scan.ranges == (1.0, math.inf, math.inf, 1.0, 1.0)


@pytest.mark.parametrize(
    ("low", "high", "blind"),
    [
        (5.7, 7.2, (False, True, True, True, False)),
        (-0.6 - math.tau, 0.1 - math.tau, (False, True, True, False, False)),
        (0.4, -0.4, (True, True, False, True, True)),
        (1.0, 8.0, (True, True, True, True, True)),
    ],
)
def test_sector_is_that_of_the_same_angles_of_another_turn(
    low: float, high: float, blind: tuple[bool, ...]
) -> None:
    (scan,) = publish("sensor_sector", 1, low=low, high=high)

    assert tuple(one == math.inf for one in scan.ranges) == blind


def test_equal_faults_of_a_time_draw_numbers_of_their_own() -> None:
    faults, fault = TopicFaults(), TopicFault((KEY,), "sensor_noise", 0.1)
    lossy = TopicFault((KEY,), "sensor_intermittent", 0.5)
    errors = []
    for number in range(800):
        faults.update((fault, fault, lossy), number * PERIOD_NS)
        payload = encode(scan_at(number, 1.0), Format.CDR)
        for one in faults.change(KEY, LaserScan, payload):
            errors += [value - 1.0 for value in decode(LaserScan, one, Format.CDR.value).ranges[:2]]

    assert len(errors) == pytest.approx(800, abs=80)
    assert sum(errors) / len(errors) == pytest.approx(0.0, abs=0.02)
    spread = math.sqrt(sum(one * one for one in errors) / len(errors))
    assert spread == pytest.approx(0.1 * math.sqrt(2.0), abs=0.01)


def test_delay_of_a_period_is_one_though_steps_are_rounded_down() -> None:
    faults, found = TopicFaults(), []
    for number in range(4):
        faults.update((TopicFault((KEY,), "sensor_delay", 0.1),), number * 99_999_996)
        found.append(len(faults.change(KEY, LaserScan, b"abc")))

    assert found == [0, 1, 1, 1]


def points_of(cloud: PointCloud | PointCloud2) -> list[tuple[float, ...]]:
    if isinstance(cloud, PointCloud):
        return [(one.x, one.y, one.z) for one in cloud.points]
    step = cloud.point_step
    return [struct.unpack_from("<fff", cloud.data, step * i) for i in range(cloud.width)]


def a_cloud(kind: str) -> PointCloud | PointCloud2:
    """Two points, ahead and to the left; an organized cloud has a third without a hit."""
    places = [(2.0, 0.0, 0.0), (0.0, 4.0, 0.0)]
    if kind == "old":
        return PointCloud(points=tuple(Point32(*one) for one in places))
    if kind == "organized":
        places.append((-math.inf, math.nan, math.nan))
    data = b"".join(struct.pack("<ffff", *one, 7.0) for one in places)
    return PointCloud2(
        height=1, width=len(places), point_step=16, data=data, is_dense=kind == "dense"
    )


@pytest.mark.parametrize("kind", ["dense", "organized", "old"])
def test_ranges_of_points_change(kind: str) -> None:
    cloud = a_cloud(kind)
    faults = TopicFaults()
    faults.update((TopicFault((KEY,), "sensor_bias", 0.5),), 0)

    (changed,) = faults.change(KEY, type(cloud), encode(cloud, Format.CDR))

    found = points_of(decode(type(cloud), changed, Format.CDR.value))
    assert found[:2] == [(2.5, 0.0, 0.0), (0.0, 4.5, 0.0)]
    assert len(found) == (3 if kind == "organized" else 2)


@pytest.mark.parametrize("kind", ["dense", "organized", "old"])
def test_points_of_a_sector_are_no_hits(kind: str) -> None:
    cloud = a_cloud(kind)
    faults = TopicFaults()
    faults.update((TopicFault((KEY,), "sensor_sector", low=-0.5, high=0.5),), 0)

    (changed,) = faults.change(KEY, type(cloud), encode(cloud, Format.CDR))

    found = points_of(decode(type(cloud), changed, Format.CDR.value))
    assert [one for one in found if math.isfinite(one[0])] == [(0.0, 4.0, 0.0)]
    assert len(found) == (3 if kind == "organized" else 1)


def test_noise_and_bias_act_on_imu_and_range() -> None:
    faults = TopicFaults()
    faults.update((TopicFault((KEY,), "sensor_bias", 0.5),), 0)

    imu, distance = (
        decode(kind, faults.change(KEY, kind, encode(kind(), Format.CDR))[0], Format.CDR.value)
        for kind in (Imu, Range)
    )

    assert isinstance(imu, Imu)
    assert isinstance(distance, Range)
    assert (imu.angular_velocity.z, imu.linear_acceleration.x, distance.range) == (0.5, 0.5, 0.5)


def test_fault_that_goes_on_keeps_its_state_when_another_starts() -> None:
    faults = TopicFaults()
    stuck, other = TopicFault((KEY,), "sensor_stuck"), TopicFault(("r/imu",), "sensor_off")
    faults.update((stuck,), 0)
    faults.change(KEY, LaserScan, encode(scan_at(0, 1.0), Format.CDR))

    faults.update((stuck, other), PERIOD_NS)
    (found,) = faults.change(KEY, LaserScan, encode(scan_at(1, 2.0), Format.CDR))

    assert decode(LaserScan, found, Format.CDR.value).ranges[0] == 1.0


def test_next_fault_of_a_kind_begins_anew() -> None:
    faults = TopicFaults()
    for start, distance in ((0, 1.0), (1, 2.0)):
        faults.update((TopicFault((KEY,), "sensor_stuck", start_ns=start),), start)
        (found,) = faults.change(KEY, LaserScan, encode(scan_at(0, distance), Format.CDR))
        assert decode(LaserScan, found, Format.CDR.value).ranges[0] == distance
