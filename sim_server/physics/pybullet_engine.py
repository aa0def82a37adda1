"""The Engine over PyBullet. The only file that imports pybullet."""

import math
from collections.abc import Sequence

import numpy as np

from proto.model import ZERO, Model, Shape
from sim_server.physics.acceptance import check_blueprint, check_meshes
from sim_server.physics.actuation import Actuation, actuation_of, imposed
from sim_server.physics.blueprint import Blueprint, Part, blueprint_of
from sim_server.physics.creation import creation_of, solids_of
from sim_server.physics.engine import MIN_INERTIA, EngineConfig, EngineRefused, FloatArray, Reading
from sim_server.physics.loads import Load, loads_of
from sim_server.physics.roots import Roots
from sim_server.physics.silence import silenced
from sim_server.physics.spreading import ShapeKey, key_of, spread
from sim_server.physics.touch import self_touching, standing_friction, touch_of, touches_itself

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

AT_ORIGIN: FloatArray = np.array([0.0] * 6 + [1.0] + [0.0] * 6)

OVERLAP_M = 0.001
"""Bodies that only touch do not overlap."""

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
    "mesh": pybullet.GEOM_MESH,
}


def _plan(model: Model, mesh_folder: str) -> Blueprint:
    plan = spread(blueprint_of(model), max_parts=MAX_PARTS)
    check_blueprint(plan, max_parts=MAX_PARTS, joint_kinds=KINDS, shape_kinds=GEOMETRIES)
    check_meshes(plan, mesh_folder)
    return plan


