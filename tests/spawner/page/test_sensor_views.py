"""Sensors on the page: which can be shown, and what their messages show."""

from contextlib import suppress

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.spawner.page.builders import make_models, make_robot, make_sensing_robot, make_snapshot
from zensim.proto.codec.message_codec import Format, MalformedPayload, encode
from zensim.proto.messages.model_messages import Origin, Sensor
from zensim.proto.messages.sensor_messages import SensorTopic
from zensim.proto.messages.standard_messages import Image, LaserScan, PointCloud2, PointField
from zensim.proto.se3 import transform_points
from zensim.spawner.page import sensor_views
from zensim.spawner.page.render_state import find_sensor_pose, make_fleet, make_frame
from zensim.spawner.page.sensor_views import (
    MAX_PICTURE_SIDE,
    MAX_POINTS,
    SensorChoice,
    SensorView,
    list_sensor_views,
    read_picture,
    read_points,
)

LIDAR = SensorView("laser", "scan", "scan", 0, Origin())
CLOUD = SensorView("laser", "points", "points", 0, Origin())
SCAN = LaserScan(angle_min=0.0, angle_increment=np.pi / 2.0, range_min=0.1, range_max=9.0)
XYZ = tuple(PointField(name, 4 * i, sensor_views.FLOAT32, 1) for i, name in enumerate("xyz"))
POINTS = PointCloud2(height=1, fields=XYZ, point_step=16)
IMAGE = Image(height=2, width=2, encoding="rgb8", step=8, data=bytes(range(16)))


def read(view: SensorView, message: msgspec.Struct, **changes: object) -> np.ndarray:
    changed = msgspec.structs.replace(message, **changes)
    return read_points(view, encode(changed, Format.CDR))


def test_lidars_and_cameras_can_be_shown() -> None:
    views = list_sensor_views(make_sensing_robot())

    assert [(view.title, view.topic, view.link) for view in views] == [
        ("laser", "scan", 1),
        ("camera", "camera/image_raw", 0),
    ]
    assert [view.is_picture for view in views] == [False, True]


def test_ranges_become_points_in_the_axes_of_the_sensor() -> None:
    ranges = (1.0, 2.0, float("inf"), float("-inf"), float("nan"), 9.5, 3.0)

    points = read(LIDAR, SCAN, ranges=ranges)

    assert points == pytest.approx(np.array([(1, 0, 0), (0, 2, 0), (-3, 0, 0)]), abs=1e-5)


def test_single_ray_may_have_no_increment() -> None:
    points = read(LIDAR, SCAN, ranges=(1.0,), angle_increment=float("nan"))

    assert points.tolist() == [[1.0, 0.0, 0.0]]


def test_points_of_a_cloud_are_read_by_its_fields() -> None:
    data = np.array([(1, 2, 3, 9), (4, 5, np.nan, 9), (1e30, 0, 0, 0)], dtype="<f4").tobytes()

    points = read(CLOUD, POINTS, width=3, row_step=48, data=data)

    assert points.tolist() == [[1.0, 2.0, 3.0]]


def test_number_of_points_is_limited() -> None:
    many = read(LIDAR, SCAN, ranges=(1.0,) * (MAX_POINTS + 1))

    assert MAX_POINTS / 3 < len(many) <= MAX_POINTS


def test_picture_has_the_pixels_without_padding() -> None:
    picture = read_picture(encode(IMAGE, Format.CDR))

    assert picture.tolist() == [[[0, 1, 2], [3, 4, 5]], [[8, 9, 10], [11, 12, 13]]]


def test_large_picture_is_thinned_out() -> None:
    wide = 2 * MAX_PICTURE_SIDE
    image = Image(height=2, width=wide, encoding="rgb8", step=3 * wide, data=bytes(6 * wide))

    assert read_picture(encode(image, Format.CDR)).shape == (1, MAX_PICTURE_SIDE, 3)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (LIDAR, msgspec.structs.replace(SCAN, ranges=(1.0,), angle_min=float("nan"))),
        (LIDAR, msgspec.structs.replace(SCAN, ranges=(1.0,) * 2, angle_increment=float("inf"))),
        (CLOUD, msgspec.structs.replace(POINTS, width=4, data=b"\0" * 16)),
        (CLOUD, msgspec.structs.replace(POINTS, width=1, data=b"\0" * 16, fields=XYZ[:2])),
        (CLOUD, msgspec.structs.replace(POINTS, width=1, data=b"\0" * 8, point_step=8)),
        (CLOUD, msgspec.structs.replace(POINTS, point_step=0)),
        (LIDAR, msgspec.structs.replace(SCAN, ranges=(1.0,) * 2, angle_min=1e30)),
    ],
)
def test_contradictory_points_are_malformed(view: SensorView, message: msgspec.Struct) -> None:
    with pytest.raises(MalformedPayload):
        read_points(view, encode(message, Format.CDR))


@pytest.mark.parametrize(
    "changes",
    [
        {"encoding": "mono8"},
        {"encoding": "32FC1", "width": 3},
        {"width": 0},
        {"height": 0},
        {"height": 3},
        {"width": 3},
        {"data": b""},
        {"height": 0, "width": 0, "step": 0, "data": b""},
    ],
)
def test_contradictory_picture_is_malformed(changes: dict[str, object]) -> None:
    image = msgspec.structs.replace(IMAGE, **changes)

    with pytest.raises(MalformedPayload):
        read_picture(encode(image, Format.CDR))


