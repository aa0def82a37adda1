"""A parsed model: links, joints, shapes, sensors, drive; frames per REP-103.

The garbage collector does not track models: frozen values have no reference cycles, and it would
stop a loop with thousands of them for a tenth of a second.
"""

from typing import ClassVar, Literal

import msgspec

from zensim.proto.messages.drive_messages import Actuator, Compat, Drive, RosBlock
from zensim.proto.messages.sensor_messages import SensorSettings, SensorTopic

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

ZERO: Vec3 = (0.0, 0.0, 0.0)
IDENTITY: Quat = (0.0, 0.0, 0.0, 1.0)

ReportStatus = Literal["applied", "ignored", "unknown", "predicted", "suspicious"]
"""predicted: what the robot will do that was not commanded."""
LightKind = Literal["point", "spot", "directional"]
DOWNWARD: Vec3 = (0.0, 0.0, -1.0)
Dynamics = Literal["", "full", "kinematic", "auto"]
"""How an entity moves: by forces and contacts; as its drive computes, stopped by obstacles; or
either, chosen by the server. Empty = default of the world.
"""
TierName = Literal["full", "kinematic"]
"""How an entity moves now."""
JointKind = Literal["revolute", "continuous", "prismatic", "floating", "planar", "fixed"]
MOVABLE_KINDS = ("revolute", "continuous", "prismatic")
"""Kinds of joints that move about, or along, one axis."""
TURNING_KINDS, LIMITED_KINDS = ("revolute", "continuous"), ("revolute", "prismatic")
CommandKind = Literal["velocity", "position", "effort"]
DEFAULT_STOPPED_VELOCITY = 0.01
"""Velocity below which a joint counts as stopped at the end of a trajectory [rad/s or m/s]."""


class ReportEntry(msgspec.Struct, frozen=True, gc=False):
    """How one tag, plug-in or argument of a description was processed."""

    status: ReportStatus
    subject: str
    reason: str = ""


class Origin(msgspec.Struct, frozen=True, gc=False):
    """A fixed pose in a frame that the owner defines: position [m], orientation (x, y, z, w)."""

    position: Vec3 = ZERO
    orientation: Quat = IDENTITY


class Contact(msgspec.Struct, frozen=True, gc=False):
    """Compliance, anisotropic friction and rebound of a collision. Source: ODE's surfaces."""

    stiffness: float = 0.0
    """[N/m] (kp) per contact point; 0 = rigid."""
    damping: float = 0.0
    """[N s/m] (kd); not used if rigid."""
    direction: Vec3 = ZERO
    """Unit vector in the link (fdir1) to which `Shape.friction` applies; 0 = all directions."""
    friction_across: float = 0.0
    """Coulomb coefficient (mu2) across `direction`."""
    restitution: float | None = None
    """Speed after an impact over the speed before, 0 to 1; None = not given: 0, or of a static
    model that of the other."""
    bounce_threshold: float = 0.0
    """Speed of an impact [m/s] up to which there is no rebound."""


class Texture(msgspec.Struct, frozen=True, gc=False):
    """An image on a mesh; its colour is multiplied by `Shape.rgba`.

    While a description is read, `image` is the URI of a file, then the sha256 of an asset.
    """

    image: str
    """A PNG or JPEG of at most 1024 pixels a side."""
    coordinates: str = ""
    """sha256 of float32 (3 f, 2), little-endian, for the corners of the f triangles of the mesh:
    u to the right and v upward, 0 to 1 over the image, which repeats beyond."""


class Shape(msgspec.Struct, frozen=True, gc=False):
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
    name: str = ""
    """Name of a collision: as described, or as Gazebo names it; equal for the parts of one mesh."""
    texture: Texture | None = None
    """Texture of a visual."""


