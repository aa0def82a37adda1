"""Bodies in Bullet: multibodies from models, and a pool of removed bodies for reuse."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import (
    IDENTITY,
    LIMITED_KINDS,
    ZERO,
    Joint,
    Link,
    Model,
    Shape,
    Vec3,
)
from zensim.sim_server.physics.actuation import Actuation, make_actuation
from zensim.sim_server.physics.blueprint import (
    Blueprint,
    RigidPart,
    ShapeKey,
    check_mesh_files,
    find_nearest_principal_axis,
    make_shape_key,
)
from zensim.sim_server.physics.bullet.bullet_contact import (
    BulletArguments,
    RollingFrictions,
    find_firmness,
    find_rolling_frictions,
    make_contact_arguments,
)
from zensim.sim_server.physics.bullet.joint_servos import COUPLING_ERP, Couplings, find_couplings
from zensim.sim_server.physics.bullet.joint_springs import JointSprings, find_joint_springs
from zensim.sim_server.physics.bullet.pair_friction import (
    MovingSurface,
    find_moving_parts,
    is_loose,
    list_moving_surfaces,
    list_slippery_surfaces,
)
from zensim.sim_server.physics.bullet.wheel_carriers import list_carriers
from zensim.sim_server.physics.engine import MIN_MASS_KG, FloatArray
from zensim.sim_server.physics.free_spin import can_precess
from zensim.sim_server.physics.joint_inertia import find_joint_mobilities
from zensim.sim_server.physics.link_forces import LinkForce, find_common_gravity

MAX_PARKED_BODIES = 64
PARKING_DEPTH_M = 1e4
"""Depth of pooled bodies below the world."""
PARKING_SPACING_M = 100.0
MotorNames = tuple[tuple[str, str], ...]
BodyBuildKey = tuple[tuple[Link, ...], tuple[Joint, ...], bool, bool, tuple[str, ...], MotorNames]
"""What a Bullet body depends on; topics and namespaces do not count, nor do efforts."""
MOMENT_ROUNDING = 1e-6
"""Share by which the largest moment stays below the sum of the others."""
COLLISION_SHAPE_KINDS = ("box", "sphere", "cylinder", "capsule", "mesh")


@dataclass(frozen=True)
class BulletBody:
    """A body in Bullet.

    Attributes:
        parts: Number of parts besides the root.
        links: Bullet's part numbers, in the order of `Model.links`; the root is -1.
        part_links: Index of the link of each part, by Bullet's number + 1.
        actuation: Its motors, by Bullet's joint numbers.
        gears: Bullet's numbers of its gear constraints.
        rolling_frictions: Rolling friction of its wheels while it stands.
        springs: Of its joints; None without any.
        carriers: Bullet's joint numbers of carriers of wheels.
        mass_kg: Of all parts.
        moves: Of each part, whether it can move.
        surfaces: Those that move.
        slippery: Parts that never move with a friction below 1, and the friction.
        is_loose: Whether it is a single link that moves.
        spinning_moments: Principal moments of a loose body that can precess; else None.
        moving: Its moving joints by Bullet's numbers, carriers included.
        servo_gravity: Acceleration [m/s^2] of all links on joints; None if it differs.
        bare: The model without shapes.
        parents: Bullet's number of the parent of each part but the root.
    """

    model: Model
    parts: int
    links: tuple[int, ...]
    part_links: tuple[int, ...]
    actuation: Actuation
    loads: Sequence[LinkForce]
    gears: Sequence[int]
    rolling_frictions: RollingFrictions
    springs: JointSprings | None
    carriers: tuple[int, ...]
    mass_kg: float
    moves: tuple[bool, ...]
    surfaces: tuple[MovingSurface, ...]
    slippery: tuple[tuple[int, float], ...]
    is_loose: bool
    spinning_moments: Vec3 | None
    moving: tuple[tuple[int, Joint], ...]
    servo_gravity: Vec3 | None
    bare: "BareModel"
    parents: tuple[int, ...]

    @cached_property
    def has_twins(self) -> bool:
        """Whether a surface has a twin."""
        return any(surface.is_twin for surface in self.surfaces)

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Bullet's joint numbers, in the order of `Model.joints`."""
        return self.links[1:]

    @cached_property
    def couplings(self) -> Couplings | None:
        """Joints whose efforts are found before a step; None without any."""
        if self.servo_gravity is None:
            return None
        driven = (*self.actuation.speeds.joints, *self.actuation.angles.joints)
        return find_couplings(self.moving, self.actuation.joint_motors, driven)

    @cached_property
    def borne_parts(self) -> frozenset[int]:
        """Bullet's numbers of the parts that hang on joints of `couplings`."""
        moved = set(self.couplings.applied_joints) if self.couplings else set()
        for number, parent in enumerate(self.parents):
            if parent in moved:
                moved.add(number)
        return frozenset(moved)

    def with_model(self, model: Model) -> "BulletBody":
        """Use the body for another model that is built alike."""
        return replace(self, model=model, actuation=make_actuation(model).renumbered(self.joints))


