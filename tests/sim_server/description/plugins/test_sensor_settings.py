"""Settings of each kind of sensor, from SDF and from plug-ins."""

import math
from typing import TypeVar

import msgspec
import pytest

from tests.sim_server.description.plugins.sensor_samples import (
    a_model_with,
    a_sensor,
    a_sensor_plugin,
    the_sensor,
)
from tests.sim_server.description.robots import mentions
from zensim.proto.messages.sensor_messages import (
    NO_NOISE,
    AirPressureSensor,
    AltimeterSensor,
    CameraSensor,
    ImuSensor,
    MagnetometerSensor,
    NavsatSensor,
    Noise,
    RaySensor,
    ScanAxis,
)
from zensim.sim_server.description.plugins.sensor_settings import MAX_RANGE_M

Settings = TypeVar("Settings", bound=msgspec.Struct)
RANGE = "<range><min>0.2</min><max>12</max><resolution>0.01</resolution></range>"
SWEEP = "<min_angle>{}</min_angle><max_angle>{}</max_angle>"
FAN = "<samples>360</samples><resolution>{}</resolution>" + SWEEP.format(-2, 2)
ROWS = f"<vertical><samples>16</samples>{SWEEP.format(-0.3, 0.15)}</vertical>"
ATTRIBUTE = '<noise type="gaussian"><stddev>0.1</stddev><bias_mean>-0.2</bias_mean></noise>'
CHILD = "<noise><type>gaussian</type><stddev>0.1</stddev><bias_mean>-0.2</bias_mean></noise>"
NOISE = Noise(kind="gaussian", stddev=0.1, bias_mean=-0.2)


def settings_of(kind: type[Settings], sensor: str) -> Settings:
    found = the_sensor(sensor).settings
    assert isinstance(found, kind)
    return found


def a_lidar(tag: str = "ray", rows: str = "", more: str = "", resolution: str = "1") -> str:
    fan = FAN.format(resolution)
    scan = f"<scan><horizontal>{fan}</horizontal>{rows}</scan>"
    return f"<{tag}>{scan}{RANGE}{more}</{tag}>"


@pytest.mark.parametrize("tag", ["ray", "lidar"])
@pytest.mark.parametrize("kind", ["ray", "gpu_ray", "lidar", "gpu_lidar"])
def test_ray_and_lidar_are_read_alike(kind: str, tag: str) -> None:
    settings = settings_of(RaySensor, a_sensor(kind, a_lidar(tag)))

    assert settings.horizontal == ScanAxis(360, -2.0, 2.0)
    assert settings.vertical == ScanAxis()
    assert (settings.range_min_m, settings.range_max_m) == (0.2, 12.0)
    assert settings.output == "LaserScan"


def test_number_of_rays_is_samples_times_resolution() -> None:
    settings = settings_of(RaySensor, a_sensor("ray", a_lidar(resolution="0.5")))

    assert settings.horizontal.count == 180


def test_one_ray_points_forward() -> None:
    fan = f"<horizontal><samples>1</samples>{SWEEP.format(-1, 0)}</horizontal>"
    text = a_sensor("ray", f"<ray><scan>{fan}</scan></ray>")

    assert settings_of(RaySensor, text).horizontal == ScanAxis(1, 0.0, 0.0)


def test_angles_in_the_wrong_order_are_exchanged() -> None:
    fan = f"<horizontal><samples>9</samples>{SWEEP.format(1, -1)}</horizontal>"

    model = a_model_with(a_sensor("ray", f"<ray><scan>{fan}</scan></ray>"))

    assert isinstance(found := model.sensors[0].settings, RaySensor)
    assert found.horizontal == ScanAxis(9, -1.0, 1.0)
    assert mentions(model.report, "suspicious", "<ray/scan/horizontal>", "exchanged")


def test_lidar_with_rows_is_a_cloud() -> None:
    settings = settings_of(RaySensor, a_sensor("gpu_lidar", a_lidar("lidar", ROWS)))

    assert settings.vertical == ScanAxis(16, -0.3, 0.15)
    assert settings.output == "PointCloud2"
    assert settings.is_organized


def test_scan_of_rows_is_the_middle_one() -> None:
    plugin = a_sensor_plugin("gazebo_ros_ray_sensor", "<output_type>LaserScan</output_type>")

    settings = settings_of(RaySensor, a_sensor("ray", a_lidar(rows=ROWS), plugin=plugin))

    assert settings.vertical.count == 1
    assert settings.vertical.low_rad == pytest.approx(-0.3 + 8 * 0.45 / 15)


