"""The Engine over PyBullet. The only file that imports pybullet."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from proto.model import IDENTITY, ZERO, Model, Origin, Quat, Shape, Vec3
from proto.rotation import conjugate, multiply, rotate
from sim_server.physics.blueprint import Blueprint, Part, blueprint_of
from sim_server.physics.engine import (
    MIN_INERTIA,
    MIN_MASS_KG,
    EngineConfig,
    EngineRefused,
    FloatArray,
    Reading,
)
from sim_server.physics.silence import silenced

with silenced():
    import pybullet

SOLVER_ITERATIONS = 20
"""10 costs 0.8 of this and doubles the sideways drift of a box_bot (1 mm in 2 m); 50 costs 1.4."""

GEAR_FORCE = 1e4
"""Most that a joint is pushed with to follow another [N or N m]."""
GEAR_ERP = 0.2
"""Share of a follower's error that one step mends."""
MAX_PARTS = 128
"""Bullet reads the states of a body's first 127 joints back and no more."""

KINDS = {
    "revolute": pybullet.JOINT_REVOLUTE,
    "continuous": pybullet.JOINT_REVOLUTE,
    "prismatic": pybullet.JOINT_PRISMATIC,
    "fixed": pybullet.JOINT_FIXED,
}


GEOMETRIES = {
    "box": pybullet.GEOM_BOX,
    "sphere": pybullet.GEOM_SPHERE,
    "cylinder": pybullet.GEOM_CYLINDER,
    "capsule": pybullet.GEOM_CAPSULE,
}
Solids = tuple[tuple[str, Vec3, Origin], ...]