@dataclass(frozen=True, eq=False)
class BareModel:
    """A model without shapes, for its equations of motion.

    Attributes:
        creation: Arguments of createMultiBody.
        moments: Bullet's number of the root and of each part on a joint, and principal moments.
        is_static: Whether the root is fixed.
    """

    creation: BulletArguments
    moments: tuple[tuple[int, tuple[float, float, float]], ...]
    is_static: bool


def make_bare_model(blueprint: Blueprint, creation: BulletArguments) -> BareModel:
    """Make it from the arguments of createMultiBody of a body."""
    none = [-1] * (len(blueprint.parts) - 1)
    parts = enumerate(blueprint.parts, start=-1)
    moments = tuple(
        (number, _limit_moments(list_moments(part)))
        for number, part in parts
        if part.joint or number < 0
    )
    bare = BulletArguments(
        creation,
        baseCollisionShapeIndex=-1,
        baseVisualShapeIndex=-1,
        linkCollisionShapeIndices=none,
        linkVisualShapeIndices=none,
        flags=0,
    )
    return BareModel(bare, moments, blueprint.is_static)


def _limit_moments(moments: tuple[float, float, float]) -> tuple[float, float, float]:
    """Limit the largest moment to the sum of the others: Bullet's equations refuse others.

    Those of driven wheels are larger, as they have the reflected moment of their motors.
    """
    most = (1.0 - MOMENT_ROUNDING) * (sum(moments) - max(moments))
    first, second, third = (min(moment, most) for moment in moments)
    return first, second, third


def make_bullet_body(
    model: Model,
    blueprint: Blueprint,
    loads: Sequence[LinkForce],
    *,
    gravity: Vec3,
    creation: BulletArguments,
) -> BulletBody:
    """Make the record of a body without gears, from its arguments of createMultiBody."""
    moving = list_moving_joints(blueprint)
    links = tuple(part - 1 for part in blueprint.link_parts)
    return BulletBody(
        model,
        parts=len(blueprint.parts) - 1,
        links=links,
        part_links=tuple(part.link for part in blueprint.parts),
        actuation=make_actuation(model).renumbered(links[1:]),
        loads=loads,
        gears=(),
        rolling_frictions=find_rolling_frictions(model, blueprint),
        springs=find_joint_springs(model, moving),
        carriers=list_carriers(blueprint),
        mass_kg=max(blueprint.mass_kg, MIN_MASS_KG),
        moves=find_moving_parts(blueprint),
        surfaces=list_moving_surfaces(blueprint),
        slippery=list_slippery_surfaces(blueprint),
        is_loose=is_loose(blueprint),
        spinning_moments=_find_spinning_moments(blueprint),
        moving=tuple(moving),
        servo_gravity=find_common_gravity(blueprint.links[1:], gravity),
        bare=make_bare_model(blueprint, creation),
        parents=tuple(part.parent - 1 for part in blueprint.parts[1:]),
    )


def _find_spinning_moments(blueprint: Blueprint) -> Vec3 | None:
    moments = list_moments(blueprint.parts[0])
    return moments if is_loose(blueprint) and can_precess(moments) else None


@dataclass(frozen=True)
class BodyRecipe:
    """What all bodies of a model have in common: made once, as it takes as long as a body.

    Attributes:
        blueprint: Of the model.
        creation: Arguments of createMultiBody but for the pose.
        dynamics: Bullet's number of a part, and arguments of changeDynamics, for each call.
        motors: Arguments of setJointMotorControl2, for each call.
        body: Its record, without constraints.
    """

    blueprint: Blueprint
    creation: BulletArguments
    dynamics: tuple[tuple[int, BulletArguments], ...]
    motors: tuple[BulletArguments, ...]
    body: BulletBody