@pytest.mark.parametrize(
    ("tag", "output"),
    [
        ("", "PointCloud2"),
        ("<output_type>sensor_msgs/LaserScan</output_type>", "LaserScan"),
        ("<output_type>PointCloud</output_type>", "PointCloud"),
        ("<output_type>sensor_msgs/Range</output_type>", "Range"),
    ],
)
def test_output_type_is_that_of_the_plugin(tag: str, output: str) -> None:
    plugin = a_sensor_plugin("gazebo_ros_ray_sensor", tag)

    assert settings_of(RaySensor, a_sensor("ray", a_lidar(), plugin=plugin)).output == output


def test_unknown_output_type_leaves_the_sensor_out() -> None:
    plugin = a_sensor_plugin("gazebo_ros_ray_sensor", "<output_type>Hologram</output_type>")

    model = a_model_with(a_sensor("ray", a_lidar(), plugin=plugin))

    assert model.sensors[0].settings is None
    assert mentions(model.report, "suspicious", "'Hologram'", "LaserScan")


@pytest.mark.parametrize(
    ("word", "number"), [("ultrasound", 0), ("infrared", 1), ("ULTRASOUND", 0), ("gamma", 1)]
)
def test_radiation_type_is_read(word: str, number: int) -> None:
    tags = f"<output_type>Range</output_type><radiation_type>{word}</radiation_type>"
    plugin = a_sensor_plugin("gazebo_ros_ray_sensor", tags)

    model = a_model_with(a_sensor("ray", a_lidar(), plugin=plugin))

    assert isinstance(found := model.sensors[0].settings, RaySensor)
    assert found.radiation_type == number
    assert mentions(model.report, "suspicious", "'gamma'") == (word == "gamma")


@pytest.mark.parametrize("noise", [ATTRIBUTE, CHILD], ids=["attribute", "child"])
def test_noise_is_read_in_both_spellings(noise: str) -> None:
    assert settings_of(RaySensor, a_sensor("ray", a_lidar(more=noise))).noise == NOISE
    axes = f"<x>{noise}</x><y>{noise}</y>"
    imu = f"<imu><angular_velocity>{axes}</angular_velocity></imu>"
    assert settings_of(ImuSensor, a_sensor("imu", imu)).angular_velocity == (NOISE, NOISE, NO_NOISE)


def test_walk_of_the_bias_and_steps_are_read() -> None:
    noise = """<noise type="gaussian_quantized"><stddev>0.1</stddev><precision>0.01</precision>
    <dynamic_bias_stddev>0.2</dynamic_bias_stddev>
    <dynamic_bias_correlation_time>400</dynamic_bias_correlation_time></noise>"""

    assert settings_of(RaySensor, a_sensor("ray", a_lidar(more=noise))).noise == Noise(
        kind="gaussian_quantized",
        stddev=0.1,
        precision=0.01,
        dynamic_bias_stddev=0.2,
        dynamic_bias_correlation_time_s=400.0,
    )


@pytest.mark.parametrize(
    ("noise", "shown"),
    [
        ('<noise type="gaussian"><stddev>-0.1</stddev></noise>', "-0.1"),
        ('<noise type="pink"><stddev>0.1</stddev></noise>', "'pink'"),
        ("<noise><stddev>0.1</stddev></noise>", "type"),
        ('<noise type="gaussian"><stddev>inf</stddev></noise>', "inf"),
        ('<noise type="gaussian_quantized"><stddev>0.1</stddev></noise>', "<precision>"),
    ],
)
def test_impossible_noise_is_reported_and_left_out(noise: str, shown: str) -> None:
    model = a_model_with(a_sensor("ray", a_lidar(more=noise)))

    assert isinstance(found := model.sensors[0].settings, RaySensor)
    assert found.noise == NO_NOISE
    assert mentions(model.report, "suspicious", "noise", shown)


def test_noise_of_type_none_is_silent() -> None:
    model = a_model_with(
        a_sensor("ray", a_lidar(more='<noise type="none"><stddev>1</stddev></noise>'))
    )

    assert isinstance(found := model.sensors[0].settings, RaySensor)
    assert found.noise == NO_NOISE
    assert not mentions(model.report, "suspicious", "noise")


def test_infinite_range_is_limited() -> None:
    inside = "<ray><range><min>0.1</min><max>inf</max></range></ray>"

    assert settings_of(RaySensor, a_sensor("ray", inside)).range_max_m == MAX_RANGE_M


