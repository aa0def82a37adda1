"""The Engine over PyBullet. The only file that imports pybullet."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from zensim.proto.messages.model_messages import ZERO, Model
from zensim.sim_server.physics.actuation import imposed
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.creation import SOLID_KINDS, creation_of, dynamics_of
from zensim.sim_server.physics.engine import EngineConfig, EngineRefused, FloatArray, Reading
from zensim.sim_server.physics.holding import holds_of
from zensim.sim_server.physics.joints import Gear, bearable_dampings, gears_of, moving_joints
from zensim.sim_server.physics.loads import Load, loads_of
from zensim.sim_server.physics.orders import Orders
from zensim.sim_server.physics.parking import Body, Parking, body_of
from zensim.sim_server.physics.planning import Planner
from zensim.sim_server.physics.readback import base_states, joint_states
from zensim.sim_server.physics.roots import Roots
from zensim.sim_server.physics.shapes import Shapes
from zensim.sim_server.physics.silence import silenced
from zensim.sim_server.physics.solving import SOLVING
from zensim.sim_server.physics.touch import self_touching, standing_friction, touches_itself

with silenced():
    import pybullet

MAX_PARTS = 128
"""Bullet reads the states of a body's first 127 joints back and no more."""

TINY = (0.01, 0.01, 0.01)
ASLEEP = (pybullet.ACTIVATION_STATE_ENABLE_SLEEPING, pybullet.ACTIVATION_STATE_SLEEP)
AWAKE = (pybullet.ACTIVATION_STATE_WAKE_UP, pybullet.ACTIVATION_STATE_DISABLE_SLEEPING)
NOTHING, ALL = (0, 0), (1, -1)  # group and mask of what is touched
AT_ORIGIN: FloatArray = np.array([0.0] * 6 + [1.0] + [0.0] * 6)

OVERLAP_M = 0.001  # bodies that only touch do not overlap

BY_SPEED = (pybullet.VELOCITY_CONTROL, "targetVelocities")
BY_ANGLE = (pybullet.POSITION_CONTROL, "targetPositions")
KINDS = {kind: getattr(pybullet, f"JOINT_{kind.upper()}") for kind in ("prismatic", "fixed")}
KINDS["revolute"] = KINDS["continuous"] = pybullet.JOINT_REVOLUTE
GEOMETRIES = {kind: getattr(pybullet, f"GEOM_{kind.upper()}") for kind in SOLID_KINDS}