class ParkedBody(NamedTuple):
    """A body taken from the pool."""

    number: int
    body: BulletBody
    was_awake: bool


class BodyPool:
    """Bodies parked below the world."""

    def __init__(self, awake: int) -> None:
        """Keep this many of the newest awake: a sleeping body cannot be reused with a velocity."""
        self._parked: dict[BodyBuildKey, list[tuple[int, BulletBody]]] = {}
        self._count = 0
        self._max_awake = awake
        self._awake: list[int] = []
        self._waking: list[int] = []

    def has_room_for(self, body: BulletBody) -> bool:
        """Whether a body may be parked; not with gears, which would wake it."""
        return self._count < MAX_PARKED_BODIES and not body.gears

    def park(self, number: int, body: BulletBody) -> FloatArray:
        """Park a body; return the state (13,) to set."""
        self._parked.setdefault(_make_build_key(body.model), []).append((number, body))
        self._count += 1
        return np.array(
            [PARKING_SPACING_M * number, 0.0, -PARKING_DEPTH_M, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6]
        )

    def add_awake(self, number: int) -> list[int]:
        """Record that a parked body is awake; return those to put to sleep."""
        self._awake.append(number)
        return self._take_excess_awake()

    def take(self, model: Model, *, awake: bool) -> ParkedBody | None:
        """Take a parked body that is built as a model needs.

        Args:
            model: Of the body.
            awake: Only if it is awake.
        """
        if not self._count:
            return None
        parked = self._parked.get(_make_build_key(model), [])
        for i in reversed(range(len(parked))):
            if not awake or parked[i][0] in self._awake:
                number, body = parked.pop(i)
                self._count -= 1
                was_awake = number in self._awake
                for listed in (self._awake, self._waking):
                    if number in listed:
                        listed.remove(number)
                return ParkedBody(number, body.with_model(model), was_awake)
        return None

    def wake_next(self, model: Model) -> int | None:
        """Choose a sleeping body built as a model needs; it counts as awake after the next step."""
        parked = self._parked.get(_make_build_key(model), [])
        awake = {*self._awake, *self._waking}
        found = next((number for number, _ in reversed(parked) if number not in awake), None)
        if found is not None:
            self._waking.append(found)
        return found

    def after_step(self) -> list[int]:
        """Count woken bodies as awake; return those to put to sleep."""
        self._awake += self._waking
        self._waking.clear()
        return self._take_excess_awake()

    def list_parked(self) -> dict[int, BulletBody]:
        """List all parked bodies by number."""
        return dict(one for parked in self._parked.values() for one in parked)

    def take_all(self) -> list[int]:
        """Empty the pool; return all bodies."""
        taken = [number for parked in self._parked.values() for number, _ in parked]
        self._parked.clear()
        self._awake.clear()
        self._waking.clear()
        self._count = 0
        return taken

    def _take_excess_awake(self) -> list[int]:
        count = max(0, len(self._awake) - self._max_awake)
        excess, self._awake = self._awake[:count], self._awake[count:]
        return excess


def _make_build_key(model: Model) -> BodyBuildKey:
    wheels = model.drive.wheel_joints if model.drive else ()
    motors = tuple((actuator.mode, actuator.joint) for actuator in model.actuators)
    return model.links, model.joints, model.is_static, model.drags, wheels, motors


class GearConstraint(NamedTuple):
    """A mimic joint and its leader, by Bullet's numbers."""

    follower: int
    leader: int
    axis: Vec3
    ratio: float
    offset: float
    force: float = 1e9
    """Limit on the follower [N or N m]."""
    erp: float = COUPLING_ERP
    """Share of the error that a step corrects."""

    @property
    def hold(self) -> dict[str, float]:
        """Arguments of changeConstraint."""
        return {
            "gearRatio": self.ratio,
            "relativePositionTarget": self.offset,
            "erp": self.erp,
            "maxForce": self.force,
        }


def list_gear_constraints(blueprint: Blueprint) -> Iterator[GearConstraint]:
    """List the mimic joints of a body."""
    parts = enumerate(blueprint.parts, start=-1)
    joints = [(number, part.joint) for number, part in parts if part.joint is not None]
    numbers = {joint.name: number for number, joint in joints}
    for follower, joint in joints:
        if (mimic := joint.mimic) is not None:
            leader = numbers[mimic.joint]
            yield GearConstraint(follower, leader, joint.axis, -mimic.multiplier, mimic.offset)


