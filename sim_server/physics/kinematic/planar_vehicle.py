"""Planar vehicle of a model: wheels, motors and limits; which models are eligible."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.messages.drive_messages import DiffDrive, OmniDrive, SteeringDrive, WheelPair
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Shape
from zensim.proto.rigid_transforms import rotate, transform_point
from zensim.proto.stl import read_corners
from zensim.sim_server.description.mimic_joints import FollowingJoint, list_following_joints
from zensim.sim_server.description.model_geometry import find_link_poses
from zensim.sim_server.description.motion_prediction import (
    find_drive_targets,
    predict_nominal_motions,
)
from zensim.sim_server.physics.actuation import JointMotor, make_actuation
from zensim.sim_server.physics.engine import EngineRefused, FloatArray
from zensim.sim_server.scene.footprints import Footprint, MeshTriangles, measure_footprint

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Dynamics
    from zensim.sim_server.physics.engine_config import EngineConfig

ROUND_KINDS = ("sphere", "cylinder", "capsule")
DRIVEN_WEIGHT_SHARE = 0.5
"""Assumed share of the weight on driven wheels; it bounds their traction."""
DEFAULT_STEERING_RAD_S = 10.0
"""Speed of a steering joint without a velocity limit."""
TIPPING_RATIO = 0.8
"""Share of the tipping acceleration that is allowed."""
MIN_LENGTH_M = 1e-4
ROLLING_TOLERANCE = 1e-4
"""Difference [m/s, rad/s] from the predicted motion up to which wheels count as rolling."""
MAX_CACHED_PLANS = 256


def make_mesh_reader(folder: str) -> MeshTriangles:
    """Make a reader of the meshes in a folder."""
    return partial(_read_mesh, folder)


def _read_mesh(folder: str, mesh: str) -> FloatArray:
    return read_corners(Path(folder, f"{mesh}.stl").read_bytes()).astype(np.float64)


class NotPlanar(ValueError):
    """A model whose motion in the plane cannot be computed without dynamics."""


@dataclass(frozen=True)
class VehicleWheel:
    """A wheel in the root link at joint positions 0.

    Attributes:
        joint: Index among `Model.joints`.
        place: (x, y) of its centre.
        ahead: Unit (x, y) of rolling at positive joint speed.
        radius_m: > 0.
        steering: Index of its steering joint in `PlanarVehicle.steering`; -1 = none.
    """

    joint: int
    place: tuple[float, float]
    ahead: tuple[float, float]
    radius_m: float
    steering: int


@dataclass(frozen=True)
class VehicleMotors:
    """Actuators of one kind: indices of their targets in a command, and of their joints."""

    places: tuple[int, ...]
    joints: tuple[int, ...]


@dataclass(frozen=True)
class MovedJoint:
    """A controlled joint that no wheel is on: nothing but its target moves it.

    Attributes:
        place: Index of its `JointTargetKind` in a command; its number follows.
        joint: Its index.
        velocity: Greatest one [rad/s or m/s].
        lower, upper: Limits of its position [rad or m].
    """

    place: int
    joint: int
    velocity: float
    lower: float
    upper: float


@dataclass(frozen=True)
class PlanarVehicle:
    """Wheels, motors and limits of a robot in the plane; equal for robots of equal build.

    Attributes:
        width: Length of a command.
        joint_count: Of the model.
        twist: Index of vx, vy, wz in a command; -1 = wheels move it.
        driven: Motors of wheels.
        steered: Motors with target angles.
        turned: Motors that steer by speed.
        wheels: The driven ones in the order of `driven`, then the passive ones.
        steering: Indices of the steering joints.
        matrix: (3, k) root twist by the speeds of the driven wheels, row by row; empty if steered.
        axle: (x, y) in the root link that does not slide sideways.
        max_rim_accel: Of the wheels [m/s^2].
        max_lateral_accel: Without sliding or tipping [m/s^2].
        can_tip: Whether its wheels could tip it over.
        steering_rad_s: Maximum speed of each motor of `steered`.
        moved: Motors of controlled joints.
        following: Joints that mimic others, by their indices.
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
    moved: tuple[MovedJoint, ...] = ()
    following: tuple[FollowingJoint, ...] = ()


def make_planar_vehicle(
    model: Model, corners: MeshTriangles, gravity: float
) -> tuple[PlanarVehicle, Footprint]:
    """Make the planar vehicle of a robot, and its footprint.

    Args:
        model: The robot.
        corners: Triangles of meshes by name.
        gravity: [m/s^2], positive downwards.

    Raises:
        NotPlanar: It has no drive, is static, or its wheels do not determine its motion.
    """
    drive = model.drive
    if model.is_static or drive is None:
        raise NotPlanar("it has no drive" if drive is None else "it is static")
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    steering = tuple(index[name] for name in drive.steering_joints)
    wheels = [_make_wheel(model, index[name], steering) for name in _list_wheel_joints(model)]
    matrix, axle = _find_drive_matrix(wheels, model)
    if isinstance(drive, DiffDrive) and matrix:
        matrix = _follow_friction(matrix, model, drive, corners)
    geometry = _VehicleGeometry(model, index, steering, tuple(wheels), matrix, axle)
    footprint = measure_footprint(model, corners, axle if matrix else None)
    return geometry.vehicle(footprint, gravity), footprint


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
            moved=tuple(
                _make_moved_joint(motor, self.model.joints[motor.joint])
                for motor in plan.joint_motors
            ),
            following=self._list_following(),
        )

    def _list_following(self) -> tuple[FollowingJoint, ...]:
        """List the joints that nothing but a `<mimic>` moves: wheels roll on the ground."""
        rolling = {wheel.joint for wheel in self.wheels} | set(self.steering)
        found = list_following_joints(self.model.joints)
        return tuple(one for one in found if one.place not in rolling)

    def _effort(self) -> float:
        """Find the acceleration [m/s^2] by the effort of the motors without slip."""
        radius = {wheel.joint: wheel.radius_m for wheel in self.wheels}
        forces = [
            actuator.effort / radius[self.index[actuator.joint]]
            for actuator in self.model.actuators
            if actuator.mode == "velocity" and self.index[actuator.joint] in radius
        ]
        return sum(forces) / max(self.model.mass_kg, MIN_LENGTH_M)