def test_depths_become_greys_with_near_ones_white() -> None:
    inf, nan = float("inf"), float("nan")
    depths = np.array([[0.0, 2.0, 4.0], [inf, -inf, nan]], dtype="<f4")
    image = Image(height=2, width=3, encoding="32FC1", step=16, data=pad(depths, 16))

    picture = read_picture(encode(image, Format.CDR))

    assert picture.shape == (2, 3, 3)
    assert picture[:, :, 0].tolist() == [[255, 127, 0], [0, 255, 0]]


def test_depths_of_the_other_byte_order_are_the_same() -> None:
    depths = np.array([[1.0, 2.0]], dtype=">f4")
    image = Image(height=1, width=2, encoding="32FC1", is_bigendian=1, step=8, data=bytes(depths))

    assert read_picture(encode(image, Format.CDR))[0, :, 0].tolist() == [127, 0]


def pad(rows: np.ndarray, step: int) -> bytes:
    """Write rows of an image with padding behind each."""
    return b"".join(row.tobytes().ljust(step, b"\7") for row in rows)


def test_points_of_a_depth_camera_are_in_optical_axes() -> None:
    depth = SensorTopic("depth_points", "camera/points")
    camera = Sensor("camera", "depth", "bot_base", "bot_base", topics=(depth,))
    models = make_models(r1=msgspec.structs.replace(make_robot(), sensors=(camera,)))
    fleet = make_fleet(("r1",), models)
    frame = make_frame(fleet, make_snapshot("r1", joints=1))

    pose = find_sensor_pose(fleet, frame, SensorChoice("r1", "camera/points"))

    ahead = transform_points(pose, np.array([(0.0, 0.0, 2.0)]))
    assert ahead[0].tolist() == pytest.approx([2.0, 0.0, 0.0])


def test_message_that_is_too_large_is_malformed() -> None:
    with pytest.raises(MalformedPayload):
        read_points(LIDAR, bytes(sensor_views.MAX_SCAN_BYTES + 1))
    with pytest.raises(MalformedPayload):
        read_picture(bytes(sensor_views.MAX_ARRAY_BYTES + 1))


NUMBERS = st.one_of(st.floats(), st.sampled_from((0.0, 1e38, 1e308, -1e308)))
SIZES = st.one_of(st.integers(0, 8), st.sampled_from((2**31, 2**32 - 1)))
FIELDS = st.builds(
    PointField, st.sampled_from("xyz"), SIZES, st.sampled_from((sensor_views.FLOAT32, 8)), SIZES
)
HOSTILE_SCANS = st.builds(
    LaserScan,
    angle_min=NUMBERS,
    angle_increment=NUMBERS,
    range_min=NUMBERS,
    range_max=NUMBERS,
    ranges=st.lists(NUMBERS, max_size=4).map(tuple),
)
HOSTILE_CLOUDS = st.builds(
    PointCloud2,
    height=SIZES,
    width=SIZES,
    fields=st.one_of(st.just(XYZ), st.lists(FIELDS, max_size=4).map(tuple)),
    is_bigendian=st.booleans(),
    point_step=st.one_of(SIZES, st.just(16)),
    data=st.sampled_from((0, 16, 64)).flatmap(lambda size: st.binary(min_size=size, max_size=size)),
)
HOSTILE_IMAGES = st.builds(
    Image,
    height=SIZES,
    width=SIZES,
    encoding=st.sampled_from(("rgb8", "32FC1", "")),
    is_bigendian=st.integers(0, 255),
    step=SIZES,
    data=st.binary(max_size=32),
)


@given(scan=HOSTILE_SCANS, cloud=HOSTILE_CLOUDS)
def test_hostile_points_are_read_or_malformed(scan: LaserScan, cloud: PointCloud2) -> None:
    for view, message in ((LIDAR, scan), (CLOUD, cloud)):
        with suppress(MalformedPayload):
            points = read_points(view, encode(message, Format.MSGPACK))
            assert points.shape[1:] == (3,)
            assert np.isfinite(points).all()


@given(HOSTILE_IMAGES)
def test_hostile_pictures_are_read_or_malformed(image: Image) -> None:
    with suppress(MalformedPayload):
        picture = read_picture(encode(image, Format.MSGPACK))
        assert picture.shape[2:] == (3,)
        assert 0 < picture.size <= 3 * MAX_PICTURE_SIDE**2
        assert picture.dtype == np.uint8


@pytest.mark.parametrize("payload", [b"\0\1\0\0", b"{", bytes(7), b"\xff" * 40])
def test_other_bytes_are_malformed(payload: bytes) -> None:
    for view in (LIDAR, CLOUD):
        with pytest.raises(MalformedPayload):
            read_points(view, payload)
    with pytest.raises(MalformedPayload):
        read_picture(payload)


def test_pose_of_a_sensor_is_that_of_its_link() -> None:
    models = make_models(r1=make_sensing_robot(), r2=make_sensing_robot())
    fleet = make_fleet(("r1", "r2"), models)
    frame = make_frame(fleet, make_snapshot("r1", "r2", joints=2))

    pose = find_sensor_pose(fleet, frame, SensorChoice("r2", "scan"))

    assert pose.tolist() == pytest.approx([1.0, 0.05, 0.2, 0.0, 0.0, 0.0, 1.0])
