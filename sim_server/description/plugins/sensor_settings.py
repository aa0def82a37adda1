"""Settings of sensors by kind: rays, inertial units, contacts, navigation, cameras."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import msgspec

from zensim.proto.messages.sensor_messages import (
    NO_NOISE,
    NO_VECTOR_NOISE,
    AirPressureSensor,
    AltimeterSensor,
    CameraKind,
    CameraSensor,
    ContactSensor,
    ImuSensor,
    MagnetometerSensor,
    NavsatSensor,
    Noise,
    NoiseOfVector,
    RaySensor,
    ScanAxis,
    ScanOutput,
    SensorSettings,
)
from zensim.sim_server.description.plugins.sensor_tags import (
    UnusableSensor,
    make_gaussian,
    read_count,
    read_noise,
    read_value,
    read_vector_noise,
)
from zensim.sim_server.description.strict_parsing import quote, read_numbers

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.sim_server.description.plugins.sensor_tags import SensorSource

MAX_RAYS = 1_000_000
"""Rays of one sensor."""
MAX_PIXELS = 16_000_000
"""Pixels of one camera."""
MAX_RANGE_M = 10_000.0
"""Largest range, also in place of an infinite one."""
MAX_SWEEP_RAD = 4.0 * math.pi
DEFAULT_SAMPLES = 640
"""Samples of `<horizontal>`. Source: SDF 1.12."""
DEFAULT_RANGE_MAX_M = 10.0
RADIATION_TYPES = {"ultrasound": 0, "infrared": 1}
OUTPUTS: dict[str, ScanOutput] = {
    f"{package}{name}": name
    for package in ("", "sensor_msgs/")
    for name in ("LaserScan", "PointCloud2", "PointCloud", "Range")
}
RANGE_FINDERS = ("gazebo_ros_range", "hector_gazebo_ros_sonar")
CLOUD_SCANNERS = ("gazebo_ros_velodyne",)
OLD_CLOUD_SCANNERS = ("gazebo_ros_block_laser",)
TRIGGERED_CAMERA = "gazebo_ros_triggered"
PLANAR_SCANNERS = ("gazebo_ros_laser", "gazebo_ros_gpu_laser")
SONAR_ROWS = 9
"""Rays along each axis of a cone."""
ENU = "ENU"
CAMERA_KINDS: dict[str, CameraKind] = {
    "camera": "rgb",
    "multicamera": "rgb",
    "wideanglecamera": "rgb",
    "wideangle_camera": "rgb",
    "depth": "rgbd",
    "depth_camera": "depth",
    "rgbd": "rgbd",
    "rgbd_camera": "rgbd",
}
RGB_FORMATS = ("R8G8B8", "RGB_INT8", "B8G8R8", "BGR_INT8")
MAX_PINHOLE_RAD = 2.0
"""Field of view of a camera whose lens shows more than a pinhole can."""
DEFAULT_MIN_DEPTH_M = 0.4
"""Least depth of the plug-ins of gazebo_ros."""
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
PLUGIN_DISTORTION = (
    ("distortionK1", "distortion_k1"),
    ("distortionK2", "distortion_k2"),
    ("distortionT1", "distortion_t1"),
    ("distortionT2", "distortion_t2"),
    ("distortionK3", "distortion_k3"),
)


def read_settings(source: SensorSource) -> SensorSettings | None:
    """Read the settings of a sensor; None where its kind is not simulated.

    Raises:
        UnusableSensor: No sensor can have these.
        ModelError: A value is not a number.
    """
    read = READERS.get(source.kind)
    return read(source) if read else None


def read_ray(source: SensorSource) -> RaySensor:
    """Read a <ray> or <lidar>."""
    root = "lidar" if any(path.startswith("lidar/") for path in source.tags.names()) else "ray"
    horizontal = _read_axis(source, f"{root}/scan/horizontal", DEFAULT_SAMPLES)
    vertical = _read_axis(source, f"{root}/scan/vertical", 1)
    if horizontal.count * vertical.count > MAX_RAYS:
        rays = horizontal.count * vertical.count
        raise UnusableSensor(f"{rays:,} rays; use at most {MAX_RAYS:,}")
    nearest, farthest = _read_range(source, f"{root}/range")
    output = _find_output(source, vertical.count)
    if output == "LaserScan":
        vertical = _keep_middle_row(vertical)
    source.tags.text(f"{root}/range/resolution", "")
    noise = read_noise(source.tags, f"{root}/noise")
    return RaySensor(
        horizontal=horizontal,
        vertical=vertical,
        range_min_m=nearest,
        range_max_m=farthest,
        noise=_add_plugin_noise(source, noise),
        output=output,
        radiation_type=_read_radiation(source),
        min_intensity=source.plugin_value("min_intensity"),
        sees_itself=source.tags.flag("sees_itself", default=False),
        is_organized=output == "PointCloud2" and source.plugin is None,
    )


def _read_axis(source: SensorSource, path: str, default: int) -> ScanAxis:
    samples = read_count(source.tags, f"{path}/samples", default)
    resolution = read_value(source.tags, f"{path}/resolution", 1.0)
    low = read_value(source.tags, f"{path}/min_angle", 0.0)
    high = read_value(source.tags, f"{path}/max_angle", 0.0)
    count = samples * resolution
    if not 1.0 <= count <= MAX_RAYS:
        raise UnusableSensor(
            f"<{path}> has {samples:g} samples at resolution {resolution:g}; "
            f"use 1 to {MAX_RAYS:,} rays"
        )
    if not (math.isfinite(low) and math.isfinite(high) and abs(high - low) <= MAX_SWEEP_RAD):
        raise UnusableSensor(f"<{path}> sweeps from {low:g} to {high:g} rad")
    if low > high:
        source.report.suspicious(
            source.tags.label(path),
            f"has min_angle {low:g} > max_angle {high:g}; they are exchanged",
        )
        low, high = high, low
    return ScanAxis() if int(count) == 1 else ScanAxis(int(count), low, high)


def _keep_middle_row(rows: ScanAxis) -> ScanAxis:
    """Keep the row that Gazebo's LaserScan shows."""
    if rows.count == 1:
        return rows
    step = (rows.high_rad - rows.low_rad) / (rows.count - 1)
    middle = rows.low_rad + rows.count // 2 * step
    return ScanAxis(1, middle, middle)


