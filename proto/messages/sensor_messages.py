"""Settings of the sensors of a model, and what sensor processes and agents get from the server."""

from typing import ClassVar, Literal, TypeAlias

import msgspec

from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.process_messages import ProcessUsage
from zensim.proto.messages.scalar_types import UInt8, UInt32, UInt64

NoiseKind = Literal["none", "gaussian", "gaussian_quantized"]


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


ScanOutput = Literal["LaserScan", "PointCloud2", "PointCloud", "Range"]
"""The sensor_msgs type that a ray sensor publishes."""


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


CameraKind = Literal["rgb", "depth", "rgbd"]


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
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 of plumb_bob, as camera_info says them; images are not distorted."""
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


class SphericalCoordinates(msgspec.Struct, frozen=True):
    """Geodetic place (WGS84) of the world's origin. Source: `<spherical_coordinates>` of SDF."""

    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    elevation_m: float = 0.0
    heading_deg: float = 0.0
    """Counter-clockwise angle from east to the world's x axis."""


class Environment(msgspec.Struct, frozen=True):
    """What sensors must know about a world apart from its entities; a loaded world changes it."""

    seed: UInt64 = 0
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """[m/s^2]."""
    magnetic_field: tuple[float, float, float] = (5.5645e-6, 22.8758e-6, -42.3884e-6)
    """[T], in the world. Default: that of SDF."""
    spherical_coordinates: SphericalCoordinates | None = None
    step_ns: UInt64 = 0
    control_steps: UInt32 = 0
    """Steps between two control steps."""
    has_ground: bool = True
    """Whether rays hit a ground plane z = 0."""


class SceneState(msgspec.Struct, frozen=True):
    """Poses of all entities at a control step at which a ray sensor or camera may be due."""

    ros_type: ClassVar[str] = "zensim/msg/SceneState"

    epoch: UInt32
    step: UInt64
    time_ns: UInt64
    roster: UInt32
    """Changes with each spawn and deletion: call `get_models` again."""
    poses: bytes
    """`<f8`, (n, 7): position, quaternion x y z w of the root links in the world; in the order of
    `GetModelsResponse.entities`."""
    joint_positions: bytes
    """`<f8`, all joints of all entities, model by model in the order of `Model.joints`."""
    processes: tuple[str, ...] = ()
    """The active sensor processes, in order: the k-th of n publishes every n-th sensor."""
    is_awaited: bool = False
    """Whether the server waits for a `SensorsReply` of each process."""
    topic_faults: tuple[TopicFault, ...] = ()
    """Faults of topics that act at this step."""


class SensorsReply(msgspec.Struct, frozen=True):
    """A sensor process has published everything that was due at a `SceneState`."""

    ros_type: ClassVar[str] = "zensim/msg/SensorsReply"

    epoch: UInt32
    step: UInt64
    messages: UInt64 = 0
    """Published since the process started."""
    late: UInt64 = 0
    """Measurements since the process started that were published after the next scene state had
    come, or not at all."""


class SensorFigures(msgspec.Struct, frozen=True):
    """What a sensor process has published of one sensor."""

    entity: str
    sensor: str
    topic: str
    """Key of the first topic."""
    has_subscribers: bool = False
    messages: UInt64 = 0
    late: UInt64 = 0
    """See `SensorsReply.late`."""
    cost_s: float = 0.0
    """CPU time of a measurement; sensors with equal settings are measured together."""
    is_measured: bool = True
    """False if no process can measure it."""
    fault: str = ""
    """Why it is not measured, or slowly; begins with a slug."""


class SensorStats(msgspec.Struct, frozen=True):
    """Statistics of a sensor process since its start."""

    ros_type: ClassVar[str] = "zensim/msg/SensorStats"

    process: str = ""
    is_active: bool = False
    """Whether it is subscribed to scene states, which it is while a sensor has subscribers."""
    cpu_s: float = 0.0
    messages: UInt64 = 0
    late: UInt64 = 0
    """See `SensorsReply.late`."""
    sensors: tuple[SensorFigures, ...] = ()
    """The share of this process, and what no process can measure."""
    missing: dict[str, str] = {}
    """Optional libraries that its host lacks, and why."""
    usage: ProcessUsage = ProcessUsage()


class Contacts(msgspec.Struct, frozen=True):
    """Contacts of the collisions that contact sensors watch, at one control step."""

    ros_type: ClassVar[str] = "zensim/msg/Contacts"

    epoch: UInt32
    step: UInt64
    time_ns: UInt64
    entities: tuple[str, ...]
    """Watched entities that touch something."""
    collisions: tuple[str, ...]
    """What they touch: names `entity::link::collision`, as in Gazebo."""
    bodies: bytes
    """`<u4`, (n, 4): index in `entities`, link and collision of the watched side, index in
    `collisions`."""
    points: bytes
    """`<f8`, (n, 10): position [m] and normal towards the watched side, both in the world, depth
    [m] (positive when overlapping), force on the watched side [N] in the world."""
