"""Robots on wheels for the accuracy benchmark: descriptions that span what public robots have."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.motion_prediction import turn_command
from zensim.sim_server.description.pipeline import parse_description

Point = tuple[float, float, float]
ORIGIN: Point = (0.0, 0.0, 0.0)
LEVEL_RPY: Point = (math.pi / 2.0, 0.0, 0.0)
"""Orientation of a cylinder whose axis is y."""
CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
STRAIGHT = (0.2, 0.0)
"""First command: vx [m/s] and wz [rad/s]."""


@dataclass(frozen=True)
class Surface:
    """Friction and contact of a link, as <gazebo> tags; None = not written."""

    mu: float = 1.0
    mu2: float | None = None
    fdir1: Point | None = None
    kp: float | None = None
    kd: float | None = None


@dataclass(frozen=True)
class WheelRobot:
    """One robot of the benchmark.

    Attributes:
        name: Unique.
        urdf: Description.
        order: Drive of the spawn request.
    """

    name: str
    urdf: str
    order: DriveOrder = field(default_factory=DriveOrder)

    @property
    def turn(self) -> tuple[float, float]:
        """Second command: vx [m/s] and wz [rad/s], or an angle [rad] of steered drives."""
        drive = self.model().drive
        if drive is None:
            raise ValueError(f"robot '{self.name}' has no drive")
        speed, _, rate = turn_command(drive)
        return speed, rate

    def model(self) -> Model:
        """Read the description."""
        return parse_description(
            self.urdf, assets={}, allow_missing=False, compat="fixed", drive=self.order
        ).model


@dataclass
class UrdfText:
    """A URDF that is written link by link."""

    name: str
    parts: list[str] = field(default_factory=list)

    def link(
        self,
        name: str,
        mass: float,
        inertia: Point,
        *shapes: str,
        com: Point = ORIGIN,
        surface: Surface | None = None,
    ) -> None:
        """Add a link; shapes are <collision> elements."""
        ixx, iyy, izz = inertia
        inertial = (
            f'<inertial><origin xyz="{_text(com)}"/><mass value="{mass!r}"/><inertia ixx="{ixx!r}" '
            f'ixy="0" ixz="0" iyy="{iyy!r}" iyz="0" izz="{izz!r}"/></inertial>'
        )
        self.parts.append(f'<link name="{name}">{inertial}{"".join(shapes)}</link>')
        if surface is not None:
            self.parts.append(f'<gazebo reference="{name}">{_surface_tags(surface)}</gazebo>')

    def joint(
        self,
        name: str,
        kind: str,
        ends: tuple[str, str],
        origin: Point,
        axis: Point = (0.0, 1.0, 0.0),
        *,
        tags: str = "",
    ) -> None:
        """Add a joint from a parent to a child; `tags` as of `a_range`."""
        self.parts.append(
            f'<joint name="{name}" type="{kind}">'
            f'<parent link="{ends[0]}"/><child link="{ends[1]}"/>'
            f'<origin xyz="{_text(origin)}"/><axis xyz="{_text(axis)}"/>{tags}</joint>'
        )

    def spring(self, joint: str, stiffness: float, reference: float) -> None:
        """Give a joint a spring."""
        self.parts.append(
            f'<gazebo reference="{joint}"><springStiffness>{stiffness!r}</springStiffness>'
            f"<springReference>{reference!r}</springReference></gazebo>"
        )

    def plugin(self, filename: str, tags: str) -> None:
        """Add a plug-in."""
        self.parts.append(
            f'<gazebo><plugin name="drive" filename="{filename}">{tags}</plugin></gazebo>'
        )

    def text(self) -> str:
        """Write the description."""
        return f'<robot name="{self.name}">{"".join(self.parts)}</robot>'


def a_range(reach: float, damping: float = 0.0) -> str:
    """Write limit and damping of a joint that moves by `reach` to either side."""
    limit = f'<limit lower="{-reach!r}" upper="{reach!r}" effort="1000" velocity="10"/>'
    return f'{limit}<dynamics damping="{damping!r}"/>'


def _text(point: Point) -> str:
    return " ".join(repr(number) for number in point)


def _surface_tags(surface: Surface) -> str:
    mu2 = surface.mu if surface.mu2 is None else surface.mu2
    tags = f"<mu1>{surface.mu!r}</mu1><mu2>{mu2!r}</mu2>"
    if surface.fdir1 is not None:
        tags += f"<fdir1>{_text(surface.fdir1)}</fdir1>"
    if surface.kp is not None:
        tags += f"<kp>{surface.kp!r}</kp><kd>{surface.kd or 1.0!r}</kd>"
    return tags


def a_collision(geometry: str, origin: Point = ORIGIN, rpy: Point = ORIGIN) -> str:
    """Write a <collision>."""
    place = f'<origin xyz="{_text(origin)}" rpy="{_text(rpy)}"/>'
    return f"<collision>{place}<geometry>{geometry}</geometry></collision>"


def a_sphere(radius: float, origin: Point = ORIGIN) -> str:
    """Write a sphere."""
    return a_collision(f'<sphere radius="{radius!r}"/>', origin)


def a_box(size: Point, origin: Point = ORIGIN) -> str:
    """Write a box."""
    return a_collision(f'<box size="{_text(size)}"/>', origin)


def a_cylinder(radius: float, length: float, origin: Point = ORIGIN, rpy: Point = ORIGIN) -> str:
    """Write a cylinder."""
    return a_collision(f'<cylinder radius="{radius!r}" length="{length!r}"/>', origin, rpy)


def box_inertia(mass: float, size: Point) -> Point:
    """Find the moments of a box."""
    x, y, z = (side * side for side in size)
    return (mass * (y + z) / 12.0, mass * (x + z) / 12.0, mass * (x + y) / 12.0)


def wheel_inertia(mass: float, radius: float, width: float) -> Point:
    """Find the moments of a cylinder along y."""
    across = mass * (3.0 * radius * radius + width * width) / 12.0
    return (across, mass * radius * radius / 2.0, across)


@dataclass(frozen=True)
class Chassis:
    """Size and weight of a robot; the base is at the height of the axles.

    Attributes:
        mass: Of the base [kg].
        wheel_mass: Of each wheel [kg].
        com: Of the base, from the middle of the axle.
    """

    mass: float = 5.0
    radius: float = 0.05
    track: float = 0.3
    wheel_mass: float = 0.25
    com: Point = (0.0, 0.0, 0.0)
    surface: Surface = Surface()

    @property
    def width(self) -> float:
        """Width of a wheel."""
        return 0.4 * self.radius

    @property
    def reach(self) -> float:
        """Distance of casters from the axle."""
        return 0.5 * self.track

    def start(self, name: str, *shapes: str) -> UrdfText:
        """Write the base."""
        urdf = UrdfText(name)
        size = (1.2 * self.track, 0.7 * self.track, max(self.radius, 0.2 * self.track))
        body = a_box(size, (0.0, 0.0, 0.2 * self.radius + size[2] / 2.0))
        urdf.link("base_link", self.mass, box_inertia(self.mass, size), body, *shapes, com=self.com)
        return urdf

    def wheel(
        self,
        urdf: UrdfText,
        name: str,
        place: tuple[float, float],
        *,
        parent: str = "base_link",
        surface: Surface | None = None,
    ) -> None:
        """Add a wheel on an axle along y."""
        self.bare_wheel(urdf, name, self.radius, surface or self.surface)
        urdf.joint(f"{name}_joint", "continuous", (parent, name), (*place, 0.0))

    def bare_wheel(
        self,
        urdf: UrdfText,
        name: str,
        radius: float,
        surface: Surface,
        axle_rad: float = math.pi / 2,
    ) -> None:
        """Add a wheel without a joint; its axle points in this direction on the ground."""
        moments = wheel_inertia(self.wheel_mass, radius, self.width)
        level = (math.pi / 2.0, 0.0, axle_rad - math.pi / 2.0)
        shape = a_cylinder(radius, self.width, rpy=level)
        urdf.link(name, self.wheel_mass, moments, shape, surface=surface)

    def foot(self, urdf: UrdfText, name: str, x: float, shape: str, mu: float) -> None:
        """Add a foot at x that is fixed to the base; the shape's lowest point is at z = 0."""
        mass = 0.01 * self.mass
        urdf.link(name, mass, box_inertia(mass, (0.02, 0.02, 0.02)), shape, surface=Surface(mu))
        urdf.joint(f"{name}_joint", "fixed", ("base_link", name), (x, 0.0, -self.radius))

    def ball(self, urdf: UrdfText, x: float, mu: float = 0.0, name: str = "caster") -> None:
        """Add a fixed sphere at x."""
        radius = 0.4 * self.radius
        self.foot(urdf, name, x, a_sphere(radius, (0.0, 0.0, radius)), mu)

    def swivel(self, urdf: UrdfText, name: str, place: tuple[float, float]) -> None:
        """Add a caster wheel that swivels."""
        radius, trail = 0.5 * self.radius, 0.4 * self.radius
        mass = 0.5 * self.wheel_mass
        urdf.link(f"{name}_fork", mass, wheel_inertia(mass, radius, radius))
        urdf.joint(
            f"{name}_swivel",
            "continuous",
            ("base_link", f"{name}_fork"),
            (*place, radius - self.radius),
            (0.0, 0.0, 1.0),
        )
        self.bare_wheel(urdf, name, radius, Surface())
        urdf.joint(f"{name}_joint", "continuous", (f"{name}_fork", name), (-trail, 0.0, 0.0))


