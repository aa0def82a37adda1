"""Drives as geometry: what wheels of a model do to its root link when none of them slips. Pure."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    PlanarMove,
    TricycleDrive,
    WheelPair,
)
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Shape
from zensim.sim_server.description.model_geometry import (
    find_link_poses,
    rotate_vector,
    transform_point,
)
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.tiers.footprint import Corners, Footprint, footprint_of

if TYPE_CHECKING:
    from zensim.sim_server.physics.engine import FloatArray

ROUND = ("sphere", "cylinder", "capsule")
GRIP = 0.5
"""Share of its weight that a robot has on its driven wheels, as a rule: it bounds how they pull."""
STEERING_RAD_S = 10.0
"""How fast a joint is steered that knows no limit."""
TIPPING = 0.8
"""Share of the acceleration that would tip a robot over up to which it stays flat."""
LEAST_M = 1e-4


class NotFlat(ValueError):
    """A model that cannot be driven in the plane without dynamics."""


@dataclass(frozen=True)
class Wheel:
    """A wheel as the links have it, joints at zero, in the root link.

    Attributes:
        joint: Index among `Model.joints`.
        place: (x, y) of its centre.
        ahead: Unit (x, y), where it rolls to when its joint turns forward.
        radius_m: > 0.
        steering: Which of the steering joints turns it; -1 = none.
    """

    joint: int
    place: tuple[float, float]
    ahead: tuple[float, float]
    radius_m: float
    steering: int


@dataclass(frozen=True)
class Motors:
    """Actuators of one kind: where their numbers are among those of a command, and their joints."""

    places: tuple[int, ...]
    joints: tuple[int, ...]


@dataclass(frozen=True)
class Vehicle:
    """What moves a robot in the plane; alike for all robots that are built alike.

    Attributes:
        width: How many numbers a command has.
        joint_count: Of the model.
        twist: Where vx, vy, wz stand in a command; -1 = wheels move it.
        driven: Motors that wheels turn by.
        steered: Motors that are told an angle.
        turned: Motors that steer by speed.
        wheels: Those that are driven, in the order of `driven`, then those that only roll.
        steering: Joints that steer, in the order that `Wheel.steering` counts by.
        matrix: (3, k) root twist by the speeds of the driven wheels, row by row; empty if steered.
        axle: (x, y) in the root link about which a steered robot does not slide sideways.
        max_rim: How fast [m/s^2] wheels can gain speed.
        max_aside: Acceleration [m/s^2] sideways up to which it neither slides nor tips.
        is_tippy: Whether its wheels could tip it over.
    """

    width: int
    joint_count: int
    twist: int
    driven: Motors
    steered: Motors
    turned: Motors
    wheels: tuple[Wheel, ...]
    steering: tuple[int, ...]
    matrix: tuple[float, ...]
    axle: tuple[float, float]
    max_rim: float
    max_aside: float
    is_tippy: bool
    steering_rad_s: tuple[float, ...]

    @property
    def pivot(self) -> tuple[float, float] | None:
        """What it turns on the spot about; None where it cannot, or may choose."""
        if not self.matrix:
            return None
        return self.axle


def vehicle_of(model: Model, corners: Corners, gravity: float) -> tuple[Vehicle, Footprint]:
    """Find how a model is driven in the plane, and the room that it takes.

    Args:
        model: A robot.
        corners: Finds those of a mesh.
        gravity: How strongly [m/s^2] it is pulled to the ground.

    Raises:
        NotFlat: It has no drive, never moves, or its wheels do not say where it goes.
    """
    drive = model.drive
    if model.is_static or drive is None:
        raise NotFlat("it has no drive" if drive is None else "it never moves")
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    steering = _steering_joints(model, index)
    wheels = [_wheel(model, index[name], steering) for name in _rolling(model)]
    matrix, axle = _moved_by(wheels, model)
    planned = _Plan(model, index, steering, tuple(wheels), matrix, axle)
    footprint = footprint_of(model, corners, axle if matrix else None)
    return planned.vehicle(footprint, gravity), footprint


@dataclass(frozen=True)
class _Plan:
    model: Model
    index: dict[str, int]
    steering: tuple[int, ...]
    wheels: tuple[Wheel, ...]
    matrix: tuple[float, ...]
    axle: tuple[float, float]

    def vehicle(self, footprint: Footprint, gravity: float) -> Vehicle:
        plan = make_actuation(self.model)
        speeds = list(zip(plan.speeds.places, plan.speeds.joints, strict=True))
        turned_by = set(self.steering)
        friction = min(1.0, min((s.friction for s in _tyres(self.model)), default=1.0))
        grip = friction * gravity
        ahead, aside = _tipping(self.model, footprint, gravity)
        pull = min(GRIP * grip, self._effort())
        return Vehicle(
            width=plan.width,
            joint_count=len(self.model.joints),
            twist=-1 if plan.twist is None else plan.twist,
            driven=_motors([one for one in speeds if one[1] not in turned_by]),
            steered=_motors(list(zip(plan.angles.places, plan.angles.joints, strict=True))),
            turned=_motors([one for one in speeds if one[1] in turned_by]),
            wheels=self.wheels,
            steering=self.steering,
            matrix=self.matrix,
            axle=self.axle,
            max_rim=min(pull, ahead),
            max_aside=min(grip, aside),
            is_tippy=pull > ahead,
            steering_rad_s=tuple(
                self.model.joints[joint].velocity or STEERING_RAD_S for joint in plan.angles.joints
            ),
        )

    def _effort(self) -> float:
        """How fast [m/s^2] the motors could make it faster if all wheels gripped."""
        radius = {wheel.joint: wheel.radius_m for wheel in self.wheels}
        forces = [
            actuator.effort / radius[self.index[actuator.joint]]
            for actuator in self.model.actuators
            if actuator.mode == "velocity" and self.index[actuator.joint] in radius
        ]
        return sum(forces) / max(self.model.mass_kg, LEAST_M)


def _motors(pairs: list[tuple[int, int]]) -> Motors:
    return Motors(tuple(place for place, _ in pairs), tuple(joint for _, joint in pairs))


def _rolling(model: Model) -> tuple[str, ...]:
    """Name the wheels: first those that are driven, in the order of the actuators."""
    drive = model.drive
    if drive is None or isinstance(drive, PlanarMove):
        return ()
    driven = [a.joint for a in model.actuators if a.joint in drive.wheel_joints]
    return (*driven, *(name for name in drive.wheel_joints if name not in driven))


def _steering_joints(model: Model, index: dict[str, int]) -> tuple[int, ...]:
    drive = model.drive
    if isinstance(drive, AckermannDrive):
        return (index[drive.left_steering_joint], index[drive.right_steering_joint])
    return (index[drive.steering_joint],) if isinstance(drive, TricycleDrive) else ()


def _wheel(model: Model, joint: int, steering: tuple[int, ...]) -> Wheel:
    axle, link = model.joints[joint], model.links[joint + 1]
    pose = find_link_poses(model.links[0].name, model.joints)[axle.child]
    tyre = _tyre(link)
    radius = tyre.size[0] if tyre else _written_radius(model, axle.name)
    ax, ay, _ = rotate_vector(pose, axle.axis)
    length = math.hypot(ax, ay)
    if radius < LEAST_M or length < GRIP:
        fault = "has no round collision" if radius < LEAST_M else "does not lie level"
        raise NotFlat(f"the wheel of joint '{axle.name}' {fault}")
    x, y, _ = transform_point(pose, tyre.origin.position if tyre else Origin().position)
    return Wheel(
        joint, (x, y), (ay / length, -ax / length), radius, _turned_by(model, axle, steering)
    )


def _turned_by(model: Model, axle: Joint, steering: tuple[int, ...]) -> int:
    parents = {joint.child: joint for joint in model.joints}
    joint: Joint | None = axle
    while joint is not None:
        for number, one in enumerate(steering):
            if model.joints[one].child == joint.parent:
                return number
        joint = parents.get(joint.parent)
    return -1


def _tyre(link: Link) -> Shape | None:
    rounds = [shape for shape in link.collisions if shape.kind in ROUND]
    return max(rounds, key=lambda shape: shape.size[0], default=None)


def _tyres(model: Model) -> list[Shape]:
    wheels = set(model.drive.wheel_joints) if model.drive else set()
    links = (model.links[i + 1] for i, joint in enumerate(model.joints) if joint.name in wheels)
    return [tyre for link in links if (tyre := _tyre(link)) is not None]


def _written_radius(model: Model, joint: str) -> float:
    drive = model.drive
    pairs: tuple[WheelPair, ...] = drive.pairs if isinstance(drive, DiffDrive) else ()
    for pair in pairs:
        if joint in (pair.left_joint, pair.right_joint):
            return pair.diameter_m / 2.0
    return 0.0


def _moved_by(wheels: list[Wheel], model: Model) -> tuple[tuple[float, ...], tuple[float, float]]:
    """Find the root twist by wheel speeds, and the point that does not slide sideways."""
    if isinstance(model.drive, PlanarMove):
        return (), (0.0, 0.0)
    fixed = [wheel for wheel in wheels if wheel.steering < 0]
    if len(fixed) == len(wheels):
        return _matrix(wheels)
    if not fixed:
        raise NotFlat("it has no wheel that is not steered")
    x, y = np.mean([wheel.place for wheel in fixed], axis=0).tolist()
    return (), (x, y)


def _matrix(wheels: list[Wheel]) -> tuple[tuple[float, ...], tuple[float, float]]:
    rolled, held = [], []
    for wheel in wheels:
        (x, y), (fx, fy) = wheel.place, wheel.ahead
        rolled.append([fx, fy, x * fy - y * fx])
        held.append([-fy, fx, x * fx + y * fy])
    rows: FloatArray = np.array(rolled + held)
    if np.linalg.matrix_rank(rows, tol=LEAST_M) < rows.shape[1]:
        raise NotFlat("its wheels leave open where it goes: it needs two on either side")
    radii = np.diag([wheel.radius_m for wheel in wheels])
    found = np.linalg.pinv(rows) @ np.vstack([radii, np.zeros_like(radii)])
    x, y = np.mean([wheel.place for wheel in wheels], axis=0).tolist()
    return tuple(found.ravel().tolist()), (x, y)


def _tipping(model: Model, footprint: Footprint, gravity: float) -> tuple[float, float]:
    """Find the accelerations [m/s^2] ahead and aside that tip a robot over, less some margin."""
    poses = find_link_poses(model.links[0].name, model.joints)
    places = np.array(
        [transform_point(poses[link.name], link.inertial.com_in_link) for link in model.links]
    )
    masses = np.array([max(link.inertial.mass_kg, LEAST_M**2) for link in model.links])
    x, y, z = (masses @ places / masses.sum()).tolist()
    height = max(z - footprint.low, LEAST_M)
    least, most = footprint.feet.min(axis=0), footprint.feet.max(axis=0)
    ahead = max(float(min(x - least[0], most[0] - x)), 0.0)
    aside = max(float(min(y - least[1], most[1] - y)), 0.0)
    share = TIPPING * gravity / height
    return share * ahead, share * aside