def _read_range(source: SensorSource, path: str) -> tuple[float, float]:
    nearest = read_value(source.tags, f"{path}/min", 0.0)
    farthest = read_value(source.tags, f"{path}/max", 0.0)
    if not source.tags.has(f"{path}/max"):
        source.report.suspicious(
            source.tags.label(f"{path}/max"), f"missing; {DEFAULT_RANGE_MAX_M:g} m is used"
        )
        farthest = DEFAULT_RANGE_MAX_M
    nearest = max(nearest, source.plugin_value("min_range", default=nearest))
    farthest = min(farthest, source.plugin_value("max_range", default=MAX_RANGE_M))
    if not 0.0 <= nearest < farthest:
        raise UnusableSensor(f"ranges from {nearest:g} to {farthest:g} m; use 0 <= min < max")
    return nearest, farthest


def _find_output(source: SensorSource, rows: int) -> ScanOutput:
    filename = source.plugin.filename if source.plugin else ""
    if any(name in filename for name in RANGE_FINDERS):
        return "Range"
    if any(name in filename for name in CLOUD_SCANNERS):
        return "PointCloud2"
    if any(name in filename for name in OLD_CLOUD_SCANNERS):
        return "PointCloud"
    if "gazebo_ros_ray_sensor" not in filename:
        is_planar = any(name in filename for name in PLANAR_SCANNERS)
        return "LaserScan" if rows == 1 or is_planar else "PointCloud2"
    text = source.written("output_type", default="PointCloud2")
    if text in OUTPUTS:
        return OUTPUTS[text]
    raise UnusableSensor(f"<output_type> is {quote(text)}; use one of {', '.join(OUTPUTS)}")


def _read_radiation(source: SensorSource) -> int:
    text = source.written("radiation_type", "radiation", default="infrared")
    if text.lower() not in RADIATION_TYPES:
        source.report.suspicious(
            f"{source.subject}: <radiation_type>",
            f"{quote(text)} is neither ultrasound nor infrared; infrared is used",
        )
    return RADIATION_TYPES.get(text.lower(), 1)


def _add_plugin_noise(source: SensorSource, noise: Noise) -> Noise:
    """Use the noise of a plug-in of ROS 1 where the sensor has none."""
    stddev = source.plugin_value("gaussianNoise", "gaussian_noise")
    return noise if noise != NO_NOISE else make_gaussian(stddev)


