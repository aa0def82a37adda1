"""Cameras publish pictures, depth, points, labels and calibration of what they see."""

import io
from hashlib import sha256
from typing import TypeVar

import msgspec
import numpy as np
import pytest
from PIL import Image as Picture

from tests.sim_server.sensors.sensed_worlds import STEP_NS, WORLD, SensedWorld, a_robot, at
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode
from zensim.proto.messages.model_messages import Link, Model, Origin, Sensor, Shape, Texture
from zensim.proto.messages.sensor_messages import CameraSensor, Noise, SensorTopic
from zensim.proto.messages.standard_messages import (
    CameraInfo,
    CompressedImage,
    Empty,
    Image,
    PointCloud2,
    time_from_ns,
)
from zensim.proto.sensor_libraries import Library, parse_missing
from zensim.proto.stl import write_corners
from zensim.sim_server.sensors import sensor_process
from zensim.sim_server.sensors.camera_sensors import make_camera_info

Message = TypeVar("Message", bound=msgspec.Struct)
RED = (1.0, 0.0, 0.0, 1.0)
CAMERA = CameraSensor(
    "rgbd", width=80, height=60, near_m=0.15, far_m=50.0, min_depth_m=0.5, max_depth_m=10.0
)
TOPICS = {
    "image_raw": "eye/image_raw",
    "image_compressed": "eye/image_raw/compressed",
    "camera_info": "eye/camera_info",
    "depth_image": "eye/depth/image_raw",
    "depth_camera_info": "eye/depth/camera_info",
    "depth_points": "eye/points",
    "labels": "eye/labels",
}


def a_camera(**settings: object) -> Sensor:
    return Sensor(
        "eye",
        "depth",
        "base",
        "base",
        update_rate_hz=10.0,
        settings=msgspec.structs.replace(CAMERA, **settings),
        topics=tuple(SensorTopic(topic, name) for topic, name in TOPICS.items()),
        frame_id="eye_optical",
    )


def a_target(size_m: float) -> Model:
    cube = Shape("box", (1.0, size_m, size_m), Origin((0.5, 0.0, 0.0)), rgba=RED)
    return Model("target", (Link("base", visuals=(cube,)),), is_static=True)


def a_world(camera: Sensor) -> SensedWorld:
    """A robot before a red cube, whose front is 3 m away."""
    world = SensedWorld()
    world.spawn("target", a_target(1.0), at(3.0))
    world.spawn("r1", a_robot(camera), at(0.0))
    return world


def see(world: SensedWorld, name: str, kind: type[Message], step: int = 24) -> Message:
    world.start("s1")
    heard = world.listen(f"r1/{TOPICS[name]}")
    world.step_to(step)
    (sample,) = heard.take()
    return decode(kind, sample.payload, sample.encoding)


def test_picture_shows_the_colour_of_what_is_ahead() -> None:
    image = see(a_world(a_camera()), "image_raw", Image)

    pixels = np.frombuffer(image.data, np.uint8).reshape(60, 80, 3)
    assert (image.height, image.width, image.step, image.encoding) == (60, 80, 240, "rgb8")
    assert image.header.frame_id == "eye_optical"
    assert image.header.stamp == time_from_ns(24 * STEP_NS)
    assert pixels[30, 40, 0] > 40
    assert pixels[30, 40, 1:].tolist() == [0, 0]
    assert (pixels[0, 0] > 100).all()


def add_asset(world: SensedWorld, data: bytes) -> str:
    name = sha256(data).hexdigest()
    world.assets[name] = data
    return name


def a_textured_world(picture: bytes) -> SensedWorld:
    """A robot before a white triangle with a picture, 3 m away."""
    world = SensedWorld()
    corners = np.array([[[0.0, 9.0, -9.0], [0.0, -9.0, -9.0], [0.0, 0.0, 9.0]]])
    places = np.zeros((3, 2), "<f4").tobytes()
    texture = Texture(add_asset(world, picture), add_asset(world, places))
    mesh = add_asset(world, write_corners(corners))
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh=mesh, rgba=(1.0, 1.0, 1.0, 1.0), texture=texture)
    world.spawn("target", Model("target", (Link("base", visuals=(shape,)),)), at(3.0))
    world.spawn("r1", a_robot(a_camera()), at(0.0))
    return world


