"""The catalog of topics: key, messages, QoS, default rate and users of each."""

from enum import Enum

import msgspec

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.messages.agent_messages import (
    DriveCommand,
    DriveState,
    FleetOdometry,
    TwistCommands,
)
from zensim.proto.messages.gazebo_messages import ContactsState, LinkStates, ModelStates
from zensim.proto.messages.input_messages import Inputs
from zensim.proto.messages.process_messages import AgentStats
from zensim.proto.messages.sensing_messages import Contacts, SceneState, SensorsReply, SensorStats
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.messages.standard_messages import (
    Altimeter,
    CameraInfo,
    Clock,
    CompressedImage,
    Empty,
    Float64MultiArray,
    FluidPressure,
    Image,
    Imu,
    JointState,
    LaserScan,
    MagneticField,
    NavSatFix,
    OccupancyGrid,
    Odometry,
    PointCloud,
    PointCloud2,
    Range,
    String,
    TFMessage,
    Twist,
    TwistStamped,
    Vector3Stamped,
)
from zensim.proto.messages.telemetry_messages import AuditRecord, Event, Snapshot, Stats, WorldClock
from zensim.proto.messages.vehicle_messages import FleetStatus
from zensim.proto.ros2.qos_profiles import LATCHED, RELIABLE_5, RELIABLE_10, Qos
from zensim.proto.ros2.ros_graph import RosTopic
from zensim.proto.ros2.ros_settings import PARAMETERS, RosSettings, parse_ros_settings
from zensim.proto.settings.ros_choice import USUAL_TF, RosChoice, TfChoice


class TopicScope(Enum):
    """Owner of a topic; the value is the prefix of its key."""

    WORLD = "sim/{}/"
    AGENT = "sim/{}/drive/{}/"
    SENSORS = "sim/{}/sensors/{}/"
    ROBOT = "{}/"


class Participant(Enum):
    """Program that publishes or subscribes."""

    SERVER = "server"
    AGENT = "agent"
    SENSORS = "sensor process"
    USER = "user"


