"""Sensors on the page: which can be shown, and what their messages show."""

import msgspec
import numpy as np
import pytest

from tests.spawner.page.builders import make_models, make_sensing_robot, make_snapshot
from zensim.proto.codec.message_codec import Format, MalformedPayload, encode
from zensim.proto.messages.model_messages import Origin
from zensim.proto.messages.standard_messages import Image, LaserScan, PointCloud2, PointField
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
    ],
)
def test_contradictory_points_are_malformed(view: SensorView, message: msgspec.Struct) -> None:
    with pytest.raises(MalformedPayload):
        read_points(view, encode(message, Format.CDR))


@pytest.mark.parametrize(
    "changes",
    [
        {"encoding": "32FC1"},
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
