"""The Engine over PyBullet. It and the proof of the engine alone import pybullet."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np

from zensim.proto import rigid_transforms
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import ZERO, Model, Vec3
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.actuation import JointMotor, impose_planar_twists
from zensim.sim_server.physics.blueprint import Blueprint, BlueprintCache, order_depth_first
from zensim.sim_server.physics.bullet.bullet_bodies import (
    COLLISION_SHAPE_KINDS,
    PARKING_DEPTH_M,
    BareModel,
    BodyPool,
    BodyRecipe,
    BulletBody,
    CollisionShapeCache,
    GearConstraint,
    center_scenery,
    limit_joint_dampings,
    list_gear_constraints,
    list_moving_joints,
    make_bullet_body,
    make_dynamics_arguments,
    make_multibody_arguments,
)
from zensim.sim_server.physics.bullet.bullet_contact import (
    BEARING_ITERATIONS,
    RIGID_ERP,
    SOLVER_ARGUMENTS,
    SOLVER_ITERATIONS,
    STACK_ITERATIONS,
    BulletArguments,
    find_recovery_share,
    has_self_collision,
    limit_static_body_friction,
    list_self_collision_pairs,
    make_recovery_arguments,
)
from zensim.sim_server.physics.bullet.com_frames import ComFrames
from zensim.sim_server.physics.bullet.joint_servos import JointDynamics, JointServos, make_free_mass
from zensim.sim_server.physics.bullet.joint_springs import JointSprings, SpringTable
from zensim.sim_server.physics.bullet.muted_output import suppress_output
from zensim.sim_server.physics.bullet.pair_friction import (
    COLLIDE_WITH_ALL,
    COLLIDE_WITH_NOTHING,
    NEUTRAL_FRICTIONS,
    STATIC_FILTER,
    STATIC_GROUP,
    CollisionFilter,
    SlipperyBodies,
    add_twin_surfaces,
    find_copy_friction,
)
from zensim.sim_server.physics.bullet.stacked_bodies import StackedBodies
from zensim.sim_server.physics.bullet.wheel_carriers import add_wheel_carriers, list_carriers
from zensim.sim_server.physics.command_cache import CommandCache
from zensim.sim_server.physics.engine import (
    GROUND,
    BodyStates,
    ContactPoints,
    Engine,
    EngineCapabilities,
    EngineRefused,
    FloatArray,
    can_move,
    make_contact_points,
)
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.free_spin import find_explicit_torques, find_spinning
from zensim.sim_server.physics.link_forces import LinkForce, make_link_forces

with suppress_output():
    import pybullet

Vector3Tuple = tuple[float, float, float]
QuaternionTuple = tuple[float, float, float, float]
ReadBasePose = Callable[[int, int], tuple[Vector3Tuple, QuaternionTuple]]
ReadBaseVelocity = Callable[[int, int], tuple[Vector3Tuple, Vector3Tuple]]
ReadJointStates = Callable[
    [int, Sequence[int], int], Iterable[tuple[float, float, Sequence[float], float]]
]
MAX_LOOKED_UP = 8
"""Tuples of bodies whose numbers of Bullet are kept."""
MAX_PARTS = 128
"""Bullet returns the states of a body's first 127 joints only."""
VISUAL_HALF_EXTENTS = (0.01, 0.01, 0.01)
ACTIVATION_ASLEEP = (pybullet.ACTIVATION_STATE_ENABLE_SLEEPING, pybullet.ACTIVATION_STATE_SLEEP)
ACTIVATION_AWAKE = (pybullet.ACTIVATION_STATE_WAKE_UP, pybullet.ACTIVATION_STATE_DISABLE_SLEEPING)
ORIGIN_STATE: FloatArray = np.array([0.0] * 6 + [1.0] + [0.0] * 6)
ORIGIN_POSE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
LEAST_FRICTION = 1e-9
"""Friction of a controlled joint: a motor without force keeps the effort that it last exerted."""
NO_CLIENT = -1
ROOT_POSITION = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
ROOT_AT_REST = (0.0,) * 6
MAX_REMOVED_MODELS = 64
"""Removed models of `BareModels`, beside as many as are in use, that make its client anew."""
CARRIER_TORQUE_NM = 1e6
"""Greatest torque of motors that hold carriers of wheels."""
OVERLAP_M = 0.001  # depth from which bodies overlap instead of touching
MAX_BOX_SHIFT_M = 0.05
"""Distance of a root's centre of mass from which its pose is set again.

Until a step, Bullet searches a body where its centre would be in the root's origin.
"""
COMPLIANCE = ("contactStiffness", "contactDamping")
RECOVERY_TOLERANCE = 0.1
"""Change of the share of a penetration that a step corrects, from which it is set again."""
VELOCITY_MODE = (pybullet.VELOCITY_CONTROL, "targetVelocities")
POSITION_MODE = (pybullet.POSITION_CONTROL, "targetPositions")
JOINT_TYPES = {kind: getattr(pybullet, f"JOINT_{kind.upper()}") for kind in ("prismatic", "fixed")}
JOINT_TYPES["revolute"] = JOINT_TYPES["continuous"] = pybullet.JOINT_REVOLUTE
GEOMETRY_TYPES = {kind: getattr(pybullet, f"GEOM_{kind.upper()}") for kind in COLLISION_SHAPE_KINDS}
NOT_RESTORABLE = (
    "Bullet restores a state only in the world that it was saved in, and with the same bodies; "
    "use MuJoCo, or restore before robots are spawned or deleted"
)


def read_base_states(
    bodies: Iterable[int], client: int, read_pose: ReadBasePose, read_velocity: ReadBaseVelocity
) -> FloatArray:
    """Read (n, 13): position, quaternion xyzw, linear and angular velocity."""
    # One flat list and positional arguments: nested lists and keywords take a third more time.
    numbers: list[float] = []
    for body in bodies:
        position, orientation = read_pose(body, client)
        linear, angular = read_velocity(body, client)
        numbers += position
        numbers += orientation
        numbers += linear
        numbers += angular
    return np.array(numbers, dtype=np.float64).reshape(-1, 13)


def read_joint_states(
    bodies: Iterable[tuple[int, Sequence[int]]], client: int, read_joints: ReadJointStates
) -> tuple[FloatArray, FloatArray]:
    """Read positions (k,) and velocities (k,) of joints, body by body."""
    positions: list[float] = []
    velocities: list[float] = []
    for body, joints in bodies:
        for position, velocity, _, _ in read_joints(body, joints, client):
            positions.append(position)
            velocities.append(velocity)
    return np.array(positions, dtype=np.float64), np.array(velocities, dtype=np.float64)


