"""Bullet multibodies from blueprints: collision shapes, links, dynamics, joint damping and gear constraints."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypedDict

import numpy as np

from zensim.proto.messages.model_messages import Joint, Model, Shape, Vec3
from zensim.sim_server.physics.blueprint import (
    Blueprint,
    RigidPart,
    ShapeKey,
    check_mesh_files,
    make_shape_key,
)
from zensim.sim_server.physics.bullet.bullet_contact import (
    DynamicsArguments,
    make_contact_arguments,
)
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG, FloatArray


class GearConstraint(NamedTuple):
    """A joint that follows another, by their places in `Model.joints`."""

    follower: int
    leader: int
    axis: Vec3
    ratio: float
    offset: float
    force: float = 1e4
    """Most that the follower is pushed with [N or N m]."""
    erp: float = 0.2
    """Share of its error that one step mends."""

    @property
    def hold(self) -> dict[str, float]:
        """Arguments of changeConstraint."""
        return {
            "gearRatio": self.ratio,
            "relativePositionTarget": self.offset,
            "erp": self.erp,
            "maxForce": self.force,
        }


def list_gear_constraints(model: Model) -> Iterator[GearConstraint]:
    """List the joints of a model that follow others."""
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    for follower, joint in enumerate(model.joints):
        if (mimic := joint.mimic) is not None:
            leader = index[mimic.joint]
            yield GearConstraint(follower, leader, joint.axis, -mimic.multiplier, mimic.offset)


def list_moving_joints(blueprint: Blueprint) -> list[tuple[int, Joint]]:
    """List the joints that move, by the number of their part; the root is -1."""
    return [
        (number, part.joint)
        for number, part in enumerate(blueprint.parts, start=-1)
        if part.joint is not None and part.joint.kind != "fixed"
    ]


def limit_joint_dampings(
    joints: Sequence[tuple[int, Joint]], masses: FloatArray, dt_s: float
) -> Iterator[tuple[int, float]]:
    """Damp joints as an implicit step would: an explicit one blows up when d dt > I.

    Args:
        joints: By the number of their part.
        masses: Mass matrix of the body, joints last.
        dt_s: Length of a step.

    Yields:
        Number of the part, and its damping [N m s/rad or N s/m].
    """
    yielding = np.diag(np.linalg.pinv(masses))[-len(joints) :].tolist()
    for (number, joint), lightness in zip(joints, yielding, strict=True):
        yield number, joint.damping / (1.0 + joint.damping * dt_s * max(lightness, 0.0))


COLLISION_SHAPE_KINDS = ("box", "sphere", "cylinder", "capsule", "mesh")


class CollisionShapeArguments(TypedDict):
    """Arguments of createCollisionShapeArray."""

    shapeTypes: Sequence[int]
    halfExtents: Sequence[Sequence[float]]
    radii: Sequence[float]
    lengths: Sequence[float]
    fileNames: Sequence[str]
    meshScales: Sequence[Sequence[float]]
    flags: Sequence[int]
    collisionFramePositions: Sequence[Sequence[float]]
    collisionFrameOrientations: Sequence[Sequence[float]]


def make_collision_shape_arguments(
    shapes: Sequence[Shape], *, folder: str, kinds: Mapping[str, int], mesh_flag: int
) -> CollisionShapeArguments:
    """Lay collisions out.

    Args:
        shapes: What to make.
        folder: Where `<Shape.mesh>.stl` is.
        kinds: Bullet's number for each kind of shape.
        mesh_flag: How meshes are to be taken.
    """
    return CollisionShapeArguments(
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


class MultiBodyArguments(TypedDict):
    """Arguments of createMultiBody."""

    baseMass: float
    baseCollisionShapeIndex: int
    baseVisualShapeIndex: int
    basePosition: Sequence[float]
    baseOrientation: Sequence[float]
    baseInertialFramePosition: Sequence[float]
    baseInertialFrameOrientation: Sequence[float]
    linkMasses: Sequence[float]
    linkCollisionShapeIndices: Sequence[int]
    linkVisualShapeIndices: Sequence[int]
    linkPositions: Sequence[Sequence[float]]
    linkOrientations: Sequence[Sequence[float]]
    linkInertialFramePositions: Sequence[Sequence[float]]
    linkInertialFrameOrientations: Sequence[Sequence[float]]
    linkParentIndices: Sequence[int]
    linkJointTypes: Sequence[int]
    linkJointAxis: Sequence[Sequence[float]]


def make_multibody_arguments(
    blueprint: Blueprint,
    base: FloatArray,
    *,
    shapes: Sequence[int],
    visual: int,
    kinds: Mapping[str, int],
) -> MultiBodyArguments:
    """Lay a blueprint out.

    Args:
        blueprint: What to make.
        base: State row (13,) of its root link.
        shapes: Bullet's number for the collision shape of each part; -1 for none.
        visual: Bullet's number for what every part looks like.
        kinds: Bullet's number for each kind of joint.
    """
    root, *rest = blueprint.parts
    return MultiBodyArguments(
        baseMass=0.0 if blueprint.is_static else max(root.mass_kg, MIN_MASS_KG),
        baseCollisionShapeIndex=shapes[0],
        baseVisualShapeIndex=visual,
        basePosition=base[:3].tolist(),
        baseOrientation=base[3:7].tolist(),
        baseInertialFramePosition=root.com,
        baseInertialFrameOrientation=root.principal,
        linkMasses=[_link_mass(part) for part in rest],
        linkCollisionShapeIndices=shapes[1:],
        # Without a visual shape Bullet tessellates every collision shape: five times the cost.
        linkVisualShapeIndices=[visual] * len(rest),
        linkPositions=[part.origin.position for part in rest],
        linkOrientations=[part.origin.orientation for part in rest],
        linkInertialFramePositions=[part.com for part in rest],
        linkInertialFrameOrientations=[part.principal for part in rest],
        linkParentIndices=[part.parent for part in rest],
        linkJointTypes=[kinds[part.joint_kind] for part in rest],
        linkJointAxis=[part.joint.axis if part.joint else (0.0, 0.0, 1.0) for part in rest],
    )


def make_dynamics_arguments(
    blueprint: Blueprint, dt_s: float
) -> Iterator[tuple[int, DynamicsArguments]]:
    """Lay out how the parts of a blueprint move and touch; parts are numbered from -1, the root."""
    # Damping belongs to the whole body; passing it for a link rewrites the root's friction.
    yield -1, DynamicsArguments(linearDamping=0.0, angularDamping=0.0)
    for number, part in enumerate(blueprint.parts, start=-1):
        found = make_contact_arguments(part, dt_s, is_static=blueprint.is_static)
        if part.joint is not None or (part.parent < 0 and not blueprint.is_static):
            found["localInertiaDiagonal"] = [max(moment, MIN_INERTIA) for moment in part.inertia]
        if part.joint is not None and part.joint.kind in ("revolute", "prismatic"):
            found["jointLowerLimit"] = part.joint.lower
            found["jointUpperLimit"] = part.joint.upper
        yield number, found


def _link_mass(part: RigidPart) -> float:
    return 0.0 if part.joint is None else max(part.mass_kg, MIN_MASS_KG)


class CollisionShapeCache:
    """Which shapes an engine has made, by what they are."""

    def __init__(
        self, make: Callable[..., int], *, folder: str, kinds: Mapping[str, int], dented: int
    ) -> None:
        """Begin with none.

        Args:
            make: Makes one of what `solids_of` lays out.
            folder: Where `<Shape.mesh>.stl` is.
            kinds: The engine's number for each kind of shape.
            dented: The flag of meshes that are taken as they are; only what never moves may be.
        """
        self._make = make
        self._folder = folder
        self._kinds = kinds
        self._dented = dented
        self._made: dict[ShapeKey, int] = {(): -1}

    def find(self, plan: Blueprint, shapes: tuple[Shape, ...]) -> int:
        """Find the engine's number for the shapes of one part, made now if need be."""
        key = make_shape_key(shapes, is_static=plan.is_static)
        if key not in self._made:
            flag = self._dented if plan.is_static else 0
            solids = make_collision_shape_arguments(
                shapes, folder=self._folder, kinds=self._kinds, mesh_flag=flag
            )
            self._made[key] = self._make(**solids)
        return self._made[key]

    def find_missing(self, plan: Blueprint) -> list[RigidPart]:
        """List the parts whose shapes the engine has not yet."""
        keys = {make_shape_key(part.shapes, is_static=plan.is_static): part for part in plan.parts}
        return [part for key, part in keys.items() if key not in self._made]

    def check(self, plan: Blueprint, parts: list[RigidPart]) -> None:
        """See that meshes of parts can be made; raises EngineRefused if not."""
        check_mesh_files(plan.name, parts, self._folder)