def diff_tags(
    chassis: Chassis, pairs: int = 1, *, torque: float = 0.0, scale: tuple[float, float] = (1, 1)
) -> str:
    """Write the tags of the ROS 2 plug-in; `scale` of diameter and separation."""
    # Enough to make all wheels slip.
    effort = torque or 20.0 * chassis.mass * chassis.radius * max(chassis.surface.mu, 1.0)
    tags = f"<num_wheel_pairs>{pairs}</num_wheel_pairs><update_rate>0</update_rate>"
    for number in range(pairs):
        tags += f"<left_joint>left{number}_joint</left_joint>"
        tags += f"<right_joint>right{number}_joint</right_joint>"
        tags += f"<wheel_separation>{chassis.track * scale[1]!r}</wheel_separation>"
        tags += f"<wheel_diameter>{2.0 * chassis.radius * scale[0]!r}</wheel_diameter>"
    return tags + f"<max_wheel_torque>{effort!r}</max_wheel_torque>"


DIFF_PLUGIN = "libgazebo_ros_diff_drive.so"


def start_diff(name: str, chassis: Chassis, *shapes: str) -> UrdfText:
    """Write base and both wheels."""
    urdf = chassis.start(name, *shapes)
    for side, y in (("left0", chassis.track / 2.0), ("right0", -chassis.track / 2.0)):
        chassis.wheel(urdf, side, (0.0, y))
    return urdf