def read_motor_efforts(
    bodies: Iterable[tuple[int, Sequence[int]]], client: int, read_joints: ReadJointStates
) -> FloatArray:
    """Read what the motors of joints exerted in the last step (k,), body by body."""
    efforts = [
        effort for body, joints in bodies for _, _, _, effort in read_joints(body, joints, client)
    ]
    return np.array(efforts, dtype=np.float64)


def read_contact_point(point: Sequence[Any]) -> tuple[float, ...]:
    """Convert a contact point of Bullet's, seen from its first body, to `ContactPoints.points`."""
    (_, _, _, _, _, position, _, (nx, ny, nz), distance, push, *friction) = point
    one, (ax, ay, az), other, (bx, by, bz) = friction
    force = (
        push * nx + one * ax + other * bx,
        push * ny + one * ay + other * by,
        push * nz + one * az + other * bz,
    )
    return (*position, nx, ny, nz, -distance, *force)


def reverse_contact_point(point: tuple[float, ...]) -> tuple[float, ...]:
    """See a row of `ContactPoints.points` from the other side."""
    x, y, z, nx, ny, nz, depth_m, fx, fy, fz = point
    return (x, y, z, -nx, -ny, -nz, depth_m, -fx, -fy, -fz)


def _arrange(blueprint: Blueprint) -> Blueprint:
    twinned = order_depth_first(add_twin_surfaces(blueprint))
    return center_scenery(add_wheel_carriers(twinned))


class BulletOrigin:
    """Bodies of one client of Bullet, into which only its own states fit.

    Attributes:
        engine: The engine that has the client now.
        changes: Count of the bodies made and removed.
    """

    def __init__(self, engine: "PyBulletEngine") -> None:
        self.engine = engine
        self.changes = 0
        self._name = uuid4().hex
        _ORIGINS[self._name] = self

    def __reduce__(self) -> tuple[object, ...]:
        """Write the name and count, which must be the same when it is read."""
        return _find_origin, (self._name, self.changes)


_ORIGINS = WeakValueDictionary[str, BulletOrigin]()


def _find_origin(name: str, changes: int) -> BulletOrigin:
    origin = _ORIGINS.get(name)
    if origin is None or origin.changes != changes:
        raise EngineRefused(NOT_RESTORABLE)
    return origin