def test_range_that_is_missing_is_reported() -> None:
    assert mentions(a_model_with(a_sensor("ray")).report, "suspicious", "<ray/range/max>", "10 m")


def test_sonar_is_a_cone_of_rays() -> None:
    inside = "<sonar><min>0.1</min><max>2</max><radius>0.5</radius></sonar>"

    settings = settings_of(RaySensor, a_sensor("sonar", inside))

    assert (settings.output, settings.radiation_type) == ("Range", 0)
    assert settings.horizontal == settings.vertical
    assert settings.horizontal.high_rad == pytest.approx(math.atan(0.25))


def test_range_finder_of_ros_1_is_read() -> None:
    tags = "<gaussianNoise>0.005</gaussianNoise><radiation>ultrasound</radiation>"
    plugin = a_sensor_plugin("gazebo_ros_range", tags)

    settings = settings_of(RaySensor, a_sensor("ray", a_lidar(), plugin=plugin))

    assert (settings.output, settings.radiation_type) == ("Range", 0)
    assert settings.noise == Noise(kind="gaussian", stddev=0.005)


def test_velodyne_limits_its_range() -> None:
    plugin = a_sensor_plugin(
        "gazebo_ros_velodyne_laser", "<min_range>0.9</min_range><max_range>8</max_range>"
    )

    settings = settings_of(RaySensor, a_sensor("ray", a_lidar(rows=ROWS), plugin=plugin))

    assert settings.output == "PointCloud2"
    assert (settings.range_min_m, settings.range_max_m) == (0.9, 8.0)
    assert not settings.is_organized


LOCAL = (
    "<imu><orientation_reference_frame><localization>{}</localization>"
    "</orientation_reference_frame></imu>"
)


@pytest.mark.parametrize(
    ("inside", "plugin", "reference"),
    [
        ("", "", "spawn"),
        (LOCAL.format("ENU"), "", "world"),
        (LOCAL.format("NED"), "", "world"),
        ("", a_sensor_plugin("gazebo_ros_imu_sensor"), "world"),
        (
            "",
            a_sensor_plugin(
                "gazebo_ros_imu_sensor",
                "<initial_orientation_as_reference>true</initial_orientation_as_reference>",
            ),
            "spawn",
        ),
    ],
)
def test_orientation_is_relative_to_what_gazebo_says(
    inside: str, plugin: str, reference: str
) -> None:
    model = a_model_with(a_sensor("imu", inside, plugin=plugin))

    assert isinstance(found := model.sensors[0].settings, ImuSensor)
    assert found.reference == reference
    assert mentions(model.report, "suspicious", "'NED'") == ("NED" in inside)


def test_orientation_can_be_switched_off() -> None:
    inside = "<imu><enable_orientation>false</enable_orientation></imu>"

    assert not settings_of(ImuSensor, a_sensor("imu", inside)).has_orientation


def test_imu_noise_of_old_sdf_is_for_all_axes() -> None:
    inside = """<imu><noise><type>gaussian</type><rate><stddev>0.1</stddev></rate>
    <accel><stddev>0.2</stddev><bias_mean>0.3</bias_mean></accel></noise></imu>"""

    settings = settings_of(ImuSensor, a_sensor("imu", inside))

    assert settings.angular_velocity == (Noise(kind="gaussian", stddev=0.1),) * 3
    assert settings.linear_acceleration == (Noise(kind="gaussian", stddev=0.2, bias_mean=0.3),) * 3


@pytest.mark.parametrize("kind", ["gps", "navsat"])
def test_navsat_is_read(kind: str) -> None:
    inside = f"""<{kind}><position_sensing><horizontal>{ATTRIBUTE}</horizontal></position_sensing>
    <velocity_sensing><vertical>{ATTRIBUTE}</vertical></velocity_sensing></{kind}>"""

    assert settings_of(NavsatSensor, a_sensor(kind, inside)) == NavsatSensor(
        horizontal_position=NOISE, vertical_velocity=NOISE
    )


def test_altimeter_and_magnetometer_are_read() -> None:
    height = f"<altimeter><vertical_position>{ATTRIBUTE}</vertical_position></altimeter>"
    field = f"<magnetometer><z>{ATTRIBUTE}</z></magnetometer>"

    assert settings_of(AltimeterSensor, a_sensor("altimeter", height)) == AltimeterSensor(NOISE)
    assert settings_of(MagnetometerSensor, a_sensor("magnetometer", field)).field[2] == NOISE


