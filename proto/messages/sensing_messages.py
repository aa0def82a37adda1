"""What sensor processes and agents get from the server, and what sensor processes report."""

from typing import ClassVar

import msgspec

from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.process_messages import ProcessUsage
from zensim.proto.messages.scalar_types import UInt32, UInt64


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
