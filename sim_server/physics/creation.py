"""What Bullet is asked to make of a blueprint."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TypedDict

from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.physics.blueprint import Blueprint, Part
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG, FloatArray
from zensim.sim_server.physics.touch import Dynamics, touch_of

SOLID_KINDS = ("box", "sphere", "cylinder", "capsule", "mesh")


class Solids(TypedDict):
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


def solids_of(
    shapes: Sequence[Shape], *, folder: str, kinds: Mapping[str, int], mesh_flag: int
) -> Solids:
    """Lay collisions out.

    Args:
        shapes: What to make.
        folder: Where `<Shape.mesh>.stl` is.
        kinds: Bullet's number for each kind of shape.
        mesh_flag: How meshes are to be taken.
    """
    return Solids(
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


class Creation(TypedDict):
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


def creation_of(
    blueprint: Blueprint,
    base: FloatArray,
    *,
    shapes: Sequence[int],
    visual: int,
    kinds: Mapping[str, int],
) -> Creation:
    """Lay a blueprint out.

    Args:
        blueprint: What to make.
        base: State row (13,) of its root link.
        shapes: Bullet's number for the collision shape of each part; -1 for none.
        visual: Bullet's number for what every part looks like.
        kinds: Bullet's number for each kind of joint.
    """
    root, *rest = blueprint.parts
    return Creation(
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


def dynamics_of(blueprint: Blueprint, dt_s: float) -> Iterator[tuple[int, Dynamics]]:
    """Lay out how the parts of a blueprint move and touch; parts are numbered from -1, the root."""
    # Damping belongs to the whole body; passing it for a link rewrites the root's friction.
    yield -1, Dynamics(linearDamping=0.0, angularDamping=0.0)
    for number, part in enumerate(blueprint.parts, start=-1):
        found = touch_of(part, dt_s, is_static=blueprint.is_static)
        if part.joint is not None or (part.parent < 0 and not blueprint.is_static):
            found["localInertiaDiagonal"] = [max(moment, MIN_INERTIA) for moment in part.inertia]
        if part.joint is not None and part.joint.kind in ("revolute", "prismatic"):
            found["jointLowerLimit"] = part.joint.lower
            found["jointUpperLimit"] = part.joint.upper
        yield number, found


def _link_mass(part: Part) -> float:
    return 0.0 if part.joint is None else max(part.mass_kg, MIN_MASS_KG)