def write_green_png() -> bytes:
    file = io.BytesIO()
    Picture.new("RGB", (4, 4), (0, 255, 0)).save(file, "PNG")
    return file.getvalue()


@pytest.mark.parametrize(
    ("picture", "is_green"), [(write_green_png(), True), (b"no picture", False)]
)
def test_texture_is_fetched_and_seen_if_it_can_be_read(picture: bytes, is_green: object) -> None:
    image = see(a_textured_world(picture), "image_raw", Image)

    red, green, _ = np.frombuffer(image.data, np.uint8).reshape(60, 80, 3)[30, 40].tolist()
    assert green > 40
    assert (red == 0) == is_green


def test_triggered_camera_measures_once_for_a_trigger() -> None:
    camera = a_camera(is_triggered=True)
    trigger = SensorTopic("image_trigger", "eye/image_trigger")
    world = a_world(msgspec.structs.replace(camera, topics=(*camera.topics, trigger)))
    world.start("s1")
    seen = world.listen(f"r1/{TOPICS['image_raw']}")
    stamps = []
    for step in range(24, 24 * 7, 24):
        if step in (48, 96):
            world.bus.put_message("r1/eye/image_trigger", Empty(), Format.CDR)
        world.step_to(step)
        images = [decode(Image, one.payload, one.encoding) for one in seen.take()]
        stamps += [image.header.stamp for image in images]

    assert stamps == [time_from_ns(step * STEP_NS) for step in (48, 96)]


def test_triggers_without_a_subscriber_are_dropped() -> None:
    camera = a_camera(is_triggered=True)
    trigger = SensorTopic("image_trigger", "eye/image_trigger")
    world = a_world(msgspec.structs.replace(camera, topics=(*camera.topics, trigger)))
    world.start("s1", is_always_on=True)
    world.bus.put_message("r1/eye/image_trigger", Empty(), Format.CDR)
    world.step_to(24)

    seen = world.listen(f"r1/{TOPICS['image_raw']}")
    world.step_to(48)

    assert seen.take() == []


def test_compressed_picture_is_nearly_the_same() -> None:
    compressed = see(a_world(a_camera()), "image_compressed", CompressedImage)

    pixels = np.asarray(Picture.open(io.BytesIO(compressed.data)))
    raw = see(a_world(a_camera()), "image_raw", Image)
    expected = np.frombuffer(raw.data, np.uint8).reshape(60, 80, 3)
    assert compressed.format == "jpeg"
    assert np.abs(pixels.astype(int) - expected.astype(int)).mean() < 3.0


@pytest.mark.parametrize(
    ("limits", "expected"), [((0.5, 10.0), 3.0), ((3.5, 10.0), -np.inf), ((0.5, 2.5), np.inf)]
)
def test_depth_is_the_distance_within_its_limits(
    limits: tuple[float, float], expected: float
) -> None:
    camera = a_camera(min_depth_m=limits[0], max_depth_m=limits[1])

    image = see(a_world(camera), "depth_image", Image)

    depth = np.frombuffer(image.data, "<f4").reshape(60, 80)
    assert (image.encoding, image.step) == ("32FC1", 320)
    assert depth[30, 40] == pytest.approx(expected, abs=1e-5)
    assert depth[0, 0] == np.inf


def test_points_are_in_optical_axes_with_colours() -> None:
    cloud = see(a_world(a_camera()), "depth_points", PointCloud2)

    points = np.frombuffer(cloud.data, "<f4").reshape(60, 80, 4)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "rgb"]
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (60, 80, 16, 1280)
    assert points[30, 40, :3] == pytest.approx([0.0, 0.0, 3.0], abs=1e-5)
    assert points[30, 44, 0] > 0.0
    assert points[34, 40, 1] > 0.0
    assert np.isnan(points[0, 0, :3]).all()
    assert points[30, 40].view("<u4")[3] >> 16 > 40


def test_labels_are_indices_of_entities() -> None:
    image = see(a_world(a_camera()), "labels", Image)

    labels = np.frombuffer(image.data, "<i4").reshape(60, 80)
    assert image.encoding == "32SC1"
    assert (labels[30, 40], labels[0, 0]) == (0, -1)


