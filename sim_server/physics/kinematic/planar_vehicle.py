"""Planar vehicle of a model: wheels, motors and limits; which models are eligible."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.messages.drive_messages import DiffDrive, WheelPair
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Shape
from zensim.proto.rigid_transforms import rotate, transform_point
from zensim.proto.stl import read_corners
from zensim.sim_server.description.model_geometry import (
    find_link_poses,
)
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.engine import EngineRefused, FloatArray
from zensim.sim_server.scene.footprints import Footprint, MeshTriangles, measure_footprint

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Dynamics
    from zensim.sim_server.physics.engine_config import EngineConfig


def make_mesh_reader(folder: str) -> MeshTriangles:
    """Find meshes in a folder."""

    def corners(mesh: str) -> FloatArray:
        return read_corners(Path(folder, f"{mesh}.stl").read_bytes()).astype(np.float64)

    return corners


ROUND_KINDS = ("sphere", "cylinder", "capsule")
DRIVEN_WEIGHT_SHARE = 0.5
"""Share of its weight that a robot has on its driven wheels, as a rule: it bounds how they pull."""
DEFAULT_STEERING_RAD_S = 10.0
"""How fast a joint is steered that knows no limit."""
TIPPING_RATIO = 0.8
"""Share of the acceleration that would tip a robot over up to which it stays flat."""
MIN_LENGTH_M = 1e-4


class NotPlanar(ValueError):
    """A model that cannot be driven in the plane without dynamics."""


@dataclass(frozen=True)
class VehicleWheel:
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
class VehicleMotors:
    """Actuators of one kind: where their numbers are among those of a command, and their joints."""

    places: tuple[int, ...]
    joints: tuple[int, ...]


@dataclass(frozen=True)
class PlanarVehicle:
    """What moves a robot in the plane; alike for all robots that are built alike.

    Attributes:
        width: How many numbers a command has.
        joint_count: Of the model.
        twist: Where vx, vy, wz stand in a command; -1 = wheels move it.
        driven: Motors that wheels turn by.
        steered: Motors that are told an angle.
        turned: Motors that steer by speed.
        wheels: Those that are driven, in the order of `driven`, then those that only roll.
        steering: Joints that steer, in the order that `VehicleWheel.steering` counts by.
        matrix: (3, k) root twist by the speeds of the driven wheels, row by row; empty if steered.
        axle: (x, y) in the root link about which a steered robot does not slide sideways.
        max_rim: How fast [m/s^2] wheels can gain speed.
        max_aside: Acceleration [m/s^2] sideways up to which it neither slides nor tips.
        is_tippy: Whether its wheels could tip it over.
    """

    width: int
    joint_count: int
    twist: int
    driven: VehicleMotors
    steered: VehicleMotors
    turned: VehicleMotors
    wheels: tuple[VehicleWheel, ...]
    steering: tuple[int, ...]
    matrix: tuple[float, ...]
    axle: tuple[float, float]
    max_rim_accel: float
    max_lateral_accel: float
    can_tip: bool
    steering_rad_s: tuple[float, ...]

    @property
    def pivot(self) -> tuple[float, float] | None:
        """What it turns on the spot about; None where it cannot, or may choose."""
        if not self.matrix:
            return None
        return self.axle


def make_planar_vehicle(
    model: Model, corners: MeshTriangles, gravity: float
) -> tuple[PlanarVehicle, Footprint]:
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
        raise NotPlanar("it has no drive" if drive is None else "it never moves")
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    steering = tuple(index[name] for name in drive.steering_joints)
    wheels = [_make_wheel(model, index[name], steering) for name in _list_wheel_joints(model)]
    matrix, axle = _find_drive_matrix(wheels, model)
    planned = _VehicleGeometry(model, index, steering, tuple(wheels), matrix, axle)
    footprint = measure_footprint(model, corners, axle if matrix else None)
    return planned.vehicle(footprint, gravity), footprint


@dataclass(frozen=True)
class _VehicleGeometry:
    model: Model
    index: dict[str, int]
    steering: tuple[int, ...]
    wheels: tuple[VehicleWheel, ...]
    matrix: tuple[float, ...]
    axle: tuple[float, float]

    def vehicle(self, footprint: Footprint, gravity: float) -> PlanarVehicle:
        plan = make_actuation(self.model)
        speeds = list(zip(plan.speeds.columns, plan.speeds.joints, strict=True))
        turned_by = set(self.steering)
        friction = min(1.0, min((s.friction for s in _list_tyres(self.model)), default=1.0))
        grip = friction * gravity
        ahead, aside = _find_tipping_limits(self.model, footprint, gravity)
        pull = min(DRIVEN_WEIGHT_SHARE * grip, self._effort())
        return PlanarVehicle(
            width=plan.width,
            joint_count=len(self.model.joints),
            twist=-1 if plan.twist is None else plan.twist,
            driven=_make_motors([one for one in speeds if one[1] not in turned_by]),
            steered=_make_motors(list(zip(plan.angles.columns, plan.angles.joints, strict=True))),
            turned=_make_motors([one for one in speeds if one[1] in turned_by]),
            wheels=self.wheels,
            steering=self.steering,
            matrix=self.matrix,
            axle=self.axle,
            max_rim_accel=min(pull, ahead),
            max_lateral_accel=min(grip, aside),
            can_tip=pull > ahead,
            steering_rad_s=tuple(
                self.model.joints[joint].velocity or DEFAULT_STEERING_RAD_S
                for joint in plan.angles.joints
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
        return sum(forces) / max(self.model.mass_kg, MIN_LENGTH_M)


def _make_motors(pairs: list[tuple[int, int]]) -> VehicleMotors:
    return VehicleMotors(tuple(place for place, _ in pairs), tuple(joint for _, joint in pairs))


def _list_wheel_joints(model: Model) -> tuple[str, ...]:
    """Name the wheels: first those that are driven, in the order of the actuators."""
    drive = model.drive
    if drive is None:
        return ()
    driven = [a.joint for a in model.actuators if a.joint in drive.wheel_joints]
    return (*driven, *(name for name in drive.wheel_joints if name not in driven))


def _make_wheel(model: Model, joint: int, steering: tuple[int, ...]) -> VehicleWheel:
    axle, link = model.joints[joint], model.links[joint + 1]
    pose = find_link_poses(model.links[0].name, model.joints)[axle.child]
    tyre = _find_tyre(link)
    radius = tyre.size[0] if tyre else _declared_radius(model, axle.name)
    ax, ay, _ = rotate(pose.orientation, axle.axis)
    length = math.hypot(ax, ay)
    if radius < MIN_LENGTH_M or length < DRIVEN_WEIGHT_SHARE:
        fault = "has no round collision" if radius < MIN_LENGTH_M else "does not lie level"
        raise NotPlanar(f"the wheel of joint '{axle.name}' {fault}")
    x, y, _ = transform_point(pose, tyre.origin.position if tyre else Origin().position)
    return VehicleWheel(
        joint,
        (x, y),
        (ay / length, -ax / length),
        radius,
        _find_steering_joint(model, axle, steering),
    )


def _find_steering_joint(model: Model, axle: Joint, steering: tuple[int, ...]) -> int:
    parents = {joint.child: joint for joint in model.joints}
    joint: Joint | None = axle
    while joint is not None:
        for number, one in enumerate(steering):
            if model.joints[one].child == joint.parent:
                return number
        joint = parents.get(joint.parent)
    return -1


def _find_tyre(link: Link) -> Shape | None:
    rounds = [shape for shape in link.collisions if shape.kind in ROUND_KINDS]
    return max(rounds, key=lambda shape: shape.size[0], default=None)


def _list_tyres(model: Model) -> list[Shape]:
    wheels = set(model.drive.wheel_joints) if model.drive else set()
    links = (model.links[i + 1] for i, joint in enumerate(model.joints) if joint.name in wheels)
    return [tyre for link in links if (tyre := _find_tyre(link)) is not None]


def _declared_radius(model: Model, joint: str) -> float:
    drive = model.drive
    pairs: tuple[WheelPair, ...] = drive.pairs if isinstance(drive, DiffDrive) else ()
    for pair in pairs:
        if joint in (pair.left_joint, pair.right_joint):
            return pair.diameter_m / 2.0
    return 0.0


def _find_drive_matrix(
    wheels: list[VehicleWheel], model: Model
) -> tuple[tuple[float, ...], tuple[float, float]]:
    """Find the root twist by wheel speeds, and the point that does not slide sideways."""
    if any(actuator.mode == "twist" for actuator in model.actuators):
        return (), (0.0, 0.0)
    fixed = [wheel for wheel in wheels if wheel.steering < 0]
    if len(fixed) == len(wheels):
        return _solve_drive_matrix(wheels)
    if not fixed:
        raise NotPlanar("it has no wheel that is not steered")
    x, y = np.mean([wheel.place for wheel in fixed], axis=0).tolist()
    return (), (x, y)


def _solve_drive_matrix(
    wheels: list[VehicleWheel],
) -> tuple[tuple[float, ...], tuple[float, float]]:
    rolled, held = [], []
    for wheel in wheels:
        (x, y), (fx, fy) = wheel.place, wheel.ahead
        rolled.append([fx, fy, x * fy - y * fx])
        held.append([-fy, fx, x * fx + y * fy])
    rows: FloatArray = np.array(rolled + held)
    if np.linalg.matrix_rank(rows, tol=MIN_LENGTH_M) < rows.shape[1]:
        raise NotPlanar("its wheels leave open where it goes: it needs two on either side")
    radii = np.diag([wheel.radius_m for wheel in wheels])
    found = np.linalg.pinv(rows) @ np.vstack([radii, np.zeros_like(radii)])
    x, y = np.mean([wheel.place for wheel in wheels], axis=0).tolist()
    return tuple(found.ravel().tolist()), (x, y)


def _find_tipping_limits(model: Model, footprint: Footprint, gravity: float) -> tuple[float, float]:
    """Find the accelerations [m/s^2] ahead and aside that tip a robot over, less some margin."""
    poses = find_link_poses(model.links[0].name, model.joints)
    places = np.array(
        [transform_point(poses[link.name], link.inertial.com_in_link) for link in model.links]
    )
    masses = np.array([max(link.inertial.mass_kg, MIN_LENGTH_M**2) for link in model.links])
    x, y, z = (masses @ places / masses.sum()).tolist()
    height = max(z - footprint.low, MIN_LENGTH_M)
    least, most = footprint.feet.min(axis=0), footprint.feet.max(axis=0)
    ahead = max(float(min(x - least[0], most[0] - x)), 0.0)
    aside = max(float(min(y - least[1], most[1] - y)), 0.0)
    share = TIPPING_RATIO * gravity / height
    return share * ahead, share * aside


MAX_CACHED_PLANS = 256

PlanarPlan = tuple[PlanarVehicle, Footprint]


class PlanarPlanCache:
    """Plans of the models seen last."""

    def __init__(self, config: EngineConfig, default: Dynamics) -> None:
        self.corners = make_mesh_reader(config.mesh_folder)
        self._folder = config.mesh_folder
        self._gravity = max(-config.gravity[2], 0.0)
        self._default: Dynamics = default or "full"
        self._plans: dict[int, tuple[Model, PlanarPlan | None]] = {}

    def dynamics(self, model: Model) -> Dynamics:
        """Say which dynamics a model asks for, or else the world."""
        return "full" if model.is_static else model.dynamics or self._default

    def plan(self, model: Model) -> PlanarPlan | None:
        """Find how a model is driven flat; None where it is full, always or for want of a drive.

        Raises:
            EngineRefused: It asks to be kinematic and cannot.
        """
        if self.dynamics(model) == "full":
            return None
        if id(model) not in self._plans:
            if len(self._plans) >= MAX_CACHED_PLANS:
                del self._plans[next(iter(self._plans))]
            self._plans[id(model)] = (model, self._planned(model))
        return self._plans[id(model)][1]

    def _planned(self, model: Model) -> PlanarPlan | None:
        shapes = (shape for link in model.links for shape in link.collisions)
        if not all(Path(self._folder, f"{s.mesh}.stl").is_file() for s in shapes if s.mesh):
            return None  # the full engine says which is missing
        try:
            return make_planar_vehicle(model, self.corners, self._gravity)
        except NotPlanar as error:
            if model.dynamics == "kinematic":
                raise EngineRefused(
                    f"model '{model.name}' cannot be kinematic: {error}; use full or auto"
                ) from error
            return None