def read_sonar(source: SensorSource) -> RaySensor:
    """Read a <sonar>: a cone whose radius is that at its greatest range."""
    nearest = read_value(source.tags, "sonar/min", 0.0)
    farthest = min(read_value(source.tags, "sonar/max", DEFAULT_RANGE_MAX_M), MAX_RANGE_M)
    radius = read_value(source.tags, "sonar/radius", 0.5)
    source.tags.text("sonar/geometry", "")
    if not (0.0 <= nearest < farthest and radius > 0.0):
        raise UnusableSensor(
            f"ranges from {nearest:g} to {farthest:g} m, radius {radius:g} m; "
            "use 0 <= min < max and a radius > 0"
        )
    half = math.atan2(radius, farthest)
    cone = ScanAxis(SONAR_ROWS, -half, half)
    return RaySensor(
        horizontal=cone,
        vertical=cone,
        range_min_m=nearest,
        range_max_m=farthest,
        output="Range",
        radiation_type=RADIATION_TYPES["ultrasound"],
        sees_itself=source.tags.flag("sees_itself", default=False),
    )


def read_imu(source: SensorSource) -> ImuSensor:
    """Read an <imu>, or a plug-in of ROS 1 that is one."""
    rate = read_vector_noise(source.tags, "imu/angular_velocity")
    force = read_vector_noise(source.tags, "imu/linear_acceleration")
    old = _read_old_imu_noise(source)
    return ImuSensor(
        angular_velocity=_choose_noise(
            rate, old[0], _read_plugin_noise(source, "rate", "gaussianNoise", "gaussian_noise")
        ),
        linear_acceleration=_choose_noise(
            force, old[1], _read_plugin_noise(source, "accel", "gaussianNoise", "gaussian_noise")
        ),
        reference=_find_reference(source),
        has_orientation=source.tags.flag("imu/enable_orientation", default=True),
    )


def _read_old_imu_noise(source: SensorSource) -> tuple[NoiseOfVector, NoiseOfVector]:
    """Read <rate> and <accel> of SDF 1.3, one noise for all axes."""
    found = []
    for part in ("rate", "accel"):
        path = f"imu/noise/{part}"
        values = {
            tag: read_value(source.tags, f"{path}/{tag}", 0.0)
            for tag in ("mean", "stddev", "bias_mean", "bias_stddev")
        }
        kind = source.tags.text("imu/noise/type", "")
        is_used = kind == "gaussian" and min(values["stddev"], values["bias_stddev"]) >= 0.0
        noise = Noise(kind="gaussian", **values) if is_used and any(values.values()) else NO_NOISE
        found.append((noise, noise, noise))
    return found[0], found[1]


def _read_plugin_noise(source: SensorSource, quantity: str, *names: str) -> NoiseOfVector:
    """Read the noise of a plug-in of ROS 1; one number, or one per axis."""
    tags = (f"{quantity}GaussianNoise", *names)
    spread = _read_axes(source, *tags)
    offset = _read_axes(source, f"{quantity}Offset")
    drift = _read_axes(source, f"{quantity}Drift")
    frequency = _read_axes(source, f"{quantity}DriftFrequency", default=1.0 / 3600.0)
    x, y, z = map(_make_drifting_noise, spread, offset, drift, frequency)
    return (x, y, z)


def _make_drifting_noise(stddev: float, offset: float, drift: float, frequency: float) -> Noise:
    """Make the noise of hector_gazebo: `drift` is the stationary spread of a random walk."""
    noise = make_gaussian(stddev)
    if offset:
        noise = msgspec.structs.replace(noise, kind="gaussian", bias_mean=offset)
    if drift and frequency > 0.0:
        noise = msgspec.structs.replace(
            noise,
            kind="gaussian",
            dynamic_bias_stddev=abs(drift) * math.sqrt(2.0 * frequency),
            dynamic_bias_correlation_time_s=1.0 / frequency,
        )
    return noise


def _read_axes(
    source: SensorSource, *names: str, default: float = 0.0
) -> tuple[float, float, float]:
    text = source.written(*names)
    if not text:
        return (default, default, default)
    where = f"{source.subject}, {names[0]}"
    numbers = read_numbers(text, counts=(1, 3), where=where, slug="sensor.number")
    x, y, z = numbers * 3 if len(numbers) == 1 else numbers
    return (x, y, z)


def _choose_noise(*given: NoiseOfVector) -> NoiseOfVector:
    return next((one for one in given if one != NO_VECTOR_NOISE), NO_VECTOR_NOISE)


def _find_reference(source: SensorSource) -> Literal["world", "spawn"]:
    """Find what the orientation is relative to: a rule of gazebo_ros, or of gz-sim."""
    if source.plugin is not None and "gazebo_ros" in source.plugin.filename:
        tags = ("initial_orientation_as_reference", "initialOrientationAsReference")
        return "spawn" if source.written(*tags).lower() in ("true", "1") else "world"
    path = "imu/orientation_reference_frame"
    localization = source.tags.text(f"{path}/localization", "")
    for unused in ("custom_rpy", "grav_dir_x"):
        source.tags.text(f"{path}/{unused}", "")
    if localization not in ("", ENU):
        source.report.suspicious(
            source.tags.label(f"{path}/localization"),
            f"{quote(localization)} is not supported; {ENU} is used",
        )
    return "world" if localization else "spawn"