class TopicSpec(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """One topic, equal to itself only."""

    name: str
    """Unique in the catalog."""
    suffix: str = ""
    """Last chunk of the key; the name if empty."""
    scope: TopicScope
    messages: tuple[type[msgspec.Struct], ...]
    """A publisher uses any of them; those of zensim use the first."""
    publisher: Participant
    subscriber: Participant = Participant.USER
    format: Format = Format.CDR
    """Format that zensim publishes; subscribers accept every format."""
    qos: Qos = RELIABLE_10
    """QoS of the ROS 2 endpoints, if there are any."""
    root_message: type[msgspec.Struct] | None = None
    """Published as CDR on the suffix alone, as `/clock` and `/tf`; None = not published."""
    rate_hz: float = 0.0
    """Default rate [Hz], of wall time in scope WORLD, else of simulation time; 0 = on change, or as
    the robot's description says."""
    is_gettable: bool = True
    """Whether a get on the key replies with the last message."""
    description: str
    """One line of docs/keys.md."""

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle its name."""
        return find_topic, (self.name,)

    def __post_init__(self) -> None:
        """Complete the suffix."""
        if not self.suffix:
            msgspec.structs.force_setattr(self, "suffix", self.name)

    @property
    def is_latched(self) -> bool:
        """Whether late subscribers get the last message."""
        return self.qos is LATCHED

    @property
    def encoding(self) -> str:
        """Zenoh Encoding of the first message."""
        return make_encoding(self.messages[0], self.format)

    def key(self, *owner: str) -> str:
        """Write the key of an owner: world; world and agent or sensor process; or namespace."""
        return self.scope.value.format(*owner) + self.suffix

    def at(self, key: str) -> RosTopic:
        """Describe the ROS 2 endpoint at a key, which differs from `key()` if it is remapped."""
        return RosTopic(key, self.messages[0], self.qos, self._ros_name)

    def root(self) -> RosTopic:
        """Describe the ROS 2 endpoint at the root.

        Raises:
            ValueError: There is none.
        """
        if self.root_message is None:
            raise ValueError(f"topic '{self.name}' is not published at the root")
        return RosTopic(self.suffix, self.root_message, self.qos, self._ros_name)

    @property
    def _ros_name(self) -> str:
        return self.name if self.scope is TopicScope.ROBOT else ""


class WorldTopicSpec(TopicSpec, frozen=True, eq=False, kw_only=True):
    """A topic that a server publishes about its world."""

    scope: TopicScope = TopicScope.WORLD
    publisher: Participant = Participant.SERVER
    format: Format = Format.MSGPACK


class RobotTopicSpec(TopicSpec, frozen=True, eq=False, kw_only=True):
    """A topic that an agent publishes about its robot."""

    scope: TopicScope = TopicScope.ROBOT
    publisher: Participant = Participant.AGENT


def _of_sensor(
    publisher: Participant,
    name: str,
    message: type[msgspec.Struct],
    description: str,
    suffix: str = "",
) -> TopicSpec:
    """Specify what a sensor of a robot measures."""
    return RobotTopicSpec(
        name=name,
        suffix=suffix,
        messages=(message,),
        publisher=publisher,
        qos=RELIABLE_5,
        description=description,
    )


CLOCK = WorldTopicSpec(
    name="clock",
    messages=(WorldClock,),
    root_message=Clock,
    rate_hz=100.0,
    description="simulation time",
)
STATS = WorldTopicSpec(
    name="stats", messages=(Stats,), rate_hz=1.0, description="real-time factor, step time, counts"
)
SNAPSHOT = WorldTopicSpec(
    name="snapshot",
    messages=(Snapshot,),
    rate_hz=30.0,
    description="pose and twist of every entity",
)
EVENTS = WorldTopicSpec(
    name="events",
    messages=(Event,),
    is_gettable=False,
    description="spawned, deleted, claimed, released, touched, reset",
)
AUDIT = WorldTopicSpec(
    name="audit",
    messages=(AuditRecord,),
    is_gettable=False,
    description="who joined, left, changed something or was refused on a secured server",
)
INPUTS = WorldTopicSpec(
    name="inputs",
    messages=(Inputs,),
    is_gettable=False,
    description="what changed the world, and hashes of its states, for `zensim resim`",
)
MODEL_STATES = WorldTopicSpec(
    name="model_states",
    messages=(ModelStates,),
    root_message=ModelStates,
    rate_hz=20.0,
    description="pose and twist of every entity, as Gazebo publishes them",
)
LINK_STATES = WorldTopicSpec(
    name="link_states",
    messages=(LinkStates,),
    root_message=LinkStates,
    rate_hz=20.0,
    description="pose and twist of every link, as Gazebo publishes them",
)
STEPS_PROGRESS = WorldTopicSpec(
    name="steps_progress",
    suffix="simulate_steps_feedback",
    messages=(StepsProgress,),
    is_gettable=False,
    description="progress of each `simulate_steps` goal",
)
MAP = WorldTopicSpec(
    name="map",
    messages=(OccupancyGrid,),
    qos=LATCHED,
    root_message=OccupancyGrid,
    description="what is fixed in the world, as a map for Nav2",
)
CONTACTS = WorldTopicSpec(
    name="contacts",
    messages=(Contacts,),
    subscriber=Participant.AGENT,
    is_gettable=False,
    description="contacts of all contact sensors, at each control step",
)
DRIVE_STATE = TopicSpec(
    name="drive_state",
    suffix="state",
    scope=TopicScope.AGENT,
    messages=(DriveState,),
    publisher=Participant.SERVER,
    subscriber=Participant.AGENT,
    format=Format.MSGPACK,
    rate_hz=100.0,
    is_gettable=False,
    description="state of all robots of one agent",
)
DRIVE_COMMAND = TopicSpec(
    name="drive_command",
    suffix="command",
    scope=TopicScope.AGENT,
    messages=(DriveCommand,),
    publisher=Participant.AGENT,
    subscriber=Participant.SERVER,
    format=Format.MSGPACK,
    rate_hz=100.0,
    is_gettable=False,
    description="actuator targets of all robots of one agent",
)
AGENT_STATS = TopicSpec(
    name="agent_stats",
    suffix="figures",
    scope=TopicScope.AGENT,
    messages=(AgentStats,),
    publisher=Participant.AGENT,
    format=Format.MSGPACK,
    rate_hz=1.0,
    description="robots, answered states, CPU time and memory of an agent",
)
FLEET_ODOMETRY = TopicSpec(
    name="fleet_odometry",
    suffix="odometry",
    scope=TopicScope.AGENT,
    messages=(FleetOdometry,),
    publisher=Participant.AGENT,
    format=Format.MSGPACK,
    is_gettable=False,
    description="odometry of all robots of one agent, many in a message",
)
TWISTS = TopicSpec(
    name="twists",
    scope=TopicScope.WORLD,
    messages=(TwistCommands,),
    publisher=Participant.USER,
    subscriber=Participant.SERVER,
    format=Format.MSGPACK,
    is_gettable=False,
    description="twists that robots keep until the next order; `cmd_vel` for a whole fleet",
)
VEHICLES = TopicSpec(
    name="vehicles",
    scope=TopicScope.WORLD,
    messages=(FleetStatus,),
    publisher=Participant.USER,
    format=Format.MSGPACK,
    rate_hz=1.0,
    is_gettable=False,
    description="orders, batteries and errors of vehicles, from `zensim vda5050`",
)
SCENE_STATE = WorldTopicSpec(
    name="scene_state",
    messages=(SceneState,),
    subscriber=Participant.SENSORS,
    is_gettable=False,
    description="poses of all entities when a lidar or camera is due",
)
SENSORS_REPLY = TopicSpec(
    name="sensors_reply",
    suffix="reply",
    scope=TopicScope.SENSORS,
    messages=(SensorsReply,),
    publisher=Participant.SENSORS,
    subscriber=Participant.SERVER,
    format=Format.MSGPACK,
    is_gettable=False,
    description="all measurements of a scene state are published",
)
SENSOR_STATS = TopicSpec(
    name="sensor_stats",
    suffix="figures",
    scope=TopicScope.SENSORS,
    messages=(SensorStats,),
    publisher=Participant.SENSORS,
    format=Format.MSGPACK,
    rate_hz=1.0,
    description="messages, late ones and cost of each sensor",
)
CMD_VEL = TopicSpec(
    name="cmd_vel",
    scope=TopicScope.ROBOT,
    messages=(Twist, TwistStamped),
    publisher=Participant.USER,
    subscriber=Participant.AGENT,
    is_gettable=False,
    description="velocity command",
)
JOINT_COMMANDS = TopicSpec(
    name="joint_commands",
    scope=TopicScope.ROBOT,
    messages=(JointState, Float64MultiArray),
    publisher=Participant.USER,
    subscriber=Participant.AGENT,
    is_gettable=False,
    description="positions, velocities or efforts that joints are to have",
)
CONTROLLER_COMMANDS = TopicSpec(
    name="controller_commands",
    suffix="commands",
    scope=TopicScope.ROBOT,
    messages=(Float64MultiArray,),
    publisher=Participant.USER,
    subscriber=Participant.AGENT,
    is_gettable=False,
    description="the same for the joints of one controller, below its name",
)
ODOM = RobotTopicSpec(name="odom", messages=(Odometry,), description="pose and twist of the base")
TF = RobotTopicSpec(
    name="tf",
    messages=(TFMessage,),
    root_message=TFMessage,
    description="transforms of the base and of moving joints",
)
TF_STATIC = RobotTopicSpec(
    name="tf_static",
    messages=(TFMessage,),
    qos=LATCHED,
    root_message=TFMessage,
    description="transforms of fixed joints",
)
JOINT_STATES = RobotTopicSpec(
    name="joint_states",
    messages=(JointState,),
    rate_hz=30.0,
    description="positions, velocities and efforts of joints",
)
IMU = _of_sensor(
    Participant.AGENT, "imu", Imu, "orientation, angular velocity and specific force of an IMU"
)
FIX = _of_sensor(Participant.AGENT, "fix", NavSatFix, "geodetic position of a satellite receiver")
VEL = _of_sensor(
    Participant.AGENT, "vel", Vector3Stamped, "velocity of a satellite receiver: east, north, up"
)
ALTIMETER = _of_sensor(
    Participant.AGENT, "altimeter", Altimeter, "height above that at spawn, and vertical velocity"
)
MAGNETIC_FIELD = _of_sensor(
    Participant.AGENT,
    "magnetic_field",
    MagneticField,
    "magnetic field in the axes of a magnetometer",
)
AIR_PRESSURE = _of_sensor(
    Participant.AGENT, "air_pressure", FluidPressure, "absolute pressure of the air"
)
BUMPER_STATES = _of_sensor(
    Participant.AGENT,
    "bumper_states",
    ContactsState,
    "what the collisions of a contact sensor touch",
)
ROBOT_DESCRIPTION = RobotTopicSpec(
    name="robot_description", messages=(String,), qos=LATCHED, description="the URDF"
)
SCAN = _of_sensor(Participant.SENSORS, "scan", LaserScan, "ranges of a lidar")
POINTS = _of_sensor(Participant.SENSORS, "points", PointCloud2, "points of a lidar")
POINT_CLOUD = _of_sensor(
    Participant.SENSORS, "point_cloud", PointCloud, "points of a lidar, as before PointCloud2"
)
RANGE = _of_sensor(
    Participant.SENSORS, "range", Range, "least distance in the cone of a range finder"
)
IMAGE_RAW = _of_sensor(Participant.SENSORS, "image_raw", Image, "colours of a camera")
IMAGE_TRIGGER = TopicSpec(
    name="image_trigger",
    scope=TopicScope.ROBOT,
    messages=(Empty,),
    publisher=Participant.USER,
    subscriber=Participant.SENSORS,
    is_gettable=False,
    description="request for an image of a triggered camera",
)
IMAGE_COMPRESSED = _of_sensor(
    Participant.SENSORS,
    "image_compressed",
    CompressedImage,
    "the same as JPEG",
    suffix="image_raw/compressed",
)
CAMERA_INFO = _of_sensor(Participant.SENSORS, "camera_info", CameraInfo, "calibration of a camera")
DEPTH_IMAGE = _of_sensor(
    Participant.SENSORS,
    "depth_image",
    Image,
    "distances along the optical axis",
    suffix="depth/image_raw",
)
DEPTH_CAMERA_INFO = _of_sensor(
    Participant.SENSORS,
    "depth_camera_info",
    CameraInfo,
    "calibration of a depth camera",
    suffix="depth/camera_info",
)
DEPTH_POINTS = _of_sensor(
    Participant.SENSORS,
    "depth_points",
    PointCloud2,
    "points of a depth camera, with colours",
    suffix="depth/points",
)
LABELS = _of_sensor(
    Participant.SENSORS,
    "labels",
    Image,
    "index of the entity that each pixel shows; -1 nothing, -2 the ground",
)

TOPICS: dict[str, TopicSpec] = {
    topic.name: topic for topic in tuple(vars().values()) if isinstance(topic, TopicSpec)
}
"""Every topic, by name."""
WORLD_TOPICS = tuple(
    topic
    for topic in TOPICS.values()
    if topic.scope is TopicScope.WORLD and topic.publisher is Participant.SERVER
)
"""What a server publishes about its world."""
ROBOT_TOPICS = {topic.suffix: topic for topic in TOPICS.values() if topic.scope is TopicScope.ROBOT}
"""The topics of each robot, by suffix."""


def find_topic(name: str) -> TopicSpec:
    """Find a topic by its unique name."""
    return TOPICS[name]


def find_robot_topic(key: str) -> TopicSpec | None:
    """Find the topic of robots that a key ends with, the longest suffix first."""
    parts = key.split("/")
    for start in range(max(0, len(parts) - 3), len(parts)):
        if (found := ROBOT_TOPICS.get("/".join(parts[start:]))) is not None:
            return found
    return None


def read_ros_settings(ros: RosChoice, tf: TfChoice = USUAL_TF) -> RosSettings:
    """Read the ROS 2 settings of a program from what a user chose.

    Raises:
        ValueError: See `parse_ros_settings` and `select_ros_topics`.
    """
    return select_ros_topics(parse_ros_settings(ros, tf), ros.ros_topics)


def select_ros_topics(settings: RosSettings, names: str) -> RosSettings:
    """Choose the topics of robots that are in ROS 2, by their names, separated by commas.

    `tf` includes `tf_static`, and an empty text is all topics.

    Raises:
        ValueError: There is no such topic.
    """
    chosen = tuple(dict.fromkeys(part.strip() for part in names.split(",") if part.strip()))
    known = [topic.name for topic in ROBOT_TOPICS.values()]
    for name in chosen:
        if name not in known and name != PARAMETERS:
            raise ValueError(
                f"`ros_topics`: {name[:40]!r} is no topic of a robot; "
                f"use {', '.join(known)} or {PARAMETERS}"
            )
    if TF.name in chosen and TF_STATIC.name not in chosen:
        chosen += (TF_STATIC.name,)
    return msgspec.structs.replace(settings, topics=chosen)