class PyBulletEngine:
    """Bullet's multibody dynamics, DIRECT mode, one client."""

    name = "pybullet"

    def __init__(self, config: EngineConfig) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        # Kept for good: Bullet never frees a shape that a body has used, but bodies can share it.
        self._shapes: dict[Solids, int] = {}
        self._joints: dict[int, list[int]] = {}
        self._driven: dict[int, tuple[list[int], list[float]]] = {}
        self._gears: dict[int, list[int]] = {}
        self._dt_s = config.step_ns * 1e-9
        self._com_in_root: FloatArray = np.zeros((64, 3))
        self._root_from_com: FloatArray = np.tile([0.0, 0.0, 0.0, 1.0], (64, 1))
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=config.step_ns * 1e-9,
            numSubSteps=1,
            numSolverIterations=SOLVER_ITERATIONS,
            enableConeFriction=0,
            enableFileCaching=0,
            physicsClientId=self._client,
        )
        pybullet.setGravity(*config.gravity, physicsClientId=self._client)
        self._visual = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=[0.01] * 3, physicsClientId=self._client
        )
        if config.has_ground:
            self._add_ground(config.ground_friction)

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        blueprint = blueprint_of(model)
        _check(blueprint)
        try:
            body = self._create(blueprint, base)
        except pybullet.error as error:
            raise EngineRefused(f"model '{model.name}' was refused by Bullet: {error}") from error
        self._joints[body] = list(range(len(model.joints)))
        index = {joint.name: i for i, joint in enumerate(model.joints)}
        torque = model.drive.max_torque_nm if model.drive else 0.0
        driven = [index[name] for name in model.driven_joints]
        self._driven[body] = (driven, [torque] * len(driven))
        self._remember_root(body, blueprint)
        self._set_dynamics(body, blueprint)
        self._set_dampings(body, blueprint)
        self._set_gears(body, model)
        # Made at its place, with joints at zero: placing it again would cost as much as making it.
        self._set_twist(body, base)
        self.command([body], np.zeros(len(driven)))
        return body

    def remove(self, body: int) -> None:
        """See `Engine.remove`."""
        for gear in self._gears.pop(body, ()):
            pybullet.removeConstraint(gear, physicsClientId=self._client)
        pybullet.removeBody(body, physicsClientId=self._client)
        del self._joints[body], self._driven[body]

    def read(self, bodies: Sequence[int]) -> Reading:
        """See `Engine.read`."""
        client = self._client
        rows: list[tuple[float, ...]] = []
        positions: list[float] = []
        velocities: list[float] = []
        for body in bodies:
            place, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
            linear, angular = pybullet.getBaseVelocity(body, physicsClientId=client)
            rows.append((*place, *turn, *linear, *angular))
            if joints := self._joints[body]:
                for state in pybullet.getJointStates(body, joints, physicsClientId=client):
                    positions.append(state[0])
                    velocities.append(state[1])
        com = np.array(rows, dtype=np.float64).reshape(len(rows), 13)
        return Reading(
            self._root_states(np.asarray(bodies, dtype=np.intp), com),
            np.array(positions, dtype=np.float64),
            np.array(velocities, dtype=np.float64),
        )

    def place(self, body: int, base: FloatArray) -> None:
        """See `Engine.place`."""
        arm = rotate(base[3:7], self._com_in_root[body])
        turn = multiply(base[3:7], conjugate(self._root_from_com[body]))
        pybullet.resetBasePositionAndOrientation(
            body, (base[:3] + arm).tolist(), turn.tolist(), physicsClientId=self._client
        )
        self._set_twist(body, base)

    def rest(self, body: int, base: FloatArray) -> None:
        """See `Engine.rest`."""
        self.place(body, base)
        for joint in self._joints[body]:
            pybullet.resetJointState(body, joint, 0.0, 0.0, physicsClientId=self._client)
        self.command([body], np.zeros(len(self._driven[body][0])))

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        numbers = targets.tolist()
        at = 0
        for body in bodies:
            driven, torques = self._driven[body]
            if driven:
                pybullet.setJointMotorControlArray(
                    body,
                    driven,
                    pybullet.VELOCITY_CONTROL,
                    targetVelocities=numbers[at : at + len(driven)],
                    forces=torques,
                    physicsClientId=self._client,
                )
                at += len(driven)

    def step(self) -> None:
        """See `Engine.step`."""
        pybullet.stepSimulation(physicsClientId=self._client)

    def close(self) -> None:
        """See `Engine.close`."""
        pybullet.disconnect(physicsClientId=self._client)

    def _add_ground(self, friction: float) -> None:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        ground = pybullet.createMultiBody(0.0, plane, physicsClientId=self._client)
        # Bullet multiplies the frictions of a pair: 1 leaves the robot's own, as Gazebo's min does.
        pybullet.changeDynamics(ground, -1, lateralFriction=friction, physicsClientId=self._client)

    def _collision(self, shapes: tuple[Shape, ...]) -> int:
        if not shapes:
            return -1
        solids = tuple((shape.kind, shape.size, shape.origin) for shape in shapes)
        if (known := self._shapes.get(solids)) is not None:
            return known
        self._shapes[solids] = pybullet.createCollisionShapeArray(
            shapeTypes=[GEOMETRIES[s.kind] for s in shapes],
            halfExtents=[[extent / 2 for extent in s.size] for s in shapes],
            radii=[s.size[0] for s in shapes],
            lengths=[s.size[1] for s in shapes],
            collisionFramePositions=[s.origin.position for s in shapes],
            collisionFrameOrientations=[s.origin.orientation for s in shapes],
            physicsClientId=self._client,
        )
        return self._shapes[solids]

    def _create(self, blueprint: Blueprint, base: FloatArray) -> int:
        root, *rest = blueprint.parts
        shapes = [self._collision(part.shapes) for part in blueprint.parts]
        return pybullet.createMultiBody(
            0.0 if blueprint.is_static else max(root.mass_kg, MIN_MASS_KG),
            shapes[0],
            self._visual,
            base[:3].tolist(),
            base[3:7].tolist(),
            baseInertialFramePosition=root.com,
            baseInertialFrameOrientation=root.principal,
            linkMasses=[_link_mass(part) for part in rest],
            linkCollisionShapeIndices=shapes[1:],
            # Without a visual shape Bullet tessellates every collision shape: five times the cost.
            linkVisualShapeIndices=[self._visual] * len(rest),
            linkPositions=[_position(part) for part in rest],
            linkOrientations=[_orientation(part) for part in rest],
            linkInertialFramePositions=[part.com for part in rest],
            linkInertialFrameOrientations=[part.principal for part in rest],
            linkParentIndices=[part.parent for part in rest],
            linkJointTypes=[KINDS[_joint_kind(part)] for part in rest],
            linkJointAxis=[part.joint.axis if part.joint else (0.0, 0.0, 1.0) for part in rest],
            physicsClientId=self._client,
        )

    def _set_dynamics(self, body: int, blueprint: Blueprint) -> None:
        client = self._client
        # Damping belongs to the whole body; passing it for a link rewrites the root's friction.
        pybullet.changeDynamics(
            body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client
        )
        for link, part in enumerate(blueprint.parts, start=-1):
            pybullet.changeDynamics(
                body,
                link,
                lateralFriction=part.friction,
                spinningFriction=0.0,
                rollingFriction=0.0,
                restitution=0.0,
                physicsClientId=client,
            )
            if part.joint is not None or (part.parent < 0 and not blueprint.is_static):
                inertia = [max(moment, MIN_INERTIA) for moment in part.inertia]
                pybullet.changeDynamics(
                    body, link, localInertiaDiagonal=inertia, physicsClientId=client
                )
            if part.joint is not None:
                self._set_joint(body, link, part)

    def _set_joint(self, body: int, link: int, part: Part) -> None:
        joint, client = part.joint, self._client
        if joint is None or joint.kind == "fixed":
            return
        if joint.kind in ("revolute", "prismatic"):
            pybullet.changeDynamics(
                body,
                link,
                jointLowerLimit=joint.lower,
                jointUpperLimit=joint.upper,
                physicsClientId=client,
            )
        # Every joint is born with a motor that brakes it: leave it only the joint's own friction.
        pybullet.setJointMotorControl2(
            body,
            link,
            pybullet.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=joint.friction,
            physicsClientId=client,
        )

    def _set_twist(self, body: int, base: FloatArray) -> None:
        arm = rotate(base[3:7], self._com_in_root[body])
        linear = base[7:10] + np.cross(base[10:13], arm)
        pybullet.resetBaseVelocity(
            body, linear.tolist(), base[10:13].tolist(), physicsClientId=self._client
        )

    def _set_dampings(self, body: int, blueprint: Blueprint) -> None:
        """Damp joints as an implicit step would: Bullet's own step blows up when d dt > I."""
        moving = [
            (link, part.joint)
            for link, part in enumerate(blueprint.parts, start=-1)
            if part.joint is not None and part.joint.kind != "fixed"
        ]
        if not any(joint.damping for _, joint in moving):
            return
        masses = pybullet.calculateMassMatrix(
            body, [0.0] * len(moving), physicsClientId=self._client
        )
        yielding = np.diag(np.linalg.pinv(np.array(masses)))[-len(moving) :].tolist()
        for (link, joint), lightness in zip(moving, yielding, strict=True):
            damping = joint.damping / (1.0 + joint.damping * self._dt_s * max(lightness, 0.0))
            pybullet.changeDynamics(body, link, jointDamping=damping, physicsClientId=self._client)

    def _set_gears(self, body: int, model: Model) -> None:
        index = {joint.name: i for i, joint in enumerate(model.joints)}
        for follower, joint in enumerate(model.joints):
            if joint.mimic is None:
                continue
            gear = pybullet.createConstraint(
                body,
                follower,
                body,
                index[joint.mimic.joint],
                pybullet.JOINT_GEAR,
                joint.axis,
                ZERO,
                ZERO,
                physicsClientId=self._client,
            )
            pybullet.changeConstraint(
                gear,
                gearRatio=-joint.mimic.multiplier,
                relativePositionTarget=joint.mimic.offset,
                erp=GEAR_ERP,
                maxForce=GEAR_FORCE,
                physicsClientId=self._client,
            )
            self._gears.setdefault(body, []).append(gear)

    def _remember_root(self, body: int, blueprint: Blueprint) -> None:
        while body >= len(self._com_in_root):
            self._com_in_root = np.concatenate([self._com_in_root, self._com_in_root * 0.0])
            self._root_from_com = np.concatenate([self._root_from_com, self._root_from_com])
        root = blueprint.parts[0]
        self._com_in_root[body] = root.com
        self._root_from_com[body] = conjugate(np.array(root.principal))

    def _root_states(self, bodies: npt.NDArray[np.intp], com: FloatArray) -> FloatArray:
        """Turn states of the root's centre of mass into states of its link frame."""
        turn = multiply(com[:, 3:7], self._root_from_com[bodies])
        arm = rotate(turn, self._com_in_root[bodies])
        return np.concatenate(
            [com[:, :3] - arm, turn, com[:, 7:10] - np.cross(com[:, 10:13], arm), com[:, 10:13]],
            axis=1,
        )