class PyBulletEngine:
    """Bullet's multibody dynamics, DIRECT mode, one client."""

    name = "pybullet"

    def __init__(self, config: EngineConfig, *, awake: int = 0) -> None:
        """Connect; so many parked bodies stay awake, for those who move bodies in and out."""
        self._client = client = pybullet.connect(pybullet.DIRECT)
        self._shapes = Shapes(
            partial(pybullet.createCollisionShapeArray, physicsClientId=client),
            folder=config.mesh_folder,
            kinds=GEOMETRIES,
            dented=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        )
        self._bodies: dict[int, Body] = {}
        self._parking = Parking(awake)
        self._planner = Planner(
            self.name, max_parts=MAX_PARTS, joint_kinds=KINDS, shape_kinds=GEOMETRIES
        )
        self._twists: dict[int, list[float]] = {}
        self._held: set[int] = set()
        self._loads: dict[int, Sequence[Load]] = {}
        self._brought_back: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._gravity = config.gravity
        self._dt_s = dt_s = config.step_ns * 1e-9
        self._roots = Roots()
        self._orders = Orders(lambda body: self._bodies[body].actuation.width)
        pybullet.setPhysicsEngineParameter(fixedTimeStep=dt_s, **SOLVING, physicsClientId=client)
        pybullet.setGravity(*config.gravity, physicsClientId=client)
        box = pybullet.GEOM_BOX
        self._visual = pybullet.createVisualShape(box, halfExtents=TINY, physicsClientId=client)
        self._ground = self._add_ground(config.ground_friction) if config.has_ground else None

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`: makes the collision shape of one part."""
        try:
            plan = self._planner.blueprint(model)
            for part in self._shapes.unmade(plan)[:1]:
                self._shapes.check(plan, [part])
                self._shapes.of(plan, part.shapes)
                return False
        except (EngineRefused, pybullet.error):
            return True
        return True

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`; one that slept would lose its velocity in the first step."""
        blueprint = self._planner.blueprint(model)
        self._shapes.check(blueprint, self._shapes.unmade(blueprint))
        if (parked := self._parking.take(model, awake=bool(base[7:].any()))) is not None:
            known = replace(parked.body, holds=holds_of(model, blueprint))
            return self._bring_back(base, parked.number, known, awake=parked.was_awake)
        try:
            body = self._create(blueprint, base)
        except pybullet.error as error:
            raise EngineRefused(f"model '{model.name}' was refused by Bullet: {error}") from error
        self._roots.remember(body, blueprint.parts[0])
        self._set_dynamics(body, blueprint)
        self._set_dampings(body, blueprint)
        loads = loads_of(blueprint, self._gravity, self._dt_s)
        gears = [self._make_gear(body, gear) for gear in gears_of(model)]
        self._admit(body, body_of(model, blueprint, loads, gears))
        # Made at its place, with joints at zero: placing it again would cost as much as making it.
        self._set_velocity(body, self._roots.com_state(body, base)[7:])
        self._let_go(body)
        return body

    def remove(self, body: int) -> None:
        """See `Engine.remove`; a body is parked where there is a place for it."""
        self._hold(body, is_held=False)
        known = self._bodies.pop(body)
        for kept in (self._twists, self._loads, self._brought_back):
            kept.pop(body, None)
        if self._parking.has_place_for(known) and self._is_good(body):
            self._park(body, known)
            return
        for gear in known.gears:
            pybullet.removeConstraint(gear, physicsClientId=self._client)
        pybullet.removeBody(body, physicsClientId=self._client)

    def conceal(self, body: int) -> None:
        """See `Concealing.conceal`; gears would wake it."""
        if not (known := self._bodies[body]).gears:
            self._loads.pop(body, None)
            self._let_touch(body, known, *NOTHING)
            self._set_state([body], ASLEEP)

    def reveal(self, bodies: Sequence[int]) -> None:
        """See `Concealing.reveal`."""
        self._set_state(bodies, AWAKE)
        for body in bodies:
            self._let_touch(body, known := self._bodies[body], *ALL)
            self._admit(body, known)

    def doze(self, bodies: Sequence[int]) -> None:
        """See `Dozing.doze`."""
        self._set_state(bodies, ASLEEP)

    def rouse(self, bodies: Sequence[int]) -> None:
        """See `Dozing.rouse`."""
        self._set_state(bodies, AWAKE)
        for body in bodies:
            self._brought_back[body] = np.zeros(6), np.zeros(len(self._bodies[body].joints))

    def touching(self, body: int) -> Sequence[int]:
        """See `Dozing.touching`."""
        points = pybullet.getContactPoints(body, physicsClientId=self._client) or ()
        return sorted({point[2] for point in points} & self._bodies.keys() - {body})

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        for body in self._parking.take_all():
            pybullet.removeBody(body, physicsClientId=self._client)

    def overlapping(self, body: int) -> Sequence[int]:
        """See `Engine.overlapping`."""
        client = self._client
        links = range(-1, pybullet.getNumJoints(body, physicsClientId=client))
        boxes = np.array([pybullet.getAABB(body, link, physicsClientId=client) for link in links])
        low, high = boxes[:, 0].min(axis=0).tolist(), boxes[:, 1].max(axis=0).tolist()
        near = pybullet.getOverlappingObjects(low, high, physicsClientId=client) or ()
        return [
            other
            for other in sorted({other for other, _ in near} & self._bodies.keys() - {body})
            if pybullet.getClosestPoints(body, other, -OVERLAP_M, physicsClientId=client)
        ]

    def read(self, bodies: Sequence[int]) -> Reading:
        """See `Engine.read`."""
        jointed = [(body, found) for body in bodies if (found := self._bodies[body].joints)]
        base = self._roots.states(bodies, self._com_states(bodies))
        return Reading(base, *joint_states(jointed, self._client, pybullet.getJointStates))

    def place(self, body: int, base: FloatArray) -> None:
        """See `Engine.place`."""
        state = self._roots.com_state(body, base)
        place, turn = state[:3].tolist(), state[3:7].tolist()
        pybullet.resetBasePositionAndOrientation(body, place, turn, physicsClientId=self._client)
        self._set_velocity(body, state[7:])
        if (waiting := self._brought_back.get(body)) is not None:
            self._brought_back[body] = state[7:], waiting[1]

    def put(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.put`; one brought back in this step stands still until the next."""
        self.place(body, base)
        self._set_joints(body, positions, velocities)

    def rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.rest`."""
        self.place(body, base)
        zeros = np.zeros(len(self._bodies[body].joints))
        self._set_joints(body, zeros if positions is None else positions, zeros)
        self._let_go(body)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        for body, numbers in self._orders.news(bodies, targets):
            self._actuate(body, numbers)

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
        self._apply_loads()
        pybullet.stepSimulation(physicsClientId=self._client)
        self._set_state(self._parking.after_step(), ASLEEP)
        self._set_off()
        if self._ground is None or self._is_good(self._ground):
            return True
        self.place(self._ground, AT_ORIGIN)
        return False

    def close(self) -> None:
        """See `Engine.close`."""
        pybullet.disconnect(physicsClientId=self._client)

    def _admit(self, body: int, known: Body) -> None:
        self._bodies[body] = known
        if known.loads:
            self._loads[body] = known.loads

    def _set_velocity(self, body: int, velocity: FloatArray) -> None:
        linear, angular = velocity[:3].tolist(), velocity[3:].tolist()
        pybullet.resetBaseVelocity(body, linear, angular, physicsClientId=self._client)

    def _set_joints(self, body: int, positions: FloatArray, velocities: FloatArray) -> None:
        joints = self._bodies[body].joints
        for joint, at, speed in zip(joints, positions.tolist(), velocities.tolist(), strict=True):
            pybullet.resetJointState(body, joint, at, speed, physicsClientId=self._client)
        if (waiting := self._brought_back.get(body)) is not None:
            self._brought_back[body] = waiting[0], velocities.copy()

    def _park(self, body: int, known: Body) -> None:
        """Put a body where it touches nothing, to sleep there unless it is to be ready."""
        self._let_touch(body, known, *NOTHING)
        self.place(body, self._parking.keep(body, known))
        self._set_state(self._parking.keep_awake(body), ASLEEP)

    def _let_touch(self, body: int, known: Body, group: int, mask: int) -> None:
        client = self._client
        for part in range(-1, known.parts):
            pybullet.setCollisionFilterGroupMask(body, part, group, mask, physicsClientId=client)

    def _set_state(self, bodies: Sequence[int], states: tuple[int, int]) -> None:
        for body, state in product(bodies, states):
            pybullet.changeDynamics(body, -1, activationState=state, physicsClientId=self._client)

    def _bring_back(self, base: FloatArray, body: int, known: Body, *, awake: bool) -> int:
        if not awake:
            self._set_state([body], AWAKE)
            self._brought_back[body] = np.zeros(6), np.zeros(len(known.joints))
        elif (sleeper := self._parking.next_to_rise(known.model)) is not None:
            self._set_state([sleeper], AWAKE)
        self._let_touch(body, known, *ALL)
        self._admit(body, known)
        self.rest(body, base)
        return body

    def _set_off(self) -> None:
        """Move what was brought back: Bullet stops what slept in the first step after its sleep."""
        for body, (velocity, speeds) in list(self._brought_back.items()):
            if velocity.any() or speeds.any():
                positions = self.read([body]).joint_positions
                self._set_velocity(body, velocity)
                self._set_joints(body, positions, speeds)
        self._brought_back.clear()

    def _let_go(self, body: int) -> None:
        """Give a body targets of 0, and its own way where a twist moved it."""
        self._orders.forget(body)
        self._actuate(body, [0.0] * self._bodies[body].actuation.width)
        self._twists.pop(body, None)

    def _actuate(self, body: int, numbers: list[float]) -> None:
        plan = self._bodies[body].actuation
        for motors, (mode, targets) in ((plan.speeds, BY_SPEED), (plan.angles, BY_ANGLE)):
            if motors.joints:
                how: dict[str, Any] = {targets: motors.of(numbers), "forces": motors.efforts}
                pybullet.setJointMotorControlArray(
                    body, motors.joints, mode, **how, physicsClientId=self._client
                )
        self._hold(body, is_held=not any(plan.speeds.of(numbers)))
        if plan.twist is not None:
            self._twists[body] = numbers[plan.twist : plan.twist + 3]

    def _hold(self, body: int, *, is_held: bool) -> None:
        """Let the wheels of a body that stands resist rolling, and those of one that goes not."""
        if is_held == (body in self._held):
            return
        (self._held.add if is_held else self._held.remove)(body)
        for part, friction in self._bodies[body].holds:
            found = friction if is_held else 0.0
            pybullet.changeDynamics(body, part, rollingFriction=found, physicsClientId=self._client)

    def _impose_twists(self) -> None:
        bodies = list(self._twists)
        com = self._com_states(bodies)
        turns, arms = self._roots.turns_and_arms(bodies, com)
        twists = np.array(list(self._twists.values()))
        for body, row in zip(bodies, imposed(com[:, 7:], turns, arms, twists), strict=True):
            self._set_velocity(body, row)

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
        how = {"computeLinkVelocity": 1, "physicsClientId": self._client}
        state = pybullet.getLinkState(body, part, **how)
        return list(state[0]), np.array(state[1]), np.array([*state[6], *state[7]])

    def _com_states(self, bodies: Sequence[int]) -> FloatArray:
        place_of, velocity_of = pybullet.getBasePositionAndOrientation, pybullet.getBaseVelocity
        return base_states(bodies, self._client, place_of, velocity_of)

    def _is_good(self, body: int) -> bool:
        return math.isfinite(pybullet.getBaseVelocity(body, physicsClientId=self._client)[0][0])

    def _add_ground(self, friction: float) -> int:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        # With nothing to see Bullet draws the whole plane: 6 MB and 10 ms.
        ground = pybullet.createMultiBody(0.0, plane, self._visual, physicsClientId=self._client)
        friction = standing_friction(friction)
        pybullet.changeDynamics(ground, -1, lateralFriction=friction, physicsClientId=self._client)
        self._set_state([ground], ASLEEP)  # so that nobody looks for contacts of sleepers
        for _ in range(2):  # until it sleeps
            pybullet.stepSimulation(physicsClientId=self._client)
        return ground

    def _create(self, blueprint: Blueprint, base: FloatArray) -> int:
        shapes = [self._shapes.of(blueprint, part.shapes) for part in blueprint.parts]
        creation = creation_of(blueprint, base, shapes=shapes, visual=self._visual, kinds=KINDS)
        flags = pybullet.URDF_USE_SELF_COLLISION if touches_itself(blueprint.links) else 0
        body = pybullet.createMultiBody(**creation, flags=flags, physicsClientId=self._client)
        for one, other, do_touch in self_touching(blueprint) if flags else ():
            pybullet.setCollisionFilterPair(
                body, body, one, other, int(do_touch), physicsClientId=self._client
            )
        return body

    def _set_dynamics(self, body: int, blueprint: Blueprint) -> None:
        for link, found in dynamics_of(blueprint, self._dt_s):
            pybullet.changeDynamics(body, link, **found, physicsClientId=self._client)
        # Every joint is born with a motor that brakes it: leave it only the joint's own friction.
        how = {"controlMode": pybullet.VELOCITY_CONTROL, "physicsClientId": self._client}
        for link, joint in moving_joints(blueprint):
            pybullet.setJointMotorControl2(body, link, force=joint.friction, **how)

    def _set_dampings(self, body: int, blueprint: Blueprint) -> None:
        client, moving = self._client, moving_joints(blueprint)
        if not any(joint.damping for _, joint in moving):
            return
        still = [0.0] * len(moving)
        masses = np.array(pybullet.calculateMassMatrix(body, still, physicsClientId=client))
        for link, damping in bearable_dampings(moving, masses, self._dt_s):
            pybullet.changeDynamics(body, link, jointDamping=damping, physicsClientId=client)

    def _make_gear(self, body: int, gear: Gear) -> int:
        made: int = pybullet.createConstraint(
            *(body, gear.follower, body, gear.leader, pybullet.JOINT_GEAR),
            *(gear.axis, ZERO, ZERO),
            physicsClientId=self._client,
        )
        pybullet.changeConstraint(made, **gear.hold, physicsClientId=self._client)
        return made
