"""Settings of the sensors of a model."""

from typing import Literal, TypeAlias

import msgspec

from zensim.proto.messages.scalar_types import UInt8, UInt32

NoiseKind = Literal["none", "gaussian", "gaussian_quantized"]
ScanOutput = Literal["LaserScan", "PointCloud2", "PointCloud", "Range"]
"""The sensor_msgs type that a ray sensor publishes."""
CameraKind = Literal["rgb", "depth", "rgbd"]


class Noise(msgspec.Struct, frozen=True, gc=False):
    """Noise of one measured quantity, in its unit. Source: `<noise>` of SDF 1.12.

    A measurement is value + bias + N(mean, stddev), rounded to `precision` if quantized. The bias
    is drawn once from N(bias_mean, bias_stddev).
    """

    kind: NoiseKind = "none"
    mean: float = 0.0
    stddev: float = 0.0
    """>= 0."""
    bias_mean: float = 0.0
    bias_stddev: float = 0.0
    """>= 0."""
    precision: float = 0.0
    """> 0 if quantized."""
    dynamic_bias_stddev: float = 0.0
    """Standard deviation of the random walk of the bias; >= 0."""
    dynamic_bias_correlation_time_s: float = 0.0
    """0 = no random walk."""


NO_NOISE = Noise()
NoiseOfVector: TypeAlias = tuple[Noise, Noise, Noise]
"""Noise along x, y and z of the sensor."""
NO_VECTOR_NOISE: NoiseOfVector = (NO_NOISE, NO_NOISE, NO_NOISE)


class ScanAxis(msgspec.Struct, frozen=True, gc=False):
    """Directions of the rays of a scan along one axis, evenly spaced; `low_rad <= high_rad`."""

    count: UInt32 = 1
    """Rays: samples times resolution; >= 1."""
    low_rad: float = 0.0
    high_rad: float = 0.0


class RaySensor(msgspec.Struct, frozen=True, gc=False, tag="ray"):
    """A lidar or range finder: rays from the origin of the sensor, x forward, z up."""

    horizontal: ScanAxis = ScanAxis()
    """Azimuth: 0 is x, positive to y."""
    vertical: ScanAxis = ScanAxis()
    """Elevation: positive to z."""
    range_min_m: float = 0.0
    range_max_m: float = 10.0
    noise: Noise = NO_NOISE
    output: ScanOutput = "LaserScan"
    radiation_type: UInt8 = 1
    """Radiation of a Range: 0 ultrasound, 1 infrared."""
    min_intensity: float = 0.0
    sees_itself: bool = False
    """Whether rays hit the robot that carries the sensor."""
    is_organized: bool = False
    """Whether a PointCloud2 has a point for each ray, row by row, also for those without a hit, and
    the number of its row as field `ring`, as gz-sim publishes it."""


class ImuSensor(msgspec.Struct, frozen=True, gc=False, tag="imu"):
    """Orientation, angular velocity [rad/s] and specific force [m/s^2] in the sensor's axes."""

    angular_velocity: NoiseOfVector = NO_VECTOR_NOISE
    linear_acceleration: NoiseOfVector = NO_VECTOR_NOISE
    reference: Literal["world", "spawn"] = "world"
    """Orientation is relative to the world (ENU) or to the pose at spawn."""
    has_orientation: bool = True


class ContactSensor(msgspec.Struct, frozen=True, gc=False, tag="contact"):
    """Contacts of some collisions of a robot."""

    collisions: tuple[tuple[UInt32, UInt32], ...] = ()
    """Index of the link in `Model.links` and of the collision in `Link.collisions`."""
    names: tuple[str, ...] = ()
    """Names of these collisions as messages show them."""


class NavsatSensor(msgspec.Struct, frozen=True, gc=False, tag="navsat"):
    """Geodetic position (WGS84) and velocity east, north, up [m/s]."""

    horizontal_position: Noise = NO_NOISE
    """[m], along east and north."""
    vertical_position: Noise = NO_NOISE
    horizontal_velocity: Noise = NO_NOISE
    vertical_velocity: Noise = NO_NOISE


class AltimeterSensor(msgspec.Struct, frozen=True, gc=False, tag="altimeter"):
    """Height above that at spawn [m] and vertical velocity [m/s]."""

    vertical_position: Noise = NO_NOISE
    vertical_velocity: Noise = NO_NOISE


class MagnetometerSensor(msgspec.Struct, frozen=True, gc=False, tag="magnetometer"):
    """Magnetic field [T] in the sensor's axes."""

    field: NoiseOfVector = NO_VECTOR_NOISE


class AirPressureSensor(msgspec.Struct, frozen=True, gc=False, tag="air_pressure"):
    """Pressure of the air [Pa] at the height of the sensor."""

    pressure: Noise = NO_NOISE
    reference_altitude_m: float | None = None
    """Altitude of the world's origin; None = that of the world."""


class CameraSensor(msgspec.Struct, frozen=True, gc=False, tag="camera"):
    """A pinhole camera that looks along x, y left, z up; images are in optical axes (REP-103)."""

    kind: CameraKind = "rgb"
    width: UInt32 = 320
    height: UInt32 = 240
    horizontal_fov_rad: float = 1.047
    near_m: float = 0.1
    """Surfaces nearer than this are not seen."""
    far_m: float = 100.0
    min_depth_m: float = 0.0
    """Smaller depths are published as -inf."""
    max_depth_m: float = float("inf")
    """Greater depths are published as +inf."""
    noise: Noise = NO_NOISE
    """Noise of colours in 0 to 1."""
    stereo_baseline_m: float = 0.0
    """`hack_baseline` of Gazebo: P[3] = -f * baseline."""
    is_triggered: bool = False
    """Whether it measures only if `image_trigger` got a message since it was last due."""


StateSensorSettings: TypeAlias = (
    ImuSensor | NavsatSensor | AltimeterSensor | MagnetometerSensor | AirPressureSensor
)
"""Sensors of a robot's own state, which its agent has."""
SensorSettings: TypeAlias = StateSensorSettings | ContactSensor | RaySensor | CameraSensor


class SensorTopic(msgspec.Struct, frozen=True, gc=False):
    """A topic of a sensor."""

    topic: str
    """Name in the topic catalog."""
    name: str
    """Name below the robot's namespace, as in `front/scan`; after `~` and remapping rules."""