def read_contact(source: SensorSource) -> ContactSensor:
    """Read a <contact>; its collisions are found when meshes are converted."""
    for name in source.tags.texts("contact/collision"):
        source.tags.report.applied(source.tags.label("contact/collision"), quote(name))
    return ContactSensor(names=tuple(source.tags.texts("contact/collision")))


def read_navsat(source: SensorSource) -> NavsatSensor:
    """Read a <navsat> or <gps>, or a plug-in of ROS 1 that is one."""
    root = "navsat" if source.kind == "navsat" else "gps"
    at, speed = f"{root}/position_sensing", f"{root}/velocity_sensing"
    place, motion = _read_gps_noise(source, ""), _read_gps_noise(source, "velocity")
    return NavsatSensor(
        horizontal_position=_first(read_noise(source.tags, f"{at}/horizontal/noise"), place[0]),
        vertical_position=_first(read_noise(source.tags, f"{at}/vertical/noise"), place[1]),
        horizontal_velocity=_first(read_noise(source.tags, f"{speed}/horizontal/noise"), motion[0]),
        vertical_velocity=_first(read_noise(source.tags, f"{speed}/vertical/noise"), motion[1]),
    )


def _read_gps_noise(source: SensorSource, quantity: str) -> tuple[Noise, Noise]:
    """Read the noise of hector_gazebo's GPS: along x and y the greater one, and along z."""
    names = [f"{quantity}{part}" for part in ("GaussianNoise", "Drift", "DriftFrequency")]
    if not quantity:
        names = ["gaussianNoise", "drift", "driftFrequency"]
    spread, drift = _read_axes(source, names[0]), _read_axes(source, names[1])
    frequency = _read_axes(source, names[2], default=1.0 / 3600.0)
    x, y, z = (
        _make_drifting_noise(*values)
        for values in zip(spread, (0.0, 0.0, 0.0), drift, frequency, strict=True)
    )
    return (x if x.stddev >= y.stddev else y), z


def _first(*given: Noise) -> Noise:
    return next((one for one in given if one != NO_NOISE), NO_NOISE)


def read_altimeter(source: SensorSource) -> AltimeterSensor:
    """Read an <altimeter>."""
    return AltimeterSensor(
        vertical_position=read_noise(source.tags, "altimeter/vertical_position/noise"),
        vertical_velocity=read_noise(source.tags, "altimeter/vertical_velocity/noise"),
    )


def read_magnetometer(source: SensorSource) -> MagnetometerSensor:
    """Read a <magnetometer>, or a plug-in of ROS 1 that is one."""
    spread = _read_axes(source, "gaussianNoise")
    x, y, z = map(make_gaussian, spread)
    return MagnetometerSensor(
        field=_choose_noise(read_vector_noise(source.tags, "magnetometer"), (x, y, z))
    )


def read_air_pressure(source: SensorSource) -> AirPressureSensor:
    """Read an <air_pressure>."""
    path = "air_pressure/reference_altitude"
    altitude = read_value(source.tags, path, 0.0)
    return AirPressureSensor(
        pressure=read_noise(source.tags, "air_pressure/pressure/noise"),
        reference_altitude_m=altitude if source.tags.has(path) else None,
    )


def read_camera(source: SensorSource) -> CameraSensor:
    """Read a <camera>."""
    kind = find_camera_kind(source)
    width, height = _read_image_size(source)
    near, far = _read_clip(source)
    fov = _read_fov(source)
    _check_format(source)
    _check_distortion(source)
    min_depth, max_depth = _read_depth_limits(source, near, far)
    return CameraSensor(
        kind=kind,
        width=width,
        height=height,
        horizontal_fov_rad=fov,
        near_m=near,
        far_m=far,
        min_depth_m=min_depth,
        max_depth_m=max_depth,
        noise=read_noise(source.tags, "camera/noise"),
        stereo_baseline_m=_read_baseline(source),
        is_triggered=_read_triggered(source),
    )


def _read_baseline(source: SensorSource) -> float:
    """Read the distance [m] from the left camera of a stereo pair, which has none from itself."""
    baseline = source.plugin_value("hack_baseline", "hackBaseline", "baseline")
    is_left = source.kind == "multicamera" and "left" in source.name.rpartition("/")[2]
    return 0.0 if is_left else baseline