def list_moving_joints(blueprint: Blueprint) -> list[tuple[int, Joint]]:
    """List the joints that move, by the number of their part; the root is -1."""
    return [
        (number, part.joint)
        for number, part in enumerate(blueprint.parts, start=-1)
        if part.joint is not None and part.joint.kind != "fixed"
    ]


def limit_joint_dampings(
    blueprint: Blueprint, springs: JointSprings | None, dt_s: float
) -> Iterator[tuple[int, float]]:
    """Reduce dampings to those of an implicit step: an explicit one diverges when d dt > I.

    Args:
        blueprint: Of the body.
        springs: Of the body; they damp their joints themselves.
        dt_s: Length of a step.

    Yields:
        Number of the part, and the damping [N m s/rad or N s/m]; nothing if all are 0.
    """
    sprung = springs.joints if springs else ()
    damped = [
        (number, joint)
        for number, joint in list_moving_joints(blueprint)
        if joint.damping and number not in sprung
    ]
    if not damped:
        return
    mobilities = find_joint_mobilities(blueprint.parts, is_static=blueprint.is_static)
    for number, joint in damped:
        yield number, joint.damping / (1.0 + joint.damping * dt_s * mobilities[joint.name])


def make_collision_shape_arguments(
    shapes: Sequence[Shape], *, folder: str, kinds: Mapping[str, int], mesh_flag: int
) -> BulletArguments:
    """Make the arguments of createCollisionShapeArray.

    Args:
        shapes: Of one part.
        folder: Of `<Shape.mesh>.stl`.
        kinds: Bullet's number for each kind of shape.
        mesh_flag: Bullet's flag for meshes.
    """
    return BulletArguments(
        shapeTypes=[kinds[s.kind] for s in shapes],
        halfExtents=[[extent / 2 for extent in s.size] for s in shapes],
        radii=[s.size[0] for s in shapes],
        lengths=[s.size[1] for s in shapes],
        fileNames=[f"{folder}/{s.mesh}.stl" if s.mesh else "" for s in shapes],
        meshScales=[s.size if s.mesh else (1.0, 1.0, 1.0) for s in shapes],
        flags=[mesh_flag if s.mesh else 0 for s in shapes],
        collisionFramePositions=[s.origin.position for s in shapes],
        collisionFrameOrientations=[s.origin.orientation for s in shapes],
    )


def make_multibody_arguments(
    blueprint: Blueprint, *, shapes: Sequence[int], visual: int, kinds: Mapping[str, int]
) -> BulletArguments:
    """Make the arguments of createMultiBody but for the pose.

    Args:
        blueprint: Of the body.
        shapes: Bullet's number for the collision shape of each part; -1 for none.
        visual: Bullet's number for the visual shape of every part.
        kinds: Bullet's number for each kind of joint.
    """
    root, *rest = blueprint.parts
    return BulletArguments(
        useMaximalCoordinates=is_rigid_scenery(blueprint),
        baseMass=0.0 if blueprint.is_static else max(root.mass_kg, MIN_MASS_KG),
        baseCollisionShapeIndex=shapes[0],
        baseVisualShapeIndex=visual,
        baseInertialFramePosition=root.com,
        baseInertialFrameOrientation=root.principal,
        linkMasses=[max(one.mass_kg, MIN_MASS_KG) if one.joint else 0.0 for one in rest],
        linkCollisionShapeIndices=shapes[1:],
        # Without visual shapes Bullet tessellates collision shapes: five times slower.
        linkVisualShapeIndices=[visual] * len(rest),
        linkPositions=[part.origin.position for part in rest],
        linkOrientations=[part.origin.orientation for part in rest],
        linkInertialFramePositions=[part.com for part in rest],
        linkInertialFrameOrientations=[part.principal for part in rest],
        linkParentIndices=[part.parent for part in rest],
        linkJointTypes=[kinds[part.joint_kind] for part in rest],
        linkJointAxis=[part.joint.axis if part.joint else (0.0, 0.0, 1.0) for part in rest],
    )


def is_rigid_scenery(blueprint: Blueprint) -> bool:
    """Whether a body never moves and has one part.

    Bullet computes the accelerations of a fixed multibody in each step, but nothing of a rigid
    body.
    """
    root = blueprint.parts[0]
    return blueprint.is_static and len(blueprint.parts) == 1 and root.contact.direction == ZERO