def _make_moved_joint(motor: JointMotor, joint: Joint) -> MovedJoint:
    has_limits = joint.kind != "continuous" and joint.lower <= joint.upper
    lower, upper = (joint.lower, joint.upper) if has_limits else (-math.inf, math.inf)
    return MovedJoint(motor.column, motor.joint, motor.velocity, lower, upper)


def _make_motors(pairs: list[tuple[int, int]]) -> VehicleMotors:
    return VehicleMotors(tuple(place for place, _ in pairs), tuple(joint for _, joint in pairs))


def _list_wheel_joints(model: Model) -> tuple[str, ...]:
    """List the wheel joints: driven ones in the order of the actuators, then the others."""
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
    if isinstance(drive, SteeringDrive) and joint in drive.traction:
        return drive.wheel_radius_m
    rollers = drive.wheels if isinstance(drive, OmniDrive) else ()
    return next(
        (1.0 / max(abs(one.ahead), abs(one.left)) for one in rollers if one.joint == joint), 0.0
    )


def _find_drive_matrix(
    wheels: list[VehicleWheel], model: Model
) -> tuple[tuple[float, ...], tuple[float, float]]:
    """Find the matrix from wheel speeds to root twist, and the point that does not slide."""
    if any(actuator.mode == "twist" for actuator in model.actuators):
        return (), (0.0, 0.0)
    fixed = [wheel for wheel in wheels if wheel.steering < 0]
    if len(fixed) == len(wheels):
        return _solve_drive_matrix(wheels)
    is_symmetric = isinstance(model.drive, SteeringDrive) and model.drive.counter_steering
    if not fixed and not is_symmetric:
        raise NotPlanar("it has no wheel that is not steered")
    # Two axles with opposite angles: the middle between them does not slide.
    x, y = np.mean([wheel.place for wheel in fixed or wheels], axis=0).tolist()
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
        raise NotPlanar("its wheels do not determine its motion: it needs two on either side")
    radii = np.diag([wheel.radius_m for wheel in wheels])
    found = np.linalg.pinv(rows) @ np.vstack([radii, np.zeros_like(radii)])
    x, y = np.mean([wheel.place for wheel in wheels], axis=0).tolist()
    return tuple(found.ravel().tolist()), (x, y)


def _follow_friction(
    matrix: tuple[float, ...], model: Model, drive: DiffDrive, corners: MeshTriangles
) -> tuple[float, ...]:
    """Replace the matrix where loads and casters make friction give another motion.

    Speed and turn are those of the drive's own sizes; friction gives the twists of both.
    """
    predicted = predict_nominal_motions(model, corners)
    speeds: FloatArray = np.array([find_drive_targets(model, one.command) for one in predicted]).T
    twists: FloatArray = np.array([one.twist for one in predicted]).T
    rolled = np.array(matrix).reshape(3, -1) @ speeds
    is_known = all(one.ground.rest.is_stable for one in predicted) and np.isfinite(twists).all()
    if not is_known or np.abs(rolled - twists).max() < ROLLING_TOLERANCE:
        return matrix
    radii = [radius for pair in drive.pairs for radius in pair.radii_m]
    sides = [side * pair.separation_m / 2.0 for pair in drive.pairs for side in (-1.0, 1.0)]
    commands = np.linalg.pinv(np.stack([np.ones(len(sides)), sides], axis=1)) @ np.diag(radii)
    found: FloatArray = twists @ np.linalg.solve(commands @ speeds, commands)
    return tuple(found.ravel().tolist())


def _find_tipping_limits(model: Model, footprint: Footprint, gravity: float) -> tuple[float, float]:
    """Find the accelerations [m/s^2] ahead and aside that tip a robot over, with a margin."""
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


PlanarPlan = tuple[PlanarVehicle, Footprint]


class PlanarPlanCache:
    """Caches the vehicles and footprints of models."""

    def __init__(self, config: EngineConfig, default: Dynamics) -> None:
        self.corners = make_mesh_reader(config.mesh_folder)
        self._folder = config.mesh_folder
        self._gravity = max(-config.gravity[2], 0.0)
        self._default: Dynamics = default or "full"
        self._plans: dict[int, tuple[Model, PlanarPlan | None]] = {}

    def __getstate__(self) -> dict[str, object]:
        """Leave out what is cached by the identity of models."""
        return {**self.__dict__, "_plans": {}}

    def dynamics(self, model: Model) -> Dynamics:
        """Find the dynamics of a model: its own, else those of the world."""
        return "full" if model.is_static else model.dynamics or self._default

    def plan(self, model: Model) -> PlanarPlan | None:
        """Find the vehicle and footprint of a model; None if it needs full dynamics.

        Raises:
            EngineRefused: It requires kinematic dynamics and cannot have them.
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
            return None  # the full engine reports the missing file
        try:
            return make_planar_vehicle(model, self.corners, self._gravity)
        except NotPlanar as error:
            if model.dynamics == "kinematic":
                raise EngineRefused(
                    f"model '{model.name}' cannot be kinematic: {error}; use full or auto"
                ) from error
            return None