class Light(msgspec.Struct, frozen=True, gc=False):
    """A light; pose and direction are in the frame of its owner, a link or the world.

    Source: SDFormat's `<light>`.
    """

    name: str
    kind: LightKind
    origin: Origin = Origin()
    direction: Vec3 = DOWNWARD
    """Direction of spot and directional lights; `origin.orientation` is applied already."""
    rgba: Quat = (1.0, 1.0, 1.0, 1.0)
    intensity: float = 1.0
    """Factor of the colour; >= 0."""
    range_m: float = 10.0
    """Distance beyond which it has no effect."""
    attenuation: Vec3 = (1.0, 0.0, 0.0)
    """c, l, q of 1 / (c + l d + q d^2) at the distance d [m]."""
    outer_angle_rad: float = 0.0
    """Full angle of the cone of a spot light; 0 = not specified."""
    casts_shadows: bool = False


class Inertial(msgspec.Struct, frozen=True, gc=False):
    """Mass [kg], centre of mass [m] in the link, inertia about it [kg m^2], link axes.

    `inertia` is (ixx, ixy, ixz, iyy, iyz, izz).
    """

    mass_kg: float = 0.0
    com_in_link: Vec3 = ZERO
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Decay(msgspec.Struct, frozen=True, gc=False):
    """Velocity decay rates [1/s]: dv/dt = -rate v."""

    linear: float = 0.0
    angular: float = 0.0


class Link(msgspec.Struct, frozen=True, gc=False):
    """A rigid body after fixed joints are merged."""

    name: str
    inertial: Inertial = Inertial()
    collisions: tuple[Shape, ...] = ()
    visuals: tuple[Shape, ...] = ()
    weightless: Inertial = Inertial()
    """Part of `inertial` on which gravity does not act; its moments are not used."""
    decay: Decay = Decay()
    self_collides: bool = False
    """Whether it collides with other links of its model, except those that it is joined to."""
    lights: tuple[Light, ...] = ()


class Mimic(msgspec.Struct, frozen=True, gc=False):
    """Coupling to another joint: position = multiplier * other position + offset [rad or m]."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


class Joint(msgspec.Struct, frozen=True, gc=False):
    """A joint; its axis is in the joint frame, which is the child frame."""

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
    spring_stiffness: float = 0.0
    """[N m/rad or N/m]; the spring pulls to `spring_reference`."""
    spring_reference: float = 0.0
    """[rad or m]."""
    motor_factor: float = 1.0
    """Share of the torque of its motor that is left; smaller during a fault."""


class CommandInterface(msgspec.Struct, frozen=True, gc=False):
    """A quantity of a joint that controllers may command.

    Source: `<ros2_control>` of ROS 2, `<transmission>` of ROS 1.
    """

    joint: str
    kind: CommandKind
    lower: float | None = None
    """[rad/s, rad or N m; m/s, m or N for sliding joints]; None = unbounded."""
    upper: float | None = None
    initial: float | None = None
    """Position at the start, where its controller holds it; None = 0."""


class PositionTolerance(msgspec.Struct, frozen=True, gc=False):
    """Allowed errors of a position [rad or m] along a trajectory and at its end; 0 = any."""

    joint: str
    path: float = 0.0
    goal: float = 0.0


class JointController(msgspec.Struct, frozen=True, gc=False):
    """Joints that are commanded together. Source: ros2_controllers."""

    name: str
    joints: tuple[str, ...]
    interface: CommandKind = "position"
    """Kind of the numbers on its `commands` topic."""
    follows_trajectories: bool = True
    """Whether it has the action `follow_joint_trajectory`; else the topic `commands`."""
    holds: bool = False
    """Whether its joints are held from the start on; else they are free until a command."""
    tolerances: tuple[PositionTolerance, ...] = ()
    goal_time_s: float = 0.0
    """Time after the end of a trajectory to reach its goal; 0 = unlimited."""
    stopped_velocity: float = DEFAULT_STOPPED_VELOCITY
    """Greatest velocity of a joint at the goal [rad/s or m/s]; 0 = any."""
    allows_partial_goals: bool = False
    """Whether a goal may leave out joints, which then stay."""
    allows_moving_end: bool = False
    """Whether the last point of a trajectory may have velocities."""


class Frame(msgspec.Struct, frozen=True, gc=False):
    """A link that was merged into `parent`; used for tf."""

    name: str
    parent: str
    origin: Origin = Origin()


class JointStatePublisher(msgspec.Struct, frozen=True, gc=False):
    """Joints and rate of `joint_states`. Source: gazebo_ros_joint_state_publisher."""

    joints: tuple[str, ...] = ()
    update_rate_hz: float = 100.0
    ros: RosBlock = RosBlock()


class GroundTruth(msgspec.Struct, frozen=True, gc=False):
    """True odometry of a link, published by its agent. Source: gazebo_ros_p3d, ROS 2 branch."""

    body: str
    """A link, merged or not."""
    frame_id: str = "world"
    """Frame of the message; a link of the same robot makes the pose relative to it."""
    update_rate_hz: float = 0.0
    """0 = at every drive state."""
    topic: str = "odom"
    """Topic in the robot's namespace."""
    offset: Origin = Origin()
    """Position is added, orientation is multiplied from the left, in `frame_id`, as in Gazebo."""
    noise: float = 0.0
    """Standard deviation of each velocity, Gaussian [m/s, rad/s]; its square is the covariance."""
    ros: RosBlock = RosBlock()
    compat: Compat = "fixed"
    """gazebo11: velocities are in `frame_id`, not in the body."""