def _read_triggered(source: SensorSource) -> bool:
    is_triggered = source.tags.flag("camera/triggered", default=False)
    if source.plugin is None:
        return is_triggered
    by_plugin = source.plugin.flag("triggered", default=False)
    return is_triggered or by_plugin or TRIGGERED_CAMERA in source.plugin.filename


def _read_fov(source: SensorSource) -> float:
    """Read the horizontal field of view [rad]; what a pinhole cannot show of it is left out."""
    fov = read_value(source.tags, "camera/horizontal_fov", 1.047)
    if source.kind.startswith("wideangle"):
        shown = min(fov, MAX_PINHOLE_RAD)
        source.report.suspicious(
            source.subject, f"its lens is not simulated: a pinhole shows {shown:.3g} rad"
        )
        fov = shown
    if not 0.0 < fov < math.pi:
        raise UnusableSensor(f"<camera/horizontal_fov> is {fov:g} rad; use 0 to 3.14")
    return fov


def find_camera_kind(source: SensorSource) -> CameraKind:
    """Find what a camera shows; the plug-ins of gazebo_ros show colours and depths."""
    if source.kind == "depth_camera" and source.plugin is not None:
        return "rgbd"
    if source.kind == "camera" and source.plugin is not None:
        filename = source.plugin.filename
        if any(name in filename for name in ("depth_camera", "openni_kinect")):
            return "rgbd"
    return CAMERA_KINDS[source.kind]


def _read_image_size(source: SensorSource) -> tuple[int, int]:
    width = read_count(source.tags, "camera/image/width", 320)
    height = read_count(source.tags, "camera/image/height", 240)
    if not (width >= 1.0 and height >= 1.0 and width * height <= MAX_PIXELS):
        raise UnusableSensor(
            f"images of {width:g} x {height:g} pixels; use 1 to {MAX_PIXELS:,} pixels"
        )
    return int(width), int(height)


def _read_clip(source: SensorSource) -> tuple[float, float]:
    near = read_value(source.tags, "camera/clip/near", 0.1)
    far = min(read_value(source.tags, "camera/clip/far", 100.0), MAX_RANGE_M)
    if not 0.0 < near < far:
        raise UnusableSensor(f"clips at {near:g} and {far:g} m; use 0 < near < far")
    return near, far


def _read_depth_limits(source: SensorSource, near: float, far: float) -> tuple[float, float]:
    if source.plugin is None:
        low = read_value(source.tags, "camera/depth_camera/clip/near", near)
        high = read_value(source.tags, "camera/depth_camera/clip/far", far)
    else:
        low = source.plugin_value(
            "min_depth", "pointCloudCutoff", "point_cloud_cutoff", default=DEFAULT_MIN_DEPTH_M
        )
        high = source.plugin_value(
            "max_depth", "pointCloudCutoffMax", "point_cloud_cutoff_max", default=math.inf
        )
    if not 0.0 <= low < high:
        raise UnusableSensor(f"depths from {low:g} to {high:g} m; use 0 <= min < max")
    return low, high


def _check_distortion(source: SensorSource) -> None:
    own = [read_value(source.tags, f"camera/distortion/{part}", 0.0) for part in DISTORTION]
    of_plugin = [source.plugin_value(*names) for names in PLUGIN_DISTORTION]
    if any((*own, *of_plugin)):
        source.report.ignored(
            source.tags.label("camera/distortion"),
            "images are not distorted, and camera_info has coefficients of 0",
        )


def _check_format(source: SensorSource) -> None:
    format_ = source.tags.text("camera/image/format", RGB_FORMATS[0])
    if format_ not in RGB_FORMATS:
        source.report.ignored(
            source.tags.label("camera/image/format"), "images are rgb8, depths 32FC1"
        )


READERS: dict[str, Callable[[SensorSource], SensorSettings]] = {
    **dict.fromkeys(("ray", "gpu_ray", "lidar", "gpu_lidar"), read_ray),
    "sonar": read_sonar,
    "imu": read_imu,
    **dict.fromkeys(("contact", "bumper"), read_contact),
    **dict.fromkeys(("gps", "navsat"), read_navsat),
    "altimeter": read_altimeter,
    "magnetometer": read_magnetometer,
    "air_pressure": read_air_pressure,
    **dict.fromkeys(CAMERA_KINDS, read_camera),
}
"""Readers by type in Gazebo."""
TOPIC_OF_SETTINGS: dict[type, str] = {
    ImuSensor: "imu",
    ContactSensor: "bumper_states",
    NavsatSensor: "fix",
    AltimeterSensor: "altimeter",
    MagnetometerSensor: "magnetic_field",
    AirPressureSensor: "air_pressure",
}
"""Topic of the catalog of sensors with one main topic, which is its name where nothing names it."""