@pytest.mark.parametrize("topic", ["camera_info", "depth_camera_info"])
def test_camera_info_is_that_of_a_pinhole(topic: str) -> None:
    info = see(a_world(a_camera(stereo_baseline_m=0.1)), topic, CameraInfo)

    focal = 40.0 / np.tan(1.047 / 2.0)
    assert (info.height, info.width, info.distortion_model) == (60, 80, "plumb_bob")
    assert info.k == pytest.approx((focal, 0, 40.0, 0, focal, 30.0, 0, 0, 1))
    assert info.p[3] == pytest.approx(-0.1 * focal)
    assert info.header.stamp == time_from_ns(24 * STEP_NS)


def test_principal_point_of_gazebo_classic_is_half_a_pixel_further() -> None:
    assert make_camera_info(CAMERA, "gazebo11").k[2] == 40.5


def test_noise_is_the_same_at_the_same_step_and_other_at_another() -> None:
    camera = a_camera(noise=Noise("gaussian", stddev=0.02))
    plain = see(a_world(a_camera()), "image_raw", Image).data

    first, again = (see(a_world(camera), "image_raw", Image).data for _ in range(2))
    later = see(a_world(camera), "image_raw", Image, step=48).data

    assert first == again
    assert first not in (plain, later)
    difference = np.frombuffer(first, np.uint8).astype(float) - np.frombuffer(plain, np.uint8)
    assert 3.0 < difference.std() < 6.0


def test_only_topics_with_listeners_are_published() -> None:
    world = a_world(a_camera())
    world.start("s1")
    heard = world.listen(f"r1/{TOPICS['labels']}")
    world.run(0.3)
    world.step_to(24)
    everything = world.bus.subscribe("r1/**", 100)

    world.step_to(48)

    assert len(heard.take()) == 2
    assert {sample.key for sample in everything.take()} >= {f"r1/{TOPICS['labels']}"}


NO_OPENGL: dict[Library, str] = {"opengl": "moderngl is not installed"}
NOTHING: dict[Library, str] = {**NO_OPENGL, "embree": "embreex is not installed"}


def lack(monkeypatch: pytest.MonkeyPatch, missing: dict[Library, str]) -> None:
    """Let the processes that start from now on be on a host that lacks libraries."""
    monkeypatch.setattr(sensor_process, "find_missing_libraries", lambda: dict(missing))


def test_cameras_have_no_topics_where_no_image_can_be_made(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    lack(monkeypatch, NOTHING)
    world = a_world(a_camera())

    stats = world.start("s1", is_always_on=True).make_stats()
    heard = world.listen("r1/**")
    world.step_to(24)

    assert heard.take() == []
    assert "sensor.no_renderer" in caplog.text
    assert stats.missing == NOTHING
    (eye,) = stats.sensors
    assert (eye.sensor, eye.is_measured) == ("eye", False)
    assert eye.fault.startswith("sensor.no_renderer: ")


def test_camera_without_opengl_is_reported_as_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    lack(monkeypatch, NO_OPENGL)

    (eye,) = a_world(a_camera()).start("s1").make_stats().sensors

    assert eye.is_measured
    assert eye.fault.startswith("sensor.slow_renderer: ")


@pytest.mark.parametrize("names", [("able", "bare"), ("x_able", "bare")])
def test_camera_is_measured_by_the_process_that_can(
    monkeypatch: pytest.MonkeyPatch, names: tuple[str, str]
) -> None:
    world = a_world(a_camera())
    able, bare = names
    lack(monkeypatch, NOTHING)
    processes = [world.start(bare)]
    monkeypatch.undo()
    processes.append(world.start(able))

    heard = world.listen(f"r1/{TOPICS['labels']}")
    world.step_to(24)

    assert len(heard.take()) == 1
    assert [[one.sensor for one in each.make_stats().sensors] for each in processes] == [
        [],
        ["eye"],
    ]
    world.kill(able)
    world.step_to(48)
    assert [one.is_measured for one in processes[0].make_stats().sensors] == [False]


def test_opengl_that_fails_when_it_is_used_counts_as_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sensor_process, "find_opengl_fault", lambda: "no driver")
    world = a_world(a_camera())

    missing = world.start("s1").make_stats().missing

    assert missing["opengl"] == "no driver"
    lacking = world.bus.list_tokens(keys.sensor_libraries(WORLD, "s1", "*"))
    assert [parse_missing(keys.parse_sensor_libraries(one)[1]) for one in lacking] == [
        frozenset(missing)
    ]