def a_diff(name: str, chassis: Chassis, mu: float = 0.0) -> WheelRobot:
    """Make a robot with two wheels and a sphere in front and behind."""
    urdf = start_diff(name, chassis)
    chassis.ball(urdf, chassis.reach, mu, "front_caster")
    chassis.ball(urdf, -chassis.reach, mu, "rear_caster")
    urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
    return WheelRobot(name, urdf.text())


def list_sizes() -> Iterator[WheelRobot]:
    """Make robots of all sizes and masses."""
    for ratio in (1, 10, 100, 1000):
        yield a_diff(f"mass_ratio_{ratio}", Chassis(wheel_mass=5.0 / ratio))
    for radius in (0.01, 0.03, 0.1, 0.3):
        chassis = Chassis(radius=radius, track=max(6.0 * radius, 0.1) if radius < 0.1 else 0.6)
        yield a_diff(f"radius_{radius:g}_m", chassis)
    for mass, radius in ((0.1, 0.02), (1.0, 0.03), (20.0, 0.1), (100.0, 0.1), (500.0, 0.3)):
        chassis = Chassis(mass, radius, 5.0 * radius, wheel_mass=0.03 * mass)
        yield a_diff(f"mass_{mass:g}_kg", chassis)
    yield a_diff("light_wheels_20_g", Chassis(2.5, 0.03, 0.16, 0.02))
    wide = Chassis(track=0.4)
    for name, com in (
        ("com_behind", (-0.1, 0.0, 0.0)),
        ("com_ahead", (0.1, 0.0, 0.0)),
        ("com_high", (0.0, 0.0, 0.15)),
    ):
        yield a_diff(name, replace(wide, com=com))
    # On three supports, which share the load in one way.
    aside = replace(wide, com=(-0.05, 0.1, 0.0))
    urdf = start_diff("com_left", aside)
    aside.ball(urdf, -aside.reach)
    urdf.plugin(DIFF_PLUGIN, diff_tags(aside))
    yield WheelRobot("com_left", urdf.text())