def _save_bullet(client: int) -> bytes:
    """Write positions, velocities and contacts of all bodies."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "state.bullet")
        with suppress_output():
            pybullet.saveBullet(str(file), physicsClientId=client)
        return file.read_bytes()


def _load_bullet(client: int, state: bytes) -> None:
    with TemporaryDirectory() as folder:
        file = Path(folder, "state.bullet")
        file.write_bytes(state)
        # It restores the rest, and fails, where a new filter has renumbered a static body.
        with suppress_output(), suppress(pybullet.error):
            pybullet.restoreState(fileName=str(file), physicsClientId=client)


def _make_motor_arguments(motor: JointMotor, kind: int, number: float) -> dict[str, Any]:
    """Make the arguments of setJointMotorControl2; a joint that is free has its friction only."""
    if kind == JointTargetKind.POSITION:
        return {
            "controlMode": pybullet.POSITION_CONTROL,
            "targetPosition": number,
            "force": motor.effort,
            "maxVelocity": motor.velocity,
        }
    is_driven = kind == JointTargetKind.VELOCITY
    return {
        "controlMode": pybullet.VELOCITY_CONTROL,
        "targetVelocity": number if is_driven else 0.0,
        "force": motor.effort if is_driven else max(motor.friction, LEAST_FRICTION),
    }


def _list_joint_brakes(blueprint: Blueprint) -> Iterator[BulletArguments]:
    """List the arguments of setJointMotorControl2 for joints without a command, and carriers.

    Bullet gives each joint a motor that brakes it: its force becomes the joint's friction.
    """
    for link, joint in list_moving_joints(blueprint):
        yield {
            "jointIndex": link,
            "controlMode": pybullet.VELOCITY_CONTROL,
            "force": joint.friction,
        }
    for carrier in list_carriers(blueprint):
        yield {
            "jointIndex": carrier,
            "controlMode": pybullet.POSITION_CONTROL,
            "targetPosition": 0.0,
            "force": CARRIER_TORQUE_NM,
        }


def _make_refusal(model: Model, error: Exception) -> EngineRefused:
    return EngineRefused(f"model '{model.name}': Bullet cannot create it: {error}")


def _set_physics_parameters(client: int, config: EngineConfig) -> None:
    dt_s = config.step_ns * 1e-9
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep=dt_s, **SOLVER_ARGUMENTS, physicsClientId=client
    )
    pybullet.setGravity(*config.gravity, physicsClientId=client)


def _make_blueprint_cache(config: EngineConfig) -> BlueprintCache:
    return BlueprintCache(
        PyBulletEngine.name,
        max_parts=MAX_PARTS,
        joint_kinds=JOINT_TYPES,
        shape_kinds=GEOMETRY_TYPES,
        mesh_folder=config.mesh_folder,
        arrange=_arrange,
    )


class BareModels:
    """Models without shapes in a client of their own, for their equations of motion.

    Bullet keeps the equations of a body that is removed, for the next one at its address: bodies
    stay here until the client is closed.
    """

    def __init__(self) -> None:
        self._client = NO_CLIENT
        self._made = 0
        self._bodies = WeakKeyDictionary[BareModel, int]()

    def __reduce__(self) -> tuple[object, ...]:
        """Write nothing: models are made when they are needed."""
        return BareModels, ()

    def find_dynamics(
        self,
        known: BulletBody,
        orientation: QuaternionTuple,
        positions: list[float],
        speeds: list[float],
    ) -> JointDynamics:
        """Find the equations of motion of a body in a state of its joints.

        Args:
            known: The body.
            orientation: Of the principal axes of its root.
            positions: Of its moving joints.
            speeds: Likewise.
        """
        if (body := self._bodies.get(known.bare)) is None:
            body = self._make(known.bare)
        client = self._client
        # The roots here are never turned: gravity is.
        turned = rigid_transforms.rotate(
            rigid_transforms.conjugate(orientation), known.servo_gravity or ZERO
        )
        pybullet.setGravity(*turned, physicsClientId=client)
        matrix = np.array(pybullet.calculateMassMatrix(body, positions, physicsClientId=client))
        still = [0.0] * len(positions)
        if known.bare.is_static:
            bias = pybullet.calculateInverseDynamics(
                body, positions, speeds, still, physicsClientId=client
            )
            return JointDynamics(np.array(bias), matrix)
        bias = pybullet.calculateInverseDynamics(
            body,
            [*ROOT_POSITION, *positions],
            [*ROOT_AT_REST, *speeds],
            [*ROOT_AT_REST, *still],
            physicsClientId=client,
        )
        return JointDynamics(np.array(bias)[len(ROOT_AT_REST) :], make_free_mass(matrix))

    def _make(self, bare: BareModel) -> int:
        if self._made > MAX_REMOVED_MODELS + 2 * len(self._bodies):
            self.close()
        if self._client == NO_CLIENT:
            self._client = pybullet.connect(pybullet.DIRECT)
        body: int = pybullet.createMultiBody(**bare.creation, physicsClientId=self._client)
        for number, moments in bare.moments:
            pybullet.changeDynamics(
                body, number, localInertiaDiagonal=moments, physicsClientId=self._client
            )
        self._made += 1
        self._bodies[bare] = body
        return body

    def close(self) -> None:
        """Forget all models."""
        if self._client != NO_CLIENT:
            pybullet.disconnect(physicsClientId=self._client)
        self._client, self._made = NO_CLIENT, 0
        self._bodies.clear()


class PyBulletEngine(Engine):
    """Bullet's multibody dynamics, DIRECT mode, one client."""

    name = "pybullet"
    capabilities = EngineCapabilities(hides=True, sleeps="all")

    def __init__(self, config: EngineConfig, *, awake: int = 0) -> None:
        """Connect; keep `awake` pooled bodies awake, for bodies that arrive with a velocity."""
        self._client = client = pybullet.connect(pybullet.DIRECT)
        self._origin, self._asleep = BulletOrigin(self), set[int]()
        self._shapes = CollisionShapeCache(
            partial(pybullet.createCollisionShapeArray, physicsClientId=client),
            make_exact=self._take_margin,
            folder=config.mesh_folder,
            kinds=GEOMETRY_TYPES,
            concave=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        )
        # Bullet gives bodies numbers of its own; all that is private here uses those.
        self._unique_ids, self._numbers_of = dict[int, int](), dict[int, int]()
        self._found: dict[int, tuple[Sequence[int], tuple[int, ...]]] = {}
        self._bodies: dict[int, BulletBody] = {}
        self._recipe: BodyRecipe | None = None  # of the last model
        self._pool, self._blueprints = BodyPool(awake), _make_blueprint_cache(config)
        self._twists: dict[int, list[float]] = {}
        self._resisting: set[int] = set()
        self._loads: dict[int, Sequence[LinkForce]] = {}
        self._spinning: dict[int, Vec3] = {}
        """Bodies that may precess, and their moments."""
        self._springs: dict[int, JointSprings] = {}
        self._spring_table: SpringTable | None = None
        self._servos: dict[int, JointServos] = {}
        self._bare_models = BareModels()
        self._pending_velocities: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._joint_efforts: dict[int, list[tuple[int, float]]] = {}
        self._recovering: dict[int, float] = {}
        """Bodies that overlap others deeply, and the share of it that a step corrects."""
        self._gravity, self._dt_s = config.gravity, config.step_ns * 1e-9
        self._stacks, self._iterations = StackedBodies(self._dt_s), SOLVER_ITERATIONS
        self._com_frames = ComFrames()
        self._commands = CommandCache(self._find_width)
        _set_physics_parameters(client, config)
        self._visual = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=VISUAL_HALF_EXTENTS, physicsClientId=client
        )
        self._slippery = SlipperyBodies()
        self._ground = self._add_ground(config.ground_friction) if config.has_ground else None

    def __getstate__(self) -> dict[str, object]:
        """Take the state, which fits Bullet's bodies of this engine only.

        The order of contacts is not saved, and decides rounding: from now on Bullet sorts them.
        """
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1, physicsClientId=self._client
        )
        bases = self._read(list(self._bodies)).base
        return {**self.__dict__, "_saved": _save_bullet(self._client), "_saved_bases": bases}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state; `resume` restores that of Bullet."""
        self.__dict__.update(state)

    def resume(self) -> None:
        """See `Engine.resume`."""
        former, self._origin.engine = self._origin.engine, self
        _load_bullet(self._client, self.__dict__.pop("_saved"))
        self._place_static_bodies(self.__dict__.pop("_saved_bases"))
        self._set_iterations()
        for body in sorted(former._asleep ^ self._asleep):  # noqa: SLF001
            states = ACTIVATION_ASLEEP if body in self._asleep else ACTIVATION_AWAKE
            self._set_activation([body], states)
        for body in former._recovering.keys() | self._recovering.keys():  # noqa: SLF001
            self._set_recovery(body, self._recovering.get(body, RIGID_ERP))
        for body in sorted(former._stacks.anchored ^ self._stacks.anchored):  # noqa: SLF001
            self._set_anchor(body)
        parked = self._pool.list_parked()
        for body, known in (*self._bodies.items(), *parked.items()):
            self._set_collision_filter(body, known, collides=body not in parked)
        twists = dict(self._twists)
        for body, known in self._bodies.items():
            self._actuate(body, self._commands.find(body, known.actuation.width))
        self._twists = twists

    def _place_static_bodies(self, bases: FloatArray) -> None:
        """Put static bodies, which Bullet may not have found, where they were.

        Raises:
            EngineRefused: A body that moves is not where it was.
        """
        is_off = np.abs(self._read(list(self._bodies)).base - bases).max(axis=1, initial=0.0) > 0.0
        for row, (body, known) in enumerate(self._bodies.items()):
            if is_off[row] and known.moves[0]:
                raise EngineRefused(NOT_RESTORABLE)
            if is_off[row]:
                self._place(body, bases[row])

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; creates the collision shape of one part."""
        if self._recipe is not None and self._recipe.body.model is model:
            return True
        try:
            blueprint = self._blueprints.find(model)
            for part in self._shapes.find_missing(blueprint)[:1]:
                self._shapes.check(blueprint, [part])
                self._shapes.find(blueprint, part.shapes)
                return False
        except (EngineRefused, pybullet.error):
            return True
        return True

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """See `Engine.insert`; a moving body needs a pooled body that is awake."""
        made = self._make_body(model, base)
        self._unique_ids[body], self._numbers_of[made] = made, body
        self._found.clear()

    def _make_body(self, model: Model, base: FloatArray) -> int:
        recipe = self._find_recipe(model)
        if (parked := self._pool.take(model, awake=bool(base[7:].any()))) is not None:
            known = replace(parked.body, rolling_frictions=recipe.body.rolling_frictions)
            return self._reuse_parked(base, parked.number, known, awake=parked.was_awake)
        try:
            body = self._create(recipe, base)
        except pybullet.error as error:
            raise _make_refusal(model, error) from error
        try:
            self._complete(body, recipe, base)
        except Exception:
            self._discard(body)
            raise
        return body

    def discard(self, body: int) -> None:
        """See `Engine.discard`; the body goes to the pool if there is room."""
        body = self._unique_ids.pop(body)
        del self._numbers_of[body]
        self._found.clear()
        self._set_rolling_resistance(body, is_held=False)
        if body in self._recovering:
            self._set_recovery(body, RIGID_ERP)
        if self._stacks.forget(body):
            self._set_anchor(body)
        known = self._bodies.pop(body)
        self._remove_copies(body)
        for table in (self._twists, self._loads, self._spinning, self._pending_velocities):
            table.pop(body, None)
        self._joint_efforts.pop(body, None)
        self._forget_springs(body)
        self._servos.pop(body, None)
        if self._pool.has_room_for(known) and self._is_finite(body):
            self._park(body, known)
            return
        for gear in known.gears:
            pybullet.removeConstraint(gear, physicsClientId=self._client)
        self._remove_body(body)

    def hide(self, body: int) -> None:
        """See `Engine.hide`; not with gears, which would wake it."""
        body = self._unique_ids[body]
        if not (known := self._bodies[body]).gears:
            self._loads.pop(body, None)
            self._spinning.pop(body, None)
            self._forget_springs(body)
            self._servos.pop(body, None)
            self._remove_copies(body)
            self._set_collision_filter(body, known, collides=False)
            self._set_activation([body], ACTIVATION_ASLEEP)

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        found = self._find_unique_ids(bodies)
        self._set_activation(found, ACTIVATION_AWAKE)
        for body in found:
            self._set_collision_filter(body, known := self._bodies[body], collides=True)
            self._register(body, known)

    def sleep(self, bodies: Sequence[int]) -> None:
        """See `Engine.sleep`."""
        self._set_activation(self._find_unique_ids(bodies), ACTIVATION_ASLEEP)

    def wake(self, bodies: Sequence[int]) -> None:
        """See `Engine.wake`."""
        found = self._find_unique_ids(bodies)
        self._set_activation(found, ACTIVATION_AWAKE)
        for body in found:
            self._pending_velocities[body] = np.zeros(6), np.zeros(len(self._bodies[body].joints))

    def find_contacts(self, body: int) -> Sequence[int]:
        """See `Engine.find_contacts`."""
        body = self._unique_ids[body]
        touching = {
            self._slippery.find_original(point[2])
            for number in (body, *self._slippery.list_copies(body))
            for point in pybullet.getContactPoints(number, physicsClientId=self._client) or ()
        }
        return sorted(self._numbers_of[one] for one in touching & self._bodies.keys() - {body})

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        """See `Engine.read_contacts`."""
        watched = set(self._find_unique_ids(bodies))
        pairs: list[tuple[int, int, int, int]] = []
        points: list[tuple[float, ...]] = []
        # All at once: of a single body, friction has the wrong sign where Bullet swaps the pair,
        # and many calls take longer.
        for point in pybullet.getContactPoints(physicsClientId=self._client) or ():
            _, one, other, one_part, other_part, _, _, _, distance, push, *_ = point
            if self._slippery.originals:
                one, other = map(self._slippery.find_original, (one, other))
            if (distance > 0.0 and push <= 0.0) or watched.isdisjoint((one, other)):
                continue
            sides = self._identify(one, one_part), self._identify(other, other_part)
            numbers = read_contact_point(point)
            if one in watched:
                pairs.append((*sides[0], *sides[1]))
                points.append(numbers)
            if other in watched:
                pairs.append((*sides[1], *sides[0]))
                points.append(reverse_contact_point(numbers))
        return make_contact_points(pairs, points)

    def _identify(self, body: int, part: int) -> tuple[int, int]:
        """Find the body and link of Bullet's numbers."""
        if (known := self._bodies.get(body)) is None:
            return GROUND, 0
        return self._numbers_of[body], known.part_links[part + 1]

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        for body in self._pool.take_all():
            self._remove_body(body)

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`; a body that overlaps deeply leaves slowly from now on."""
        body, client = self._unique_ids[body], self._client
        links = range(-1, pybullet.getNumJoints(body, physicsClientId=client))
        boxes = np.array([pybullet.getAABB(body, link, physicsClientId=client) for link in links])
        low, high = boxes[:, 0].min(axis=0).tolist(), boxes[:, 1].max(axis=0).tolist()
        near = pybullet.getOverlappingObjects(low, high, physicsClientId=client) or ()
        unreal = self._pool.list_parked().keys() | self._slippery.originals.keys()
        others = sorted({other for other, _ in near} - {body} - unreal)
        depths = {other: self._measure_overlap(body, other) for other in others}
        self._limit_recovery(body, depths)
        found = [other for other in others if depths[other] and other in self._bodies]
        return sorted(self._numbers_of[other] for other in found)

    def _measure_overlap(self, body: int, other: int) -> float:
        """Measure how deep two bodies overlap; 0 if they touch at most."""
        points = pybullet.getClosestPoints(body, other, -OVERLAP_M, physicsClientId=self._client)
        return max((-point[8] for point in points or ()), default=0.0)

    def _limit_recovery(self, body: int, depths: Mapping[int, float]) -> None:
        """Let a body leave slowly, or those that it overlaps if it does not move.

        One of a pair is enough: two correct a quarter of the share.
        """
        moves = can_move(self._bodies[body].model)
        for other, depth in depths.items():
            one, share = body if moves else other, find_recovery_share(depth, self._dt_s)
            is_deeper = share < self._recovering.get(one, RIGID_ERP)
            if is_deeper and one in self._bodies and can_move(self._bodies[one].model):
                self._set_recovery(one, share)

    def _set_recovery(self, body: int, share: float) -> None:
        """Set the share of a penetration that a step corrects, for all parts of a body."""
        known = self._bodies[body]
        arguments = make_recovery_arguments(known.mass_kg, share, self._dt_s)
        for part in range(-1, known.parts):
            pybullet.changeDynamics(body, part, **arguments, physicsClientId=self._client)
        if share < RIGID_ERP:
            self._recovering[body] = share
            return
        self._recovering.pop(body, None)
        for part, written in self._find_recipe(known.model).dynamics:
            compliance = {key: written[key] for key in COMPLIANCE if key in written}
            if compliance:
                pybullet.changeDynamics(body, part, **compliance, physicsClientId=self._client)

    def _follow_recoveries(self) -> None:
        """Adapt the correction of bodies that overlap deeply to what is left."""
        for body, former in list(self._recovering.items()):
            if body in self._asleep:
                continue
            points = pybullet.getContactPoints(body, physicsClientId=self._client) or ()
            depth = max((-point[8] for point in points), default=0.0)
            share = find_recovery_share(depth, self._dt_s)
            if share == RIGID_ERP or abs(share - former) > RECOVERY_TOLERANCE * former:
                self._set_recovery(body, share)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`."""
        return self._read(self._find_unique_ids(bodies))

    def _read(self, bodies: Sequence[int]) -> BodyStates:
        jointed = self._list_joints(bodies)
        base = self._com_frames.states(bodies, self._com_states(bodies))
        return BodyStates(base, *read_joint_states(jointed, self._client, pybullet.getJointStates))

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """See `Engine.read_joint_efforts`; friction and springs of joints are motors, too."""
        jointed = self._list_joints(self._find_unique_ids(bodies))
        efforts = read_motor_efforts(jointed, self._client, pybullet.getJointStates)
        if self._joint_efforts or self._servos:
            self._add_applied(efforts, jointed)
        return efforts

    def _add_applied(
        self, efforts: FloatArray, jointed: Sequence[tuple[int, Sequence[int]]]
    ) -> None:
        """Add efforts that are commanded or found, which are none of Bullet's motors."""
        start = 0
        for body, joints in jointed:
            applied = [(*one, False) for one in self._joint_efforts.get(body, ())]
            if (servos := self._servos.get(body)) is not None:
                applied.extend(servos.list_efforts())
            for joint, effort, is_whole in applied:
                place = start + joints.index(joint)
                efforts[place] = effort + (0.0 if is_whole else efforts[place])
            start += len(joints)

    def _list_joints(self, bodies: Sequence[int]) -> list[tuple[int, Sequence[int]]]:
        return [(body, found) for body in bodies if (found := self._bodies[body].joints)]

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        number = self._unique_ids[body]
        if not self._bodies[number].moves[0]:
            base = np.concatenate([base[:7], np.zeros(6)])
        self._place(number, base)

    def _place(self, body: int, base: FloatArray) -> None:
        state = self._com_frames.to_com_state(body, base)
        position, orientation = state[:3].tolist(), state[3:7].tolist()
        pybullet.resetBasePositionAndOrientation(
            body, position, orientation, physicsClientId=self._client
        )
        self._set_velocity(body, state[7:])
        for copied in self._slippery.list_copies(body):
            pybullet.resetBasePositionAndOrientation(
                copied, position, orientation, physicsClientId=self._client
            )
        if (pending := self._pending_velocities.get(body)) is not None:
            self._pending_velocities[body] = state[7:], pending[1]

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`; a body woken in this step moves from the next on."""
        self.set_base_state(body, base)
        self._set_joints(self._unique_ids[body], positions, velocities)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`."""
        self._place_at_rest(self._unique_ids[body], base, positions)

    def _place_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None) -> None:
        self._place(body, base)
        zeros = np.zeros(len(self._bodies[body].joints))
        self._set_joints(body, zeros if positions is None else positions, zeros)
        self._clear_targets(body)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        found = self._find_unique_ids(bodies)
        for body, own in self._commands.take_changed(found, targets):
            self._actuate(body, own)

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`."""
        body = self._unique_ids[body]
        part = self._bodies[body].links[link]
        self._apply_wrench(body, part, self._part_state(body, part)[0], wrench[:3], wrench[3:])

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`."""
        body = self._unique_ids[body]
        self._apply_effort(body, self._bodies[body].joints[joint], effort)

    def step(self) -> bool:
        """See `Engine.step`; a diverged body makes the state of the ground it touches invalid."""
        if self._twists:
            self._impose_twists()
        self._apply_loads()
        if self._spinning:
            self._apply_gyroscopic_torques()
        if self._springs:
            self._apply_springs()
        self._apply_servos()
        for body, efforts in self._joint_efforts.items():
            for joint, effort in efforts:
                self._apply_effort(body, joint, effort)
        self._separate_ground_from_sleepers()
        pybullet.stepSimulation(physicsClientId=self._client)
        if self._recovering:
            self._follow_recoveries()
        self._set_activation(self._pool.after_step(), ACTIVATION_ASLEEP)
        self._apply_pending_velocities()
        self._limit_iterations()
        if self._ground is None or self._is_finite(self._ground):
            return True
        self._place(self._ground, ORIGIN_STATE)
        return False

    def close(self) -> None:
        """See `Engine.close`."""
        self._bare_models.close()
        if self._origin.engine is self:
            pybullet.disconnect(physicsClientId=self._client)

    def _find_recipe(self, model: Model) -> BodyRecipe:
        """Find what bodies of a model have in common; raises EngineRefused."""
        if self._recipe is None or self._recipe.body.model is not model:
            blueprint = self._blueprints.find(model)
            self._shapes.check(blueprint, self._shapes.find_missing(blueprint))
            try:
                self._recipe = self._make_recipe(model, blueprint)
            except pybullet.error as error:
                raise _make_refusal(model, error) from error
        return self._recipe

    def _make_recipe(self, model: Model, blueprint: Blueprint) -> BodyRecipe:
        shapes = [self._shapes.find(blueprint, part.shapes) for part in blueprint.parts]
        creation = make_multibody_arguments(
            blueprint, shapes=shapes, visual=self._visual, kinds=JOINT_TYPES
        )
        if has_self_collision(blueprint.links):
            creation["flags"] = pybullet.URDF_USE_SELF_COLLISION
        loads = make_link_forces(blueprint, self._gravity, self._dt_s)
        body = make_bullet_body(model, blueprint, loads, gravity=self._gravity, creation=creation)
        dampings = limit_joint_dampings(blueprint, body.springs, self._dt_s)
        return BodyRecipe(
            blueprint,
            creation,
            (
                *make_dynamics_arguments(blueprint, self._dt_s),
                *((link, {"jointDamping": damping}) for link, damping in dampings),
            ),
            tuple(_list_joint_brakes(blueprint)),
            body,
        )

    def _complete(self, body: int, recipe: BodyRecipe, base: FloatArray) -> None:
        """Set what createMultiBody does not."""
        blueprint = recipe.blueprint
        self._set_self_collision(body, blueprint)
        if blueprint.is_static:
            # Bullet takes the links of a fixed root as static, and searches contacts between them.
            self._set_collision_filter(body, recipe.body, collides=True)
        self._com_frames.add(body, blueprint.parts[0])
        for link, arguments in recipe.dynamics:
            pybullet.changeDynamics(body, link, **arguments, physicsClientId=self._client)
        for arguments in recipe.motors:
            pybullet.setJointMotorControl2(body, **arguments, physicsClientId=self._client)
        gears = [
            self._make_gear_constraint(body, gear) for gear in list_gear_constraints(blueprint)
        ]
        self._register(body, replace(recipe.body, gears=gears) if gears else recipe.body)
        # Created in place with joints at zero: setting the pose again takes a tenth of creating it.
        if math.hypot(*blueprint.parts[0].com) > MAX_BOX_SHIFT_M:
            self._place(body, base)
        elif base[7:].any():
            self._set_velocity(body, self._com_frames.to_com_state(body, base)[7:])
        self._clear_targets(body)

    def _discard(self, body: int) -> None:
        """Remove a body that could not be completed, and its constraints with it."""
        self._remove_copies(body)
        for table in (self._bodies, self._twists, self._loads, self._spinning):
            table.pop(body, None)
        self._joint_efforts.pop(body, None)
        self._forget_springs(body)
        self._servos.pop(body, None)
        self._stacks.forget(body)
        self._resisting.discard(body)
        self._remove_body(body)

    def _remove_body(self, body: int) -> None:
        self._origin.changes += 1
        self._asleep.discard(body)
        pybullet.removeBody(body, physicsClientId=self._client)

    def _register(self, body: int, known: BulletBody) -> None:
        self._bodies[body] = known
        if known.slippery:
            self._add_slippery(body, known.slippery)
        elif known.has_twins or self._slippery.surfaces:
            self._filter_surfaces(body, known)
        if known.loads:
            self._loads[body] = known.loads
        if known.spinning_moments is not None:
            self._spinning[body] = known.spinning_moments
        if known.is_loose:
            self._stacks.add(body)
        if known.springs is not None:
            self._springs[body] = known.springs
            self._spring_table = None
        if known.couplings is not None:
            self._servos[body] = JointServos(known.couplings, self._dt_s)

    def _set_velocity(self, body: int, velocity: FloatArray) -> None:
        linear, angular = velocity[:3].tolist(), velocity[3:].tolist()
        pybullet.resetBaseVelocity(body, linear, angular, physicsClientId=self._client)

    def _set_joints(self, body: int, positions: FloatArray, velocities: FloatArray) -> None:
        joints = self._bodies[body].joints
        states = zip(joints, positions.tolist(), velocities.tolist(), strict=True)
        for joint, position, speed in states:
            pybullet.resetJointState(body, joint, position, speed, physicsClientId=self._client)
        for carrier in self._bodies[body].carriers:
            pybullet.resetJointState(body, carrier, 0.0, 0.0, physicsClientId=self._client)
        if (pending := self._pending_velocities.get(body)) is not None:
            self._pending_velocities[body] = pending[0], velocities.copy()

    def _park(self, body: int, known: BulletBody) -> None:
        """Move a body to the pool, asleep unless it belongs to those kept awake."""
        self._set_collision_filter(body, known, collides=False)
        self._place(body, self._pool.park(body, known))
        self._set_activation(self._pool.add_awake(body), ACTIVATION_ASLEEP)

    def _set_collision_filter(self, body: int, known: BulletBody, *, collides: bool) -> None:
        for part, moves in enumerate(known.moves, start=-1):
            common = COLLIDE_WITH_ALL if moves else STATIC_FILTER
            self._set_part_filter(body, part, common if collides else COLLIDE_WITH_NOTHING)
        if collides and body in self._slippery.surfaces:
            self._mask_copied(body)
        elif collides and (known.has_twins or self._slippery.surfaces):
            self._filter_surfaces(body, known)

    def _set_part_filter(self, body: int, part: int, chosen: CollisionFilter) -> None:
        pybullet.setCollisionFilterGroupMask(body, part, *chosen, physicsClientId=self._client)

    def _filter_surfaces(self, body: int, known: BulletBody) -> None:
        """Set the filters of moving surfaces; where there are slippery bodies, by friction."""
        if self._slippery.surfaces:
            new = self._slippery.groups.add(known.surfaces)
            for static in list(self._slippery.surfaces) if new else ():
                self._copy_for_groups(static, new)
        for surface in known.surfaces:
            if surface.is_twin or surface.friction not in NEUTRAL_FRICTIONS:
                chosen = self._slippery.groups.find_filter(surface)
                self._set_part_filter(body, surface.part, chosen)

    def _add_slippery(self, body: int, surfaces: tuple[tuple[int, float], ...]) -> None:
        """Copy a static body with a friction below 1 for all frictions of moving surfaces."""
        is_first = not self._slippery.surfaces
        self._slippery.surfaces[body] = surfaces
        self._slippery.copies[body] = {}
        self._copy_for_groups(body, self._slippery.groups.list_frictions())
        if is_first:
            for moving, known in list(self._bodies.items()):
                if known.surfaces:
                    self._filter_surfaces(moving, known)

    def _copy_for_groups(self, body: int, groups: Mapping[int, float]) -> None:
        for group, friction in groups.items():
            copied = self._copy_static(body, group, friction)
            self._slippery.copies[body][group] = copied
            self._slippery.originals[copied] = body
        self._mask_copied(body)

    def _copy_static(self, body: int, group: int, moving: float) -> int:
        """Copy a static body for moving surfaces of one friction."""
        slippery = dict(self._slippery.surfaces[body])
        if body not in self._bodies:
            copied = self._make_plane()
            pybullet.changeDynamics(copied, -1, restitution=1.0, physicsClientId=self._client)
            parts: Iterable[int] = (-1,)
        else:
            recipe = self._find_recipe(self._bodies[body].model)
            copied, parts = self._create(recipe, ORIGIN_STATE), range(-1, recipe.body.parts)
            for part, arguments in recipe.dynamics:
                pybullet.changeDynamics(copied, part, **arguments, physicsClientId=self._client)
            frames = pybullet.getBasePositionAndOrientation(body, physicsClientId=self._client)
            pybullet.resetBasePositionAndOrientation(copied, *frames, physicsClientId=self._client)
        for part in parts:
            if part not in slippery:
                self._set_part_filter(copied, part, COLLIDE_WITH_NOTHING)
                continue
            friction = find_copy_friction(slippery[part], moving)
            pybullet.changeDynamics(
                copied, part, lateralFriction=friction, physicsClientId=self._client
            )
            self._set_part_filter(copied, part, (STATIC_GROUP, group))
        self._set_activation([copied], ACTIVATION_ASLEEP)
        return copied

    def _mask_copied(self, body: int) -> None:
        """Let the copies of a static body collide in its place."""
        mask = ~(STATIC_GROUP | sum(self._slippery.copies[body]))
        for part, _ in self._slippery.surfaces[body]:
            self._set_part_filter(body, part, (STATIC_GROUP, mask))

    def _remove_copies(self, body: int) -> None:
        for copied in self._slippery.forget(body):
            self._remove_body(copied)

    def _set_activation(self, bodies: Sequence[int], states: tuple[int, int]) -> None:
        (self._asleep.update if states is ACTIVATION_ASLEEP else self._asleep.difference_update)(
            bodies
        )
        for body, state in product(bodies, states):
            pybullet.changeDynamics(body, -1, activationState=state, physicsClientId=self._client)

    def _reuse_parked(self, base: FloatArray, body: int, known: BulletBody, *, awake: bool) -> int:
        if not awake:
            self._set_activation([body], ACTIVATION_AWAKE)
            self._pending_velocities[body] = np.zeros(6), np.zeros(len(known.joints))
        elif (next_awake := self._pool.wake_next(known.model)) is not None:
            self._set_activation([next_awake], ACTIVATION_AWAKE)
        self._set_collision_filter(body, known, collides=True)
        self._register(body, known)
        self._place_at_rest(body, base, None)
        return body

    def _apply_pending_velocities(self) -> None:
        """Set the velocities of woken bodies: Bullet zeroes them in the first step after sleep."""
        for body, (velocity, speeds) in list(self._pending_velocities.items()):
            if velocity.any() or speeds.any():
                positions = self._read([body]).joint_positions
                self._set_velocity(body, velocity)
                self._set_joints(body, positions, speeds)
        self._pending_velocities.clear()

    def _clear_targets(self, body: int) -> None:
        """Set the targets of a body to 0 and stop imposing its twist."""
        self._commands.forget(body)
        self._actuate(body, [0.0] * self._bodies[body].actuation.width)
        self._twists.pop(body, None)

    def _actuate(self, body: int, targets: list[float]) -> None:
        actuation = self._bodies[body].actuation
        speeds, angles = actuation.speeds, actuation.angles
        for motors, (mode, keyword) in ((speeds, VELOCITY_MODE), (angles, POSITION_MODE)):
            if motors.joints:
                values: dict[str, Any] = {keyword: motors.select(targets), "forces": motors.efforts}
                pybullet.setJointMotorControlArray(
                    body, motors.joints, mode, **values, physicsClientId=self._client
                )
        self._set_rolling_resistance(body, is_held=not any(speeds.select(targets)))
        if actuation.twist is not None:
            self._twists[body] = targets[actuation.twist : actuation.twist + 3]
        if actuation.joint_motors:
            self._set_joint_motors(body, targets)

    def _set_joint_motors(self, body: int, targets: list[float]) -> None:
        """Set the motors of controlled joints; those with an effort get it in each step."""
        if (servos := self._servos.get(body)) is not None:
            servos.command(targets)
        efforts = []
        for motor in self._bodies[body].actuation.joint_motors:
            kind, number = motor.find_target(targets)
            if kind == JointTargetKind.EFFORT:
                efforts.append((motor.joint, max(-motor.effort, min(number, motor.effort))))
            pybullet.setJointMotorControl2(
                body,
                motor.joint,
                **_make_motor_arguments(motor, kind, number),
                physicsClientId=self._client,
            )
        if efforts:
            self._joint_efforts[body] = efforts
        else:
            self._joint_efforts.pop(body, None)

    def _apply_effort(self, body: int, joint: int, effort: float) -> None:
        pybullet.setJointMotorControl2(
            body, joint, pybullet.TORQUE_CONTROL, force=effort, physicsClientId=self._client
        )

    def _set_rolling_resistance(self, body: int, *, is_held: bool) -> None:
        """Enable rolling friction of the wheels while a body stands, disable it when it drives."""
        if is_held == (body in self._resisting):
            return
        (self._resisting.add if is_held else self._resisting.remove)(body)
        for part, friction in self._bodies[body].rolling_frictions:
            rolling = friction if is_held else 0.0
            pybullet.changeDynamics(
                body, part, rollingFriction=rolling, physicsClientId=self._client
            )

    def _impose_twists(self) -> None:
        bodies = list(self._twists)
        com = self._com_states(bodies)
        orientations, arms = self._com_frames.orientations_and_arms(bodies, com)
        twists = np.array(list(self._twists.values()))
        velocities = impose_planar_twists(com[:, 7:], orientations, arms, twists)
        for body, velocity in zip(bodies, velocities, strict=True):
            self._set_velocity(body, velocity)

    def _apply_loads(self) -> None:
        for body, loads in self._loads.items():
            for load in loads:
                position, orientation, velocity = self._part_state(body, load.part)
                wrench = load.wrench(orientation, velocity)
                self._apply_wrench(body, load.part, position, *wrench)

    def _apply_gyroscopic_torques(self) -> None:
        bodies = [body for body in self._spinning if body not in self._asleep]
        client, read = self._client, pybullet.getBaseVelocity
        spins = np.array([read(body, client)[1] for body in bodies]).reshape(-1, 3)
        found = np.flatnonzero(find_spinning(spins, self._dt_s)).tolist()
        if not found:
            return
        chosen = [bodies[row] for row in found]
        moments = np.array([self._spinning[body] for body in chosen])
        read_pose = pybullet.getBasePositionAndOrientation
        turns = np.array([read_pose(body, client)[1] for body in chosen])
        own = rotate(conjugate(turns), spins[found])
        torques = rotate(turns, find_explicit_torques(moments, own, self._dt_s))
        for body, torque in zip(chosen, torques.tolist(), strict=True):
            pybullet.applyExternalTorque(
                body, -1, torque, pybullet.WORLD_FRAME, physicsClientId=client
            )

    def _apply_servos(self) -> None:
        """Apply what motors and couplings exert, and leave the rest of their limits to Bullet."""
        client = self._client
        for body, servos in self._servos.items():
            if not servos.is_active or body in self._asleep:
                continue
            couplings = servos.couplings
            states = pybullet.getJointStates(body, couplings.joints, client)
            _, orientation = pybullet.getBasePositionAndOrientation(body, client)
            positions, speeds = [state[0] for state in states], [state[1] for state in states]
            dynamics = self._bare_models.find_dynamics(
                self._bodies[body], orientation, positions, speeds
            )
            efforts = servos.find_efforts(positions, speeds, dynamics)
            pybullet.setJointMotorControlArray(
                body,
                couplings.applied_joints,
                pybullet.TORQUE_CONTROL,
                forces=efforts,
                physicsClientId=client,
            )
            for motor, kind, number, rest in servos.take_limits():
                arguments = _make_motor_arguments(motor, kind, number)
                pybullet.setJointMotorControl2(
                    body, motor.joint, **{**arguments, "force": rest}, physicsClientId=client
                )

    def _limit_iterations(self) -> None:
        """Let the next step take more iterations if something bears contacts now."""
        if self._stacks.is_due():
            self._follow_stacks()
        is_bearing = any(
            self._bears_contacts(body)
            for body, servos in self._servos.items()
            if servos.is_active and body not in self._asleep
        )
        stacked = STACK_ITERATIONS if self._stacks.are_moving else SOLVER_ITERATIONS
        iterations = BEARING_ITERATIONS if is_bearing else stacked
        if iterations != self._iterations:
            self._iterations = iterations
            self._set_iterations()

    def _follow_stacks(self) -> None:
        read = partial(pybullet.getContactPoints, physicsClientId=self._client)
        for body in sorted(self._stacks.search(read, self._asleep)):
            self._set_anchor(body)

    def _set_anchor(self, body: int) -> None:
        """Give the parts of a body friction anchors, or take them away."""
        is_anchored = int(body in self._stacks.anchored)
        for part in range(-1, self._bodies[body].parts):
            pybullet.changeDynamics(
                body, part, frictionAnchor=is_anchored, physicsClientId=self._client
            )
        self._set_collision_filter(body, self._bodies[body], collides=True)

    def _bears_contacts(self, body: int) -> bool:
        points = pybullet.getContactPoints(body, physicsClientId=self._client) or ()
        borne = self._bodies[body].borne_parts
        return any(point[3] in borne for point in points)

    def _set_iterations(self) -> None:
        pybullet.setPhysicsEngineParameter(
            numSolverIterations=self._iterations, physicsClientId=self._client
        )

    def _forget_springs(self, body: int) -> None:
        if self._springs.pop(body, None) is not None:
            self._spring_table = None

    def _apply_springs(self) -> None:
        if self._spring_table is None:
            self._spring_table = SpringTable(self._springs.values(), self._dt_s)
        joints = [(body, springs.joints) for body, springs in self._springs.items()]
        states = read_joint_states(joints, self._client, pybullet.getJointStates)
        speeds, forces = (values.tolist() for values in self._spring_table.find_motors(*states))
        start = 0
        for body, numbers in joints:
            own = slice(start, start := start + len(numbers))
            pybullet.setJointMotorControlArray(
                body,
                numbers,
                pybullet.VELOCITY_CONTROL,
                targetVelocities=speeds[own],
                forces=forces[own],
                physicsClientId=self._client,
            )

    def _apply_wrench(
        self, body: int, part: int, position: list[float], force: FloatArray, torque: FloatArray
    ) -> None:
        options = {"flags": pybullet.WORLD_FRAME, "physicsClientId": self._client}
        pybullet.applyExternalForce(body, part, force.tolist(), position, **options)
        pybullet.applyExternalTorque(body, part, torque.tolist(), **options)

    def _part_state(self, body: int, part: int) -> tuple[list[float], FloatArray, FloatArray]:
        """Read the centre of mass of a part, its principal axes, and its velocity (6,)."""
        if part < 0:
            row = self._com_states([body])[0]
            return row[:3].tolist(), row[3:7], row[7:]
        options = {"computeLinkVelocity": 1, "physicsClientId": self._client}
        state = pybullet.getLinkState(body, part, **options)
        return list(state[0]), np.array(state[1]), np.array([*state[6], *state[7]])

    def _com_states(self, bodies: Sequence[int]) -> FloatArray:
        read_pose, read_velocity = pybullet.getBasePositionAndOrientation, pybullet.getBaseVelocity
        return read_base_states(bodies, self._client, read_pose, read_velocity)

    def _find_unique_ids(self, bodies: Sequence[int]) -> tuple[int, ...]:
        """Steps ask for the same tuples; equal ones would lose what `ComFrames` keeps of them."""
        if (known := self._found.get(id(bodies))) is not None:
            return known[1]
        found = tuple(map(self._unique_ids.__getitem__, bodies))
        if isinstance(bodies, tuple):
            if len(self._found) >= MAX_LOOKED_UP:
                self._found.clear()
            self._found[id(bodies)] = bodies, found
        return found

    def _find_width(self, body: int) -> int:
        return self._bodies[body].actuation.width

    def _is_finite(self, body: int) -> bool:
        return math.isfinite(pybullet.getBaseVelocity(body, physicsClientId=self._client)[0][0])

    def _make_plane(self) -> int:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        # Without a visual shape Bullet tessellates the plane: 6 MB and 10 ms.
        body = pybullet.createMultiBody(0.0, plane, self._visual, physicsClientId=self._client)
        return int(body)

    def _add_ground(self, friction: float) -> int:
        ground = self._make_plane()
        pybullet.changeDynamics(
            ground,
            -1,
            lateralFriction=limit_static_body_friction(friction),
            restitution=1.0,
            physicsClientId=self._client,
        )
        if friction < 1.0:
            self._add_slippery(ground, ((-1, friction),))
        # Contacts between sleeping bodies and a sleeping ground are not searched.
        self._set_activation([ground], ACTIVATION_ASLEEP)
        for _ in range(2):  # until it sleeps
            pybullet.stepSimulation(physicsClientId=self._client)
        return ground

    def _separate_ground_from_sleepers(self) -> None:
        """Keep the ground out of the broad-phase tree of bodies that do not move.

        Its box has no end, and the boxes around it in the tree neither: each part that moves was
        compared with a large part of the sleeping bodies. A body that is placed goes to the tree of
        moving ones for two steps; placed where it is, it changes no pair of bodies.
        """
        if self._ground is not None and len(self._asleep) > 1:
            pybullet.resetBasePositionAndOrientation(
                self._ground, *ORIGIN_POSE, physicsClientId=self._client
            )

    def _create(self, recipe: BodyRecipe, base: FloatArray) -> int:
        self._origin.changes += 1
        body = pybullet.createMultiBody(
            **recipe.creation,
            basePosition=base[:3].tolist(),
            baseOrientation=base[3:7].tolist(),
            physicsClientId=self._client,
        )
        return int(body)

    def _take_margin(self, shape: int) -> None:
        """Take the margin from the hulls of a shape: Bullet does so for the root of a body only."""
        far = (0.0, 0.0, -PARKING_DEPTH_M)
        body = pybullet.createMultiBody(0.0, shape, self._visual, far, physicsClientId=self._client)
        pybullet.changeDynamics(body, -1, collisionMargin=0.0, physicsClientId=self._client)
        pybullet.removeBody(body, physicsClientId=self._client)

    def _set_self_collision(self, body: int, blueprint: Blueprint) -> None:
        if not has_self_collision(blueprint.links):
            return
        for one, other, do_collide in list_self_collision_pairs(blueprint):
            pybullet.setCollisionFilterPair(
                body, body, one, other, int(do_collide), physicsClientId=self._client
            )

    def _make_gear_constraint(self, body: int, gear: GearConstraint) -> int:
        constraint: int = pybullet.createConstraint(
            *(body, gear.follower, body, gear.leader, pybullet.JOINT_GEAR),
            *(gear.axis, ZERO, ZERO),
            physicsClientId=self._client,
        )
        pybullet.changeConstraint(constraint, **gear.hold, physicsClientId=self._client)
        return constraint