class PyBulletEngine:
    """Bullet's multibody dynamics, DIRECT mode, one client."""

    name = "pybullet"

    def __init__(self, config: EngineConfig) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        # Kept for good: Bullet never frees a shape that a body has used, but bodies can share it.
        self._shapes: dict[ShapeKey, int] = {(): -1}
        self._mesh_folder = config.mesh_folder
        self._joints: dict[int, list[int]] = {}
        self._actuations: dict[int, Actuation] = {}
        self._twists: dict[int, list[float]] = {}
        self._gears: dict[int, list[int]] = {}
        self._loads: dict[int, list[Load]] = {}
        self._gravity = config.gravity
        self._dt_s = config.step_ns * 1e-9
        self._roots = Roots()
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
        self._ground = self._add_ground(config.ground_friction) if config.has_ground else None

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`: makes the collision shape of one part."""
        try:
            plan = _plan(model, self._mesh_folder)
            for part in plan.parts:
                if key_of(part.shapes, is_static=plan.is_static) not in self._shapes:
                    self._collision(part.shapes, is_static=plan.is_static)
                    return False
        except (EngineRefused, pybullet.error):
            return True
        return True

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        blueprint = _plan(model, self._mesh_folder)
        try:
            body = self._create(blueprint, base)
        except pybullet.error as error:
            raise EngineRefused(f"model '{model.name}' was refused by Bullet: {error}") from error
        self._joints[body] = list(range(len(model.joints)))
        self._actuations[body] = actuation_of(model)
        self._roots.remember(body, blueprint.parts[0])
        self._set_dynamics(body, blueprint)
        self._set_dampings(body, blueprint)
        self._set_gears(body, model)
        if loads := loads_of(blueprint, self._gravity, self._dt_s):
            self._loads[body] = loads
        # Made at its place, with joints at zero: placing it again would cost as much as making it.
        state = self._roots.com_state(body, base).tolist()
        pybullet.resetBaseVelocity(body, state[7:10], state[10:], physicsClientId=self._client)
        self._let_go(body)
        return body

    def remove(self, body: int) -> None:
        """See `Engine.remove`."""
        for gear in self._gears.pop(body, ()):
            pybullet.removeConstraint(gear, physicsClientId=self._client)
        pybullet.removeBody(body, physicsClientId=self._client)
        del self._joints[body], self._actuations[body]
        self._twists.pop(body, None)
        self._loads.pop(body, None)

    def overlapping(self, body: int) -> Sequence[int]:
        """See `Engine.overlapping`."""
        client = self._client
        links = range(-1, pybullet.getNumJoints(body, physicsClientId=client))
        boxes = np.array([pybullet.getAABB(body, link, physicsClientId=client) for link in links])
        low, high = boxes[:, 0].min(axis=0).tolist(), boxes[:, 1].max(axis=0).tolist()
        near = pybullet.getOverlappingObjects(low, high, physicsClientId=client) or ()
        return [
            other
            for other in sorted({other for other, _ in near} & self._joints.keys() - {body})
            if pybullet.getClosestPoints(body, other, -OVERLAP_M, physicsClientId=client)
        ]

    def read(self, bodies: Sequence[int]) -> Reading:
        """See `Engine.read`."""
        client = self._client
        positions: list[float] = []
        velocities: list[float] = []
        for body in bodies:
            if joints := self._joints[body]:
                for state in pybullet.getJointStates(body, joints, physicsClientId=client):
                    positions.append(state[0])
                    velocities.append(state[1])
        return Reading(
            self._roots.states(bodies, self._com_states(bodies)),
            np.array(positions, dtype=np.float64),
            np.array(velocities, dtype=np.float64),
        )

    def place(self, body: int, base: FloatArray) -> None:
        """See `Engine.place`."""
        state = self._roots.com_state(body, base).tolist()
        pybullet.resetBasePositionAndOrientation(
            body, state[:3], state[3:7], physicsClientId=self._client
        )
        pybullet.resetBaseVelocity(body, state[7:10], state[10:], physicsClientId=self._client)

    def rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.rest`."""
        self.place(body, base)
        joints = self._joints[body]
        angles = [0.0] * len(joints) if positions is None else positions.tolist()
        for joint, angle in zip(joints, angles, strict=True):
            pybullet.resetJointState(body, joint, angle, 0.0, physicsClientId=self._client)
        self._let_go(body)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        numbers = targets.tolist()
        at = 0
        for body in bodies:
            width = self._actuations[body].width
            if width:
                self._actuate(body, numbers[at : at + width])
                at += width

    def push_link(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.push_link`."""
        self._push(body, link - 1, self._part_state(body, link - 1)[0], wrench[:3], wrench[3:])

    def push_joint(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.push_joint`."""
        pybullet.setJointMotorControl2(
            body, joint, pybullet.TORQUE_CONTROL, force=effort, physicsClientId=self._client
        )

    def step(self) -> bool:
        """See `Engine.step`; a body gone bad that touches the ground takes the ground with it."""
        if self._twists:
            self._impose_twists()
        if self._loads:
            self._apply_loads()
        pybullet.stepSimulation(physicsClientId=self._client)
        return self._ground is None or self._is_ground_good(self._ground)

    def close(self) -> None:
        """See `Engine.close`."""
        pybullet.disconnect(physicsClientId=self._client)

    def _let_go(self, body: int) -> None:
        """Give a body targets of 0, and its own way where a twist moved it."""
        self.command([body], np.zeros(self._actuations[body].width))
        self._twists.pop(body, None)

    def _actuate(self, body: int, numbers: list[float]) -> None:
        plan = self._actuations[body]
        if plan.speeds.joints:
            pybullet.setJointMotorControlArray(
                body,
                plan.speeds.joints,
                pybullet.VELOCITY_CONTROL,
                targetVelocities=plan.speeds.of(numbers),
                forces=plan.speeds.efforts,
                physicsClientId=self._client,
            )
        if plan.angles.joints:
            pybullet.setJointMotorControlArray(
                body,
                plan.angles.joints,
                pybullet.POSITION_CONTROL,
                targetPositions=plan.angles.of(numbers),
                forces=plan.angles.efforts,
                physicsClientId=self._client,
            )
        if plan.twist is not None:
            self._twists[body] = numbers[plan.twist : plan.twist + 3]

    def _impose_twists(self) -> None:
        bodies = list(self._twists)
        com = self._com_states(bodies)
        turns, arms = self._roots.turns_and_arms(bodies, com)
        twists = np.array(list(self._twists.values()))
        for body, row in zip(bodies, imposed(com[:, 7:], turns, arms, twists), strict=True):
            pybullet.resetBaseVelocity(
                body, row[:3].tolist(), row[3:].tolist(), physicsClientId=self._client
            )

    def _apply_loads(self) -> None:
        for body, loads in self._loads.items():
            for load in loads:
                place, turn, velocity = self._part_state(body, load.part)
                self._push(body, load.part, place, *load.wrench(turn, velocity))

    def _push(
        self, body: int, part: int, place: list[float], force: FloatArray, torque: FloatArray
    ) -> None:
        how = {"flags": pybullet.WORLD_FRAME, "physicsClientId": self._client}
        pybullet.applyExternalForce(body, part, force.tolist(), place, **how)
        pybullet.applyExternalTorque(body, part, torque.tolist(), **how)

    def _part_state(self, body: int, part: int) -> tuple[list[float], FloatArray, FloatArray]:
        """Read the centre of mass of a part, its principal axes, and its velocity (6,)."""
        if part < 0:
            row = self._com_states([body])[0]
            return row[:3].tolist(), row[3:7], row[7:]
        state = pybullet.getLinkState(
            body, part, computeLinkVelocity=1, physicsClientId=self._client
        )
        return list(state[0]), np.array(state[1]), np.array([*state[6], *state[7]])

    def _com_states(self, bodies: Sequence[int]) -> FloatArray:
        client = self._client
        rows: list[tuple[float, ...]] = []
        for body in bodies:
            place, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
            linear, angular = pybullet.getBaseVelocity(body, physicsClientId=client)
            rows.append((*place, *turn, *linear, *angular))
        return np.array(rows, dtype=np.float64).reshape(len(rows), 13)

    def _is_ground_good(self, ground: int) -> bool:
        linear, _ = pybullet.getBaseVelocity(ground, physicsClientId=self._client)
        if math.isfinite(linear[0]):
            return True
        self.place(ground, AT_ORIGIN)
        return False

    def _add_ground(self, friction: float) -> int:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        ground = pybullet.createMultiBody(0.0, plane, physicsClientId=self._client)
        friction = standing_friction(friction)
        pybullet.changeDynamics(ground, -1, lateralFriction=friction, physicsClientId=self._client)
        return ground

    def _collision(self, shapes: tuple[Shape, ...], *, is_static: bool) -> int:
        key = key_of(shapes, is_static=is_static)
        if (known := self._shapes.get(key)) is not None:
            return known
        # Only what never moves may have dents.
        dented = pybullet.GEOM_FORCE_CONCAVE_TRIMESH if is_static else 0
        self._shapes[key] = pybullet.createCollisionShapeArray(
            **solids_of(shapes, folder=self._mesh_folder, kinds=GEOMETRIES, mesh_flag=dented),
            physicsClientId=self._client,
        )
        return self._shapes[key]

    def _create(self, blueprint: Blueprint, base: FloatArray) -> int:
        static = blueprint.is_static
        shapes = [self._collision(part.shapes, is_static=static) for part in blueprint.parts]
        creation = creation_of(blueprint, base, shapes=shapes, visual=self._visual, kinds=KINDS)
        if not touches_itself(blueprint.links):
            return pybullet.createMultiBody(**creation, physicsClientId=self._client)
        flags = pybullet.URDF_USE_SELF_COLLISION
        body = pybullet.createMultiBody(**creation, flags=flags, physicsClientId=self._client)
        for one, other, do_touch in self_touching(blueprint):
            pybullet.setCollisionFilterPair(
                body, body, one, other, int(do_touch), physicsClientId=self._client
            )
        return body

    def _set_dynamics(self, body: int, blueprint: Blueprint) -> None:
        client = self._client
        # Damping belongs to the whole body; passing it for a link rewrites the root's friction.
        pybullet.changeDynamics(
            body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client
        )
        for link, part in enumerate(blueprint.parts, start=-1):
            touch = touch_of(part, self._dt_s, is_static=blueprint.is_static)
            pybullet.changeDynamics(body, link, **touch, physicsClientId=client)
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
                *(body, follower, body, index[joint.mimic.joint], pybullet.JOINT_GEAR),
                *(joint.axis, ZERO, ZERO),
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