class Parameter(msgspec.Struct, frozen=True, gc=False):
    """One setting of a sensor, by the path of its tag, such as `scan/horizontal/samples`."""

    path: str
    value: str


class Sensor(msgspec.Struct, frozen=True, gc=False):
    """A sensor; `origin` is its pose in `link`, into which the link `frame` may be merged."""

    name: str
    kind: str
    """Type in Gazebo: imu, ray, gpu_ray, contact, camera, depth and others."""
    link: str
    frame: str
    """Link in the description."""
    origin: Origin = Origin()
    update_rate_hz: float = 0.0
    """0 = every step."""
    plugin: str = ""
    """File name of its plug-in."""
    ros: RosBlock = RosBlock()
    parameters: tuple[Parameter, ...] = ()
    settings: SensorSettings | None = None
    """None: not simulated; the report says why."""
    topics: tuple[SensorTopic, ...] = ()
    frame_id: str = ""
    """Frame of its messages, without the robot's frame prefix."""
    compat: Compat = "fixed"


class Model(msgspec.Struct, frozen=True, gc=False):
    """A parsed description with merged fixed joints; shared by all entities spawned from it.

    `links[0]` is the base; `joints[i]` moves `links[i + 1]`; parents precede children.
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
    command_interfaces: tuple[CommandInterface, ...] = ()
    """Interfaces as described; a drive uses joints without them, too."""
    drags: bool = False
    """Whether friction takes much of what its driven wheels can transmit, by the prediction."""
    joint_controllers: tuple[JointController, ...] = ()
    """Controllers whose joints have actuators of mode `joint`."""

    @property
    def mass_kg(self) -> float:
        """Total mass of all links."""
        return sum(link.inertial.mass_kg for link in self.links)

    @property
    def is_robot(self) -> bool:
        """Whether it has a drive, or joints that it controls, as an arm."""
        return self.drive is not None or bool(self.joint_controllers)

    @property
    def needs_agent(self) -> bool:
        """Whether an agent drives it or publishes for it: sensors, states, transforms."""
        publishes = self.joint_state is not None or bool(self.ground_truths)
        measures = any(sensor.settings is not None for sensor in self.sensors)
        return self.is_robot or publishes or measures

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Actuators of a drive command, in order: those of the drive, then controlled joints."""
        return self.drive_actuators + self.joint_actuators

    @property
    def drive_actuators(self) -> tuple[Actuator, ...]:
        """Actuators of the drive, in order."""
        return self.drive.actuators if self.drive else ()

    @property
    def joint_actuators(self) -> tuple[Actuator, ...]:
        """Actuators of the joints of controllers, in the order of `joints`."""
        if not self.joint_controllers:
            return ()
        names = {name for one in self.joint_controllers for name in one.joints}
        return tuple(Actuator("joint", j.name, j.effort) for j in self.joints if j.name in names)

    @property
    def target_count(self) -> int:
        """Number of targets in a drive command."""
        return sum(actuator.width for actuator in self.actuators)