def list_casters() -> Iterator[WheelRobot]:
    """Make robots with two driven wheels and one support of each kind."""
    chassis = Chassis(com=(-0.03, 0.0, 0.0))
    at = -chassis.reach
    for mu in (0.1, 0.5, 1.0):
        urdf = start_diff(name := f"ball_mu_{mu:g}", chassis)
        chassis.ball(urdf, at, mu)
        urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
        yield WheelRobot(name, urdf.text())
    heavy = replace(chassis, com=(-0.11, 0.0, 0.0))
    for mu in (0.7, 1.0):
        urdf = start_diff(name := f"ball_under_most_of_the_load_mu_{mu:g}", heavy)
        heavy.ball(urdf, at, mu)
        urdf.plugin(DIFF_PLUGIN, diff_tags(heavy))
        yield WheelRobot(name, urdf.text())
    for name, shape, mu in (
        ("cylinder_foot", a_cylinder(0.02, 0.04, (0.0, 0.0, 0.02)), 0.1),
        ("box_foot", a_box((0.04, 0.04, 0.04), (0.0, 0.0, 0.02)), 0.2),
        ("capsule_foot", _a_level_capsule(0.02, 0.04), 0.2),
        ("fixed_roller", a_cylinder(0.02, 0.04, (0.0, 0.0, 0.02), LEVEL_RPY), 0.3),
    ):
        urdf = start_diff(name, chassis)
        chassis.foot(urdf, "foot", at, shape, mu)
        urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
        yield WheelRobot(name, urdf.text())
    yield from _list_rolling_casters(chassis)


def _a_level_capsule(radius: float, length: float) -> str:
    ends = (length / 2.0, -length / 2.0)
    return "".join(a_sphere(radius, (0.0, y, radius)) for y in ends)


def _list_rolling_casters(chassis: Chassis) -> Iterator[WheelRobot]:
    urdf = start_diff("swivel_behind", chassis)
    chassis.swivel(urdf, "caster", (-chassis.reach, 0.0))
    urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
    yield WheelRobot("swivel_behind", urdf.text())
    level = replace(chassis, com=ORIGIN)
    urdf = start_diff("swivels_all_around", level)
    for number, (ahead, aside) in enumerate(CORNERS):
        place = (ahead * level.reach, aside * 0.3 * level.track)
        level.swivel(urdf, f"caster{number}", place)
    urdf.plugin(DIFF_PLUGIN, diff_tags(level))
    yield WheelRobot("swivels_all_around", urdf.text())
    yield from _list_passive_wheels(chassis)