def _check(blueprint: Blueprint) -> None:
    """Refuse what Bullet cannot simulate, before anything of it is made."""
    if (count := len(blueprint.parts)) > MAX_PARTS:
        raise EngineRefused(
            f"model '{blueprint.name}' has {count} parts: links, and further frictions on one; "
            f"use at most {MAX_PARTS}"
        )
    for part in blueprint.parts:
        _check_kind(blueprint, "joint", _joint_kind(part), KINDS)
        for shape in part.shapes:
            _check_kind(blueprint, "collision shape", shape.kind, GEOMETRIES)


def _check_kind(blueprint: Blueprint, what: str, kind: str, known: dict[str, int]) -> None:
    if kind not in known:
        raise EngineRefused(
            f"model '{blueprint.name}': {what} '{kind}' is not supported by pybullet here; "
            f"use {', '.join(known)}"
        )


def _joint_kind(part: Part) -> str:
    return part.joint.kind if part.joint else "fixed"


def _link_mass(part: Part) -> float:
    if part.joint is None:
        return 0.0
    return max(part.mass_kg, MIN_MASS_KG)


def _position(part: Part) -> Vec3:
    return part.joint.origin.position if part.joint else ZERO


def _orientation(part: Part) -> Quat:
    return part.joint.origin.orientation if part.joint else IDENTITY
