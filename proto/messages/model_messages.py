"""A parsed model: links, joints, shapes, sensors, drive; frames per REP-103."""

from typing import ClassVar, Literal

import msgspec

from zensim.proto.messages.drive_messages import (
    Actuator,
    Compat,
    DiffDrive,
    Drive,
    RosBlock,
    WheelPair,
)

__all__ = [
    "IDENTITY",
    "ZERO",
    "Actuator",
    "Contact",
    "Decay",
    "DiffDrive",
    "Drive",
    "Dynamics",
    "Frame",
    "GroundTruth",
    "Inertial",
    "Joint",
    "JointKind",
    "JointStatePublisher",
    "Link",
    "Mimic",
    "Model",
    "Origin",
    "Parameter",
    "Quat",
    "ReportEntry",
    "ReportStatus",
    "RosBlock",
    "Sensor",
    "Shape",
    "TierName",
    "Vec3",
    "WheelPair",
]

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

ZERO: Vec3 = (0.0, 0.0, 0.0)
IDENTITY: Quat = (0.0, 0.0, 0.0, 1.0)

ReportStatus = Literal["applied", "ignored", "unknown", "suspicious"]


class ReportEntry(msgspec.Struct, frozen=True):
    """What became of one tag, plug-in or argument of a description."""

    status: ReportStatus
    subject: str
    reason: str = ""


class Origin(msgspec.Struct, frozen=True):
    """A fixed pose: position [m] and orientation (x, y, z, w) in the frame that the owner names."""

    position: Vec3 = ZERO
    orientation: Quat = IDENTITY


class Contact(msgspec.Struct, frozen=True):
    """How a collision yields, and slides across a direction. Source: ODE's surface parameters."""

    stiffness: float = 0.0
    """[N/m] (kp) of each point of contact; 0 = rigid."""
    damping: float = 0.0
    """[N s/m] (kd); means nothing where rigid."""
    direction: Vec3 = ZERO
    """Unit vector in the link (fdir1), along which `Shape.friction` holds; 0 = every way."""
    friction_across: float = 0.0
    """Coulomb coefficient (mu2) across `direction`."""


class Shape(msgspec.Struct, frozen=True):
    """A solid in its link's frame.

    `size` is full extents [m] by kind: box (x, y, z); sphere (radius, 0, 0); cylinder and capsule
    (radius, length, 0) along z; plane (0, 0, 0), normal z; mesh: scale.
    """

    kind: Literal["box", "sphere", "cylinder", "capsule", "plane", "mesh"]
    size: Vec3 = ZERO
    origin: Origin = Origin()
    rgba: Quat | None = None
    mesh: str = ""
    friction: float = 1.0
    """Coulomb coefficient (mu1) of a collision; >= 0."""
    contact: Contact = Contact()


class Inertial(msgspec.Struct, frozen=True):
    """Mass [kg], centre of mass [m] in the link, inertia about it [kg m^2], link axes.

    `inertia` is (ixx, ixy, ixz, iyy, iyz, izz).
    """

    mass_kg: float = 0.0
    com_in_link: Vec3 = ZERO
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Decay(msgspec.Struct, frozen=True):
    """How fast velocities die down by themselves [1/s]: dv/dt = -rate v."""

    linear: float = 0.0
    angular: float = 0.0


class Link(msgspec.Struct, frozen=True):
    """A rigid part that moves by itself once fixed joints are lumped."""

    name: str
    inertial: Inertial = Inertial()
    collisions: tuple[Shape, ...] = ()
    visuals: tuple[Shape, ...] = ()
    weightless: Inertial = Inertial()
    """The share of `inertial` that gravity does not pull; its moments are not used."""
    decay: Decay = Decay()
    self_collides: bool = False
    """It touches other links of its model too, but for those it is joined to."""


Dynamics = Literal["", "full", "kinematic", "auto"]
"""How an entity moves: by forces and contacts; as its drive says, stopped by what is in its way; or
either, as need be. Empty = as its world says.
"""

TierName = Literal["full", "kinematic"]
"""How an entity moves at a moment."""

JointKind = Literal["revolute", "continuous", "prismatic", "floating", "planar", "fixed"]


class Mimic(msgspec.Struct, frozen=True):
    """A joint that follows another: position = multiplier * the other's + offset [rad or m]."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


class Joint(msgspec.Struct, frozen=True):
    """How a link moves in its parent; axis in the joint's (= child's) frame."""

    name: str
    kind: JointKind
    parent: str
    child: str
    origin: Origin = Origin()
    axis: Vec3 = (1.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0
    effort: float = 0.0
    velocity: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None


class Frame(msgspec.Struct, frozen=True):
    """A link that lumping merged into `parent`; kept for tf."""

    name: str
    parent: str
    origin: Origin = Origin()


class JointStatePublisher(msgspec.Struct, frozen=True):
    """Which joints are published, and how often. Source: gazebo_ros_joint_state_publisher."""

    joints: tuple[str, ...] = ()
    update_rate_hz: float = 100.0
    ros: RosBlock = RosBlock()


class GroundTruth(msgspec.Struct, frozen=True):
    """True odometry of a link, published by its agent. Source: gazebo_ros_p3d, ROS 2 branch."""

    body: str
    """A link, merged or not."""
    frame_id: str = "world"
    """Of the message; a link of the same robot is what the pose is relative to."""
    update_rate_hz: float = 0.0
    """0 = every state that the agent is told of."""
    topic: str = "odom"
    """In the robot's namespace."""
    offset: Origin = Origin()
    """Added to the position, turned before the orientation: as Gazebo does, in `frame_id`."""
    noise: float = 0.0
    """Standard deviation of each velocity, Gaussian [m/s, rad/s]; its square is the covariance."""
    ros: RosBlock = RosBlock()
    compat: Compat = "fixed"
    """gazebo11: velocities are along the axes of `frame_id`, not of the body."""


class Parameter(msgspec.Struct, frozen=True):
    """One setting of a sensor, by its path of tags, such as `scan/horizontal/samples`."""

    path: str
    value: str


class Sensor(msgspec.Struct, frozen=True):
    """A sensor that a description asks for; `origin` places it in `link`, which moves by itself."""

    name: str
    kind: str
    """As Gazebo calls it: imu, ray, gpu_ray, contact, camera, depth and others."""
    link: str
    frame: str
    """The link that the description puts it on; it may be merged into `link`."""
    origin: Origin = Origin()
    update_rate_hz: float = 0.0
    """0 = every step."""
    plugin: str = ""
    """File name of its plug-in."""
    ros: RosBlock = RosBlock()
    parameters: tuple[Parameter, ...] = ()


class Model(msgspec.Struct, frozen=True):
    """What a description says, after lumping; shared by all entities spawned from it.

    `links[0]` is the base; `joints[i]` moves `links[i + 1]`; parents come before children.
    """

    ros_type: ClassVar[str] = "zensim/msg/Model"

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...] = ()
    frames: tuple[Frame, ...] = ()
    drive: Drive | None = None
    joint_state: JointStatePublisher | None = None
    ground_truths: tuple[GroundTruth, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    is_static: bool = False
    report: tuple[ReportEntry, ...] = ()
    dynamics: Dynamics = ""

    @property
    def mass_kg(self) -> float:
        """Total mass of all links."""
        return sum(link.inertial.mass_kg for link in self.links)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """What a drive command addresses, in order."""
        return self.drive.actuators if self.drive else ()

    @property
    def target_count(self) -> int:
        """How many numbers a drive command has for this model."""
        return sum(actuator.width for actuator in self.actuators)