def center_scenery(blueprint: Blueprint) -> Blueprint:
    """Put the centre of mass of a body that never moves into its root link's frame."""
    if not is_rigid_scenery(blueprint):
        return blueprint
    root = replace(blueprint.parts[0], com=ZERO, principal=IDENTITY)
    return replace(blueprint, parts=(root,))


def make_dynamics_arguments(
    blueprint: Blueprint, dt_s: float
) -> Iterator[tuple[int, BulletArguments]]:
    """Make the arguments of changeDynamics of each part; parts are numbered from -1, the root."""
    # Damping is of the whole body; passing it for a link overwrites the root's friction.
    yield -1, BulletArguments(linearDamping=0.0, angularDamping=0.0)
    firmness = find_firmness(blueprint, dt_s)
    parts = zip(blueprint.parts, find_moving_parts(blueprint), strict=True)
    for number, (part, moves) in enumerate(parts, start=-1):
        arguments = make_contact_arguments(
            part, dt_s, is_static=blueprint.is_static, moves=moves, firmness=firmness
        )
        if part.joint is not None or (part.parent < 0 and not blueprint.is_static):
            arguments["localInertiaDiagonal"] = list_moments(part)
        if part.joint is not None and part.joint.kind in LIMITED_KINDS:
            arguments["jointLowerLimit"] = part.joint.lower
            arguments["jointUpperLimit"] = part.joint.upper
        yield number, arguments


def list_moments(part: RigidPart) -> Vec3:
    """List the principal moments [kg m^2] of a part; about an axle with its reflected inertia."""
    moments = list(part.moments)
    if part.joint is not None and part.reflected_inertia > 0.0:
        nearest, _ = find_nearest_principal_axis(part, part.joint.axis)
        moments[nearest] = max(moments[nearest], part.reflected_inertia)
    x, y, z = moments
    return (x, y, z)


class CollisionShapeCache:
    """Collision shapes of an engine; equal shapes are created once."""

    def __init__(
        self,
        make: Callable[..., int],
        *,
        make_exact: Callable[[int], None],
        folder: str,
        kinds: Mapping[str, int],
        concave: int,
    ) -> None:
        """Make an empty cache.

        Args:
            make: Creates a shape from arguments of createCollisionShapeArray.
            make_exact: Takes the margin from the hulls of a shape.
            folder: Of `<Shape.mesh>.stl`.
            kinds: The engine's number for each kind of shape.
            concave: The flag for concave meshes, which only static bodies may have.
        """
        self._make = make
        self._make_exact = make_exact
        self._folder = folder
        self._kinds = kinds
        self._concave = concave
        self._shapes: dict[tuple[ShapeKey, bool], int] = {}

    def find(self, blueprint: Blueprint, shapes: tuple[Shape, ...]) -> int:
        """Find the engine's number for the shapes of one part; create it if missing."""
        if not shapes:
            return -1
        key = _make_shape_key(blueprint, shapes)
        if key not in self._shapes:
            flag = self._concave if blueprint.is_static else 0
            arguments = make_collision_shape_arguments(
                shapes, folder=self._folder, kinds=self._kinds, mesh_flag=flag
            )
            self._shapes[key] = self._make(**arguments)
            if key[1]:
                self._make_exact(self._shapes[key])
        return self._shapes[key]

    def find_missing(self, blueprint: Blueprint) -> list[RigidPart]:
        """List the parts whose shapes are not created yet."""
        solid = (part for part in blueprint.parts if part.shapes)
        keys = {_make_shape_key(blueprint, part.shapes): part for part in solid}
        return [part for key, part in keys.items() if key not in self._shapes]

    def check(self, blueprint: Blueprint, parts: list[RigidPart]) -> None:
        """Check that the mesh files of parts exist; raises EngineRefused if not."""
        check_mesh_files(blueprint.name, parts, self._folder)


def _make_shape_key(blueprint: Blueprint, shapes: tuple[Shape, ...]) -> tuple[ShapeKey, bool]:
    """Make the key of a shape, and whether its hulls need their exact size.

    Bullet's hulls are 1 mm larger than their mesh. On the casters of a robot they would lift its
    driven wheels, which are spheres.
    """
    is_exact = blueprint.has_driven_wheels and any(shape.mesh for shape in shapes)
    return make_shape_key(shapes, is_static=blueprint.is_static), is_exact