def _list_passive_wheels(chassis: Chassis) -> Iterator[WheelRobot]:
    urdf = start_diff("feather_caster_1_g", chassis)
    radius = 0.4 * chassis.radius
    shape = a_sphere(radius, (0.0, 0.0, radius - chassis.radius))
    urdf.link("feather", 0.001, (1e-6, 1e-6, 1e-6))
    urdf.joint(
        "feather_joint",
        "continuous",
        ("base_link", "feather"),
        (-chassis.reach, 0.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    urdf.link("caster", 0.001, (1e-6, 1e-6, 1e-6), shape, surface=Surface(0.1))
    urdf.joint("caster_joint", "continuous", ("feather", "caster"), ORIGIN, (0.0, 0.0, 1.0))
    urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
    yield WheelRobot("feather_caster_1_g", urdf.text())
    urdf = start_diff("free_ball_wheel", chassis)
    small = replace(chassis, wheel_mass=0.05)
    small.bare_wheel(urdf, "roller", 0.5 * chassis.radius, Surface(0.2))
    place = (-chassis.reach, 0.0, -0.5 * chassis.radius)
    urdf.joint("roller_joint", "continuous", ("base_link", "roller"), place)
    urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
    yield WheelRobot("free_ball_wheel", urdf.text())
    urdf = start_diff("passive_front_wheels", chassis)
    for side, y in (("left1", chassis.track / 2.0), ("right1", -chassis.track / 2.0)):
        chassis.wheel(urdf, side, (chassis.reach, y))
    chassis.ball(urdf, -chassis.reach)
    urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
    yield WheelRobot("passive_front_wheels", urdf.text())


def list_springs() -> Iterator[WheelRobot]:
    """Make robots with suspensions."""
    chassis = Chassis()
    urdf = start_diff("sprung_casters", chassis)
    for name, x in (("front", chassis.reach), ("rear", -chassis.reach)):
        radius = 0.4 * chassis.radius
        urdf.link(name, 0.05, (1e-5, 1e-5, 1e-5), a_sphere(radius), surface=Surface(0.1))
        place = (x, 0.0, radius - chassis.radius - 0.002)
        urdf.joint(
            f"{name}_spring",
            "prismatic",
            ("base_link", name),
            place,
            (0.0, 0.0, 1.0),
            tags=a_range(0.02, 20.0),
        )
        urdf.spring(f"{name}_spring", 1000.0, 0.0)
    urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
    yield WheelRobot("sprung_casters", urdf.text())
    urdf = chassis.start("sprung_wheels")
    for side, y in (("left0", chassis.track / 2.0), ("right0", -chassis.track / 2.0)):
        urdf.link(f"{side}_arm", 0.2, (1e-4, 1e-4, 1e-4))
        urdf.joint(
            f"{side}_spring",
            "prismatic",
            ("base_link", f"{side}_arm"),
            (0.0, y, 0.0),
            (0.0, 0.0, -1.0),
            tags=a_range(0.02, 50.0),
        )
        chassis.wheel(urdf, side, (0.0, 0.0), parent=f"{side}_arm")
        urdf.spring(f"{side}_spring", 4000.0, 0.005)
    chassis.ball(urdf, chassis.reach, 0.1, "front_caster")
    chassis.ball(urdf, -chassis.reach, 0.1, "rear_caster")
    urdf.plugin(DIFF_PLUGIN, diff_tags(chassis))
    yield WheelRobot("sprung_wheels", urdf.text())


def a_skid(name: str, chassis: Chassis, places: tuple[float, ...]) -> WheelRobot:
    """Make a skid-steered robot with a pair of wheels at each x."""
    urdf = chassis.start(name)
    for number, x in enumerate(places):
        for side, y in (("left", chassis.track / 2.0), ("right", -chassis.track / 2.0)):
            chassis.wheel(urdf, f"{side}{number}", (x, y))
    urdf.plugin("libgazebo_ros_skid_steer_drive.so", diff_tags(chassis, len(places)))
    return WheelRobot(name, urdf.text())


def list_skids() -> Iterator[WheelRobot]:
    """Make skid-steered robots with four to eight wheels."""
    chassis = Chassis(20.0, 0.1, 0.5, 1.0)
    square = (-0.2, 0.2)
    yield a_skid("skid_square", chassis, square)
    yield a_skid("skid_short", chassis, (-0.11, 0.11))
    yield a_skid("skid_long", chassis, (-0.35, 0.35))
    yield a_skid("skid_mu_0.5", replace(chassis, surface=Surface(0.5)), square)
    yield a_skid("skid_light_wheels", replace(chassis, wheel_mass=0.05), square)
    yield a_skid("skid_heavy_wheels", replace(chassis, wheel_mass=5.0), square)
    yield a_skid("skid_com_behind", replace(chassis, com=(-0.1, 0.0, 0.0)), square)
    yield a_skid("skid_com_left", replace(chassis, com=(0.0, 0.1, 0.0)), square)
    yield a_skid("skid_500_kg", Chassis(500.0, 0.3, 1.2, 10.0), (-0.5, 0.5))
    yield a_skid("skid_small", Chassis(1.0, 0.03, 0.15, 0.03), (-0.06, 0.06))
    yield a_skid("skid_six_wheels", chassis, (-0.25, 0.0, 0.25))
    yield a_skid("skid_eight_wheels", chassis, (-0.36, -0.12, 0.12, 0.36))


def list_directions() -> Iterator[WheelRobot]:
    """Make robots whose wheels have a friction direction."""
    chassis = Chassis(20.0, 0.1, 0.5, 1.0)
    ahead = replace(chassis, surface=Surface(3.0, 1.0, (1.0, 0.0, 0.0)))
    yield a_skid("skid_fdir1_ahead", ahead, (-0.2, 0.2))
    # In the frame of the collision, whose z is the axle.
    axle = replace(chassis, surface=Surface(0.5, 1.0, (0.0, 0.0, 1.0)))
    yield a_skid("skid_fdir1_axle", axle, (-0.2, 0.2))
    upright = replace(chassis, surface=Surface(0.5, 1.0, (0.0, 1.0, 0.0)))
    yield a_skid("skid_fdir1_upright", upright, (-0.2, 0.2))
    alike = replace(chassis, surface=Surface(1.0, 1.0, (1.0, 0.0, 0.0)))
    yield a_skid("skid_fdir1_alike", alike, (-0.2, 0.2))
    yield a_diff("diff_fdir1_ahead", Chassis(surface=Surface(1.0, 0.5, (1.0, 0.0, 0.0))), 0.1)


def list_contacts() -> Iterator[WheelRobot]:
    """Make robots with soft contacts, great friction, wrong sizes or weak motors."""
    yield a_diff("mu_10", Chassis(surface=Surface(10.0)), 0.1)
    yield a_diff("mu_100", Chassis(surface=Surface(100.0)), 0.1)
    yield a_diff("soft_wheels", Chassis(surface=Surface(1.0, kp=1e5, kd=1e3)), 0.0)
    yield a_diff("kp_1e7", Chassis(surface=Surface(1.0, kp=1e7, kd=1.0)), 0.0)
    chassis = Chassis()
    for name, scale in (("diameter_10_percent_off", (1.1, 1.0)), ("track_10_off", (1.0, 1.1))):
        urdf = start_diff(name, chassis)
        chassis.ball(urdf, chassis.reach, 0.0, "front_caster")
        chassis.ball(urdf, -chassis.reach, 0.0, "rear_caster")
        urdf.plugin(DIFF_PLUGIN, diff_tags(chassis, scale=scale))
        yield WheelRobot(name, urdf.text())


def a_car(name: str, chassis: Chassis, wheelbase: float) -> WheelRobot:
    """Make a car with Ackermann steering; the base is over the rear axle."""
    centred = replace(chassis, com=(wheelbase / 2.0, 0.0, 0.0))
    urdf = centred.start(name)
    half, side_mass = chassis.track / 2.0, chassis.wheel_mass
    for side, y in (("left", half), ("right", -half)):
        chassis.wheel(urdf, f"rear_{side}", (0.0, y))
        urdf.link(
            f"{side}_steering", side_mass, wheel_inertia(side_mass, chassis.radius, chassis.radius)
        )
        urdf.joint(
            f"{side}_steering_joint",
            "revolute",
            ("base_link", f"{side}_steering"),
            (wheelbase, y, 0.0),
            (0.0, 0.0, 1.0),
            tags=a_range(1.5),
        )
        chassis.wheel(urdf, f"front_{side}", (0.0, 0.0), parent=f"{side}_steering")
    names = ("rear_left", "rear_right", "front_left", "front_right")
    tags = "".join(f"<{one}_joint>{one}_joint</{one}_joint>" for one in names)
    for side in ("left", "right"):
        tags += f"<{side}_steering_joint>{side}_steering_joint</{side}_steering_joint>"
    tags += "<max_steer>0.6</max_steer><max_speed>5</max_speed><update_rate>0</update_rate>"
    urdf.plugin("libgazebo_ros_ackermann_drive.so", tags)
    return WheelRobot(name, urdf.text())


def a_tricycle(name: str, chassis: Chassis, wheelbase: float) -> WheelRobot:
    """Make a tricycle whose front wheel drives and steers."""
    centred = replace(chassis, com=(wheelbase / 2.0, 0.0, 0.0))
    urdf = centred.start(name)
    for side, y in (("left", chassis.track / 2.0), ("right", -chassis.track / 2.0)):
        chassis.wheel(urdf, f"{side}_wheel", (0.0, y))
    mass = chassis.wheel_mass
    urdf.link("fork", mass, wheel_inertia(mass, chassis.radius, chassis.radius))
    urdf.joint(
        "front_steering_joint",
        "revolute",
        ("base_link", "fork"),
        (wheelbase, 0.0, 0.0),
        (0.0, 0.0, 1.0),
        tags=a_range(1.6),
    )
    chassis.wheel(urdf, "front_wheel", (0.0, 0.0), parent="fork")
    torque = 20.0 * chassis.mass * chassis.radius
    diameter = 2.0 * chassis.radius
    tags = (
        f"<actuated_wheel_diameter>{diameter!r}</actuated_wheel_diameter>"
        f"<encoder_wheel_diameter>{diameter!r}</encoder_wheel_diameter>"
        f"<wheel_separation>{chassis.track!r}</wheel_separation>"
        f"<max_wheel_torque>{torque!r}</max_wheel_torque><update_rate>0</update_rate>"
    )
    urdf.plugin("libgazebo_ros_tricycle_drive.so", tags)
    return WheelRobot(name, urdf.text())


def a_mover(name: str, chassis: Chassis, *, has_wheels: bool) -> WheelRobot:
    """Make a robot that moves as commanded in the plane."""
    shape = a_box((1.2 * chassis.track, 0.7 * chassis.track, chassis.radius))
    urdf = chassis.start(name, *([] if has_wheels else [shape]))
    if has_wheels:
        for number, (ahead, aside) in enumerate(CORNERS):
            place = (0.5 * ahead * chassis.track, 0.5 * aside * chassis.track)
            chassis.wheel(urdf, f"wheel{number}", place)
    urdf.plugin("libgazebo_ros_planar_move.so", "<update_rate>0</update_rate>")
    return WheelRobot(name, urdf.text())


def list_ordered_drives() -> Iterator[WheelRobot]:
    """Make robots whose drive the spawn request orders."""
    chassis = Chassis(20.0, 0.1, 0.5, 0.5)
    wheels = ("rear_left_joint", "rear_right_joint", "left_steering_joint", "right_steering_joint")
    car = a_car("car_by_turn_rate", chassis, 0.8)
    yield replace(car, order=DriveOrder("ackermann", wheels))
    tricycle = a_tricycle("tricycle_by_turn_rate", chassis, 0.8)
    order = DriveOrder("tricycle", ("front_wheel_joint", "front_steering_joint"))
    yield replace(tricycle, order=order)
    mover = a_mover("mecanum", chassis, has_wheels=True)
    # Front left, front right, rear left, rear right.
    yield replace(
        mover, order=DriveOrder("mecanum", tuple(f"wheel{number}_joint" for number in range(4)))
    )
    urdf = chassis.start("omni_wheels")
    for number in range(3):
        turn = 2.0 * math.pi * number / 3.0
        x, y = 0.25 * math.cos(turn), 0.25 * math.sin(turn)
        chassis.bare_wheel(urdf, f"wheel{number}", chassis.radius, Surface(), turn)
        urdf.joint(
            f"wheel{number}_joint",
            "continuous",
            ("base_link", f"wheel{number}"),
            (x, y, 0.0),
            (math.cos(turn), math.sin(turn), 0.0),
        )
    joints = tuple(f"wheel{number}_joint" for number in range(3))
    yield WheelRobot("omni_wheels", urdf.text(), order=DriveOrder("omni", joints))


def list_other_drives() -> Iterator[WheelRobot]:
    """Make cars, tricycles and robots with planar drives."""
    yield a_car("car_model", Chassis(2.0, 0.03, 0.16, 0.05), 0.25)
    yield a_car("car_20_kg", Chassis(20.0, 0.1, 0.5, 0.5), 0.8)
    yield a_car("car_500_kg", Chassis(500.0, 0.3, 1.2, 15.0), 1.8)
    yield a_car("car_light_wheels", Chassis(20.0, 0.1, 0.5, 0.02), 0.8)
    yield a_tricycle("tricycle_small", Chassis(2.0, 0.03, 0.16, 0.05), 0.25)
    yield a_tricycle("tricycle_20_kg", Chassis(20.0, 0.1, 0.5, 0.5), 0.8)
    yield a_tricycle("tricycle_200_kg", Chassis(200.0, 0.15, 0.8, 5.0), 1.2)
    yield a_mover("mover_box", Chassis(5.0, 0.1, 0.3, 0.2), has_wheels=False)
    yield a_mover("mover_on_wheels", Chassis(20.0, 0.1, 0.5, 0.5), has_wheels=True)
    yield a_mover("mover_heavy", Chassis(300.0, 0.2, 0.8, 4.0), has_wheels=True)


def list_robots() -> list[WheelRobot]:
    """Make all robots of the benchmark."""
    groups = (
        list_sizes(),
        list_casters(),
        list_springs(),
        list_skids(),
        list_directions(),
        list_contacts(),
        list_other_drives(),
        list_ordered_drives(),
    )
    return [robot for group in groups for robot in group]
