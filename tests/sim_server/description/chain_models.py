"""URDF texts of pendulums, arms, masts and gears, with the closed forms of their loads."""

from collections.abc import Sequence

import msgspec
import numpy as np

from zensim.proto.se3 import FloatArray
from zensim.sim_server.description.world_model import EARTH_GRAVITY

GRAVITY = -EARTH_GRAVITY[2]
ARM_M, ARM_KG = 1.5, 9.0
"""Length and mass of an arm, whatever the number of its joints."""
PEDESTAL_M = 2.5
STRONG = 3.0
"""Effort limit over the greatest load that gravity can put on the first joint."""
WEAK = 0.5
MAST_KG = 2.0
"""Mass of each stage."""


class ArmCase(msgspec.Struct, frozen=True):
    """An arm on a pedestal that is fixed to the world.

    `turns_parallel`: all joints turn about y, so that the arm moves in a vertical plane; else they
    turn about z and y in turns.
    """

    joints: int
    payload_kg: float
    turns_parallel: bool = True
    strength: float = STRONG
    targets: tuple[float, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(f"j{i}" for i in range(self.joints))

    @property
    def axes(self) -> FloatArray:
        """Axes (n, 3) of the joints, each in its frame."""
        is_pitch = [self.turns_parallel or i % 2 == 1 for i in range(self.joints)]
        return np.where(np.array(is_pitch)[:, None], (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    @property
    def link_m(self) -> float:
        """Length of a link."""
        return ARM_M / self.joints

    @property
    def most_effort(self) -> float:
        """Effort limit [N m] of each joint."""
        return self.strength * GRAVITY * ARM_M * (ARM_KG / 2.0 + self.payload_kg)

    @property
    def aims(self) -> FloatArray:
        """Target (n,) of each joint [rad]."""
        return np.array(self.targets or (0.0,) * self.joints)

    def find_loads(self, positions: Sequence[float]) -> FloatArray:
        """Find the efforts (n,) that hold the arm: minus the moments of gravity."""
        place, turn = np.zeros(3), np.eye(3)
        pivots, axes, weights = [], [], []
        for axis, angle in zip(self.axes, positions, strict=True):
            turn = turn @ _turn_about(axis, angle)
            pivots.append(place)
            axes.append(turn @ axis)
            along = turn @ np.array([self.link_m, 0.0, 0.0])
            weights.append((place + along / 2.0, ARM_KG / self.joints))
            place = place + along
        weights.append((place, self.payload_kg))
        force = np.array([0.0, 0.0, -GRAVITY])
        return np.array(
            [
                -sum(axis @ np.cross(at - pivot, mass * force) for at, mass in weights[i:])
                for i, (pivot, axis) in enumerate(zip(pivots, axes, strict=True))
            ]
        )

    def write_urdf(self) -> str:
        """Write its URDF; the pedestal is fixed to the link `world`."""
        long, mass = self.link_m, ARM_KG / self.joints
        across = mass * long**2 / 12.0
        parts = [_pedestal()]
        parent = "pedestal"
        for i, axis in enumerate(self.axes):
            parts.append(_link(f"l{i}", mass, (1e-3 * mass, across, across), x=long / 2.0))
            height, x = (PEDESTAL_M, 0.0) if i == 0 else (0.0, long)
            parts.append(
                _joint(f"j{i}", "revolute", parent, f"l{i}", (x, 0.0, height), axis)
                + f'<limit lower="-3" upper="3" effort="{self.most_effort!r}" velocity="2"/>'
                "</joint>"
            )
            parent = f"l{i}"
        if self.payload_kg > 0.0:
            moment = 1e-3 * self.payload_kg
            parts.append(_link("payload", self.payload_kg, (moment,) * 3))
            parts.append(_joint("grip", "fixed", parent, "payload", (long, 0.0, 0.0)) + "</joint>")
        return f'<robot name="arm">{"".join(parts)}</robot>'


class MastCase(msgspec.Struct, frozen=True):
    """Stages that lift each other; each but the first mimics the first one."""

    followers: int
    payload_kg: float
    multiplier: float = 1.0
    offset: float = 0.0
    strength: float = STRONG

    @property
    def lifts_per_leader(self) -> float:
        """Load on the first joint [N] that holds the mast: the virtual work of all weights."""
        masses = [MAST_KG] * self.followers + [MAST_KG + self.payload_kg]
        rises = [1.0 + self.multiplier * stage for stage in range(self.followers + 1)]
        return GRAVITY * sum(mass * rise for mass, rise in zip(masses, rises, strict=True))

    def write_urdf(self) -> str:
        """Write its URDF: a base of 300 kg on the ground."""
        effort = self.strength * self.lifts_per_leader
        parts = [_base()]
        parent = "base"
        for stage in range(self.followers + 1):
            mass = MAST_KG + self.payload_kg * (stage == self.followers)
            parts.append(_link(f"s{stage}", mass, (0.05,) * 3))
            limit = f'<limit lower="-3" upper="3" effort="{effort!r}" velocity="0.5"/>'
            mimic = f'<mimic joint="j0" multiplier="{self.multiplier!r}" offset="{self.offset!r}"/>'
            parts.append(
                _joint(f"j{stage}", "prismatic", parent, f"s{stage}", (0.0, 0.0, 0.3), (0, 0, 1))
                + limit
                + (mimic if stage else "")
                + "</joint>"
            )
            parent = f"s{stage}"
        return f'<robot name="mast">{"".join(parts)}</robot>'


class GearCase(msgspec.Struct, frozen=True):
    """A lever that mimics a motor shaft by a ratio, and carries a weight at its end."""

    multiplier: float
    payload_kg: float
    lever_m: float = 0.5

    @property
    def shaft_effort(self) -> float:
        """Effort [N m] of the shaft that holds the lever level."""
        return -self.multiplier * GRAVITY * self.payload_kg * self.lever_m

    def write_urdf(self) -> str:
        """Write its URDF: shaft and lever side by side on a pedestal."""
        most = STRONG * abs(self.shaft_effort)
        limit = f'<limit lower="-40" upper="40" effort="{most!r}" velocity="10"/>'
        moment = 1e-3 * self.payload_kg
        return (
            f'<robot name="gear">{_pedestal()}'
            f"{_link('shaft', 0.5, (1e-3,) * 3)}"
            f"{_link('lever', self.payload_kg, (moment,) * 3, x=self.lever_m)}"
            + _joint("motor", "revolute", "pedestal", "shaft", (0, 0.2, PEDESTAL_M), (0, 1, 0))
            + f"{limit}</joint>"
            + _joint("out", "revolute", "pedestal", "lever", (0, 0, PEDESTAL_M), (0, 1, 0))
            + f'{limit}<mimic joint="motor" multiplier="{self.multiplier!r}"/></joint></robot>'
        )


class PendulumCase(msgspec.Struct, frozen=True):
    """A rod with a ball at its end, released at a small angle."""

    rod_kg: float
    rod_m: float
    ball_kg: float
    tilt_rad: float = 0.05

    @property
    def period_s(self) -> float:
        """Period of a physical pendulum at small angles, corrected for the first angle."""
        moment = self.rod_kg * self.rod_m**2 / 3.0
        moment += self.ball_kg * (self.rod_m**2 + 0.4 * self.ball_radius_m**2)
        lever = self.rod_kg * self.rod_m / 2.0 + self.ball_kg * self.rod_m
        small = 2.0 * np.pi * np.sqrt(moment / (GRAVITY * lever))
        return float(small * (1.0 + self.tilt_rad**2 / 16.0))

    @property
    def ball_radius_m(self) -> float:
        """Radius of the ball."""
        return self.rod_m / 5.0

    def write_urdf(self) -> str:
        """Write its URDF; joints are free until their first command."""
        across = self.rod_kg * self.rod_m**2 / 12.0
        own = 0.4 * self.ball_kg * self.ball_radius_m**2
        ball = ""
        if self.ball_kg > 0.0:
            ball = _link("ball", self.ball_kg, (own,) * 3)
            ball += _joint("end", "fixed", "rod", "ball", (0, 0, -self.rod_m)) + "</joint>"
        return (
            f'<robot name="pendulum">{_pedestal()}'
            + _link("rod", self.rod_kg, (across, across, 1e-4), z=-self.rod_m / 2.0)
            + f'<joint name="pivot" type="revolute"><parent link="pedestal"/><child link="rod"/>'
            f'<origin xyz="0 0 {PEDESTAL_M}" rpy="0 {self.tilt_rad!r} 0"/><axis xyz="0 1 0"/>'
            '<limit lower="-1.5" upper="1.5" effort="1" velocity="10"/>'
            f"</joint>{ball}</robot>"
        )


def write_followed_wheels() -> str:
    """Write a differential drive whose two rear wheels mimic the driven ones."""
    wheels = []
    for side, y in (("left", 0.2), ("right", -0.2)):
        for end, x in (("front", 0.15), ("rear", -0.15)):
            name = f"{end}_{side}"
            wheels.append(
                f'<link name="{name}"><inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1.5e-3"'
                ' izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>'
                '<sphere radius="0.08"/></geometry></collision></link>'
                + _joint(f"{name}_joint", "continuous", "base", name, (x, y, 0.08), (0, 1, 0))
                + (f'<mimic joint="front_{side}_joint"/>' if end == "rear" else "")
                + "</joint>"
            )
    return (
        '<robot name="followed"><link name="base"><inertial><mass value="8"/>'
        '<origin xyz="0 0 0.1"/><inertia ixx="0.1" iyy="0.2" izz="0.3" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial></link>{''.join(wheels)}"
        '<gazebo><plugin name="drive" filename="libgazebo_ros_diff_drive.so">'
        "<left_joint>front_left_joint</left_joint><right_joint>front_right_joint</right_joint>"
        "<wheel_separation>0.4</wheel_separation><wheel_diameter>0.16</wheel_diameter>"
        "<max_wheel_torque>20</max_wheel_torque></plugin></gazebo></robot>"
    )


def _turn_about(axis: FloatArray, angle: float) -> FloatArray:
    """Make the rotation matrix about a unit axis."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew)


def _pedestal() -> str:
    return (
        '<link name="world"/><link name="pedestal"/><joint name="foot" type="fixed">'
        '<parent link="world"/><child link="pedestal"/></joint>'
    )


def _base() -> str:
    return (
        '<link name="base"><inertial><mass value="300"/><origin xyz="0 0 0.05"/>'
        '<inertia ixx="30" iyy="30" izz="30" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><origin xyz="0 0 0.05"/><geometry><box size="1.2 1.2 0.1"/></geometry>'
        "</collision></link>"
    )


def _link(
    name: str, mass: float, moments: tuple[float, ...], *, x: float = 0.0, z: float = 0.0
) -> str:
    xx, yy, zz = moments
    return (
        f'<link name="{name}"><inertial><mass value="{mass!r}"/><origin xyz="{x!r} 0 {z!r}"/>'
        f'<inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
        "</link>"
    )


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: Sequence[float],
    axis: Sequence[float] = (1, 0, 0),
) -> str:
    """Write a joint without its end."""
    xyz, along = (" ".join(repr(float(number)) for number in one) for one in (place, axis))
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{along}"/>'
    )