@pytest.mark.parametrize(
    ("altitude", "read"), [("", None), ("<reference_altitude>123</reference_altitude>", 123.0)]
)
def test_air_pressure_is_read(altitude: str, read: float | None) -> None:
    inside = f"<air_pressure>{altitude}<pressure>{ATTRIBUTE}</pressure></air_pressure>"

    settings = settings_of(AirPressureSensor, a_sensor("air_pressure", inside))

    assert settings == AirPressureSensor(NOISE, read)


CAMERA = """<camera><horizontal_fov>1.5</horizontal_fov>
<image><width>640</width><height>480</height><format>R8G8B8</format></image>
<clip><near>0.05</near><far>50</far></clip>
<noise><type>gaussian</type><stddev>0.007</stddev></noise>
<distortion><k1>0.1</k1><p2>0.2</p2></distortion></camera>"""


def test_camera_is_read() -> None:
    assert settings_of(CameraSensor, a_sensor("camera", CAMERA)) == CameraSensor(
        kind="rgb",
        width=640,
        height=480,
        horizontal_fov_rad=1.5,
        near_m=0.05,
        far_m=50.0,
        min_depth_m=0.05,
        max_depth_m=50.0,
        noise=Noise(kind="gaussian", stddev=0.007),
    )


@pytest.mark.parametrize(
    ("kind", "plugin", "shows"),
    [
        ("camera", "", "rgb"),
        ("depth_camera", "", "depth"),
        ("rgbd_camera", "", "rgbd"),
        ("depth", "gazebo_ros_camera", "rgbd"),
        ("depth", "gazebo_ros_openni_kinect", "rgbd"),
        ("depth_camera", "gazebo_ros_camera", "rgbd"),
        ("camera", "gazebo_ros_camera", "rgb"),
    ],
)
def test_kind_of_camera_depends_on_type_and_plugin(kind: str, plugin: str, shows: str) -> None:
    text = a_sensor(kind, CAMERA, plugin=a_sensor_plugin(plugin) if plugin else "")

    assert settings_of(CameraSensor, text).kind == shows


@pytest.mark.parametrize(
    ("width", "height", "is_read"),
    [(1, 1, True), (0, 9, False), (9, 0, False), (4000, 4000, True), (40_000, 40_000, False)],
)
def test_camera_has_at_least_one_pixel_and_not_too_many(
    width: int, height: int, *, is_read: bool
) -> None:
    inside = f"<camera><image><width>{width}</width><height>{height}</height></image></camera>"

    model = a_model_with(a_sensor("camera", inside))

    found = [one.settings for one in model.sensors]
    sizes = [(one.width, one.height) for one in found if isinstance(one, CameraSensor)]
    assert sizes == ([(width, height)] if is_read else [])


def test_wide_angle_camera_shows_what_a_pinhole_can() -> None:
    inside = "<camera><horizontal_fov>6.283</horizontal_fov></camera>"

    model = a_model_with(a_sensor("wideanglecamera", inside))

    assert isinstance(found := model.sensors[0].settings, CameraSensor)
    assert found.horizontal_fov_rad == 2.0
    assert mentions(model.report, "suspicious", "lens", "2 rad")


CUTOFF = "pointCloudCutoff"


@pytest.mark.parametrize(
    ("tags", "low", "high"),
    [
        ("", 0.4, math.inf),
        ("<min_depth>0.1</min_depth><max_depth>9</max_depth>", 0.1, 9.0),
        (f"<{CUTOFF}>1</{CUTOFF}><{CUTOFF}Max>3</{CUTOFF}Max>", 1, 3),
    ],
)  # fmt: skip
def test_limits_of_depth_are_those_of_the_plugin(tags: str, low: float, high: float) -> None:
    plugin = a_sensor_plugin("gazebo_ros_camera", tags)

    settings = settings_of(CameraSensor, a_sensor("depth", CAMERA, plugin=plugin))

    assert (settings.min_depth_m, settings.max_depth_m) == (low, high)


@pytest.mark.parametrize("tag", ["hack_baseline", "hackBaseline"])
def test_baseline_of_stereo_is_read(tag: str) -> None:
    plugin = a_sensor_plugin("gazebo_ros_camera", f"<{tag}>0.07</{tag}>")

    settings = settings_of(CameraSensor, a_sensor("camera", CAMERA, plugin=plugin))

    assert settings.stereo_baseline_m == 0.07
