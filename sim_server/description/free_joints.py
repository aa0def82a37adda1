"""Planar and floating joints as chains of joints with one number each, massless in between.

Engines and joint states know joints by one number. A planar joint becomes `_x` and `_y` in its
plane, then a turn about the plane's normal; a floating joint `_x`, `_y`, `_z`, `_yaw`, `_pitch`,
then a roll. The last joint of a chain keeps the name.
"""

from collections.abc import Iterable, Sequence
from math import copysign

import msgspec

from zensim.proto.messages.model_messages import Joint, JointKind, Link, Origin, Vec3
from zensim.sim_server.description.lumping import Lumped
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.wording import shown

REACH_M = 1e5
"""How far a sliding part of a chain goes: the size of the world."""
X: Vec3 = (1.0, 0.0, 0.0)
Y: Vec3 = (0.0, 1.0, 0.0)
Z: Vec3 = (0.0, 0.0, 1.0)
Step = tuple[str, JointKind, Vec3]


def with_chains(lumped: Lumped, report: Report) -> Lumped:
    """Put a chain in the place of each planar and floating joint; tree order is kept."""
    taken = {link.name for link in lumped.links} | {joint.name for joint in lumped.joints}
    links, joints = [lumped.links[0]], []
    for joint, link in zip(lumped.joints, lumped.links[1:], strict=True):
        steps = _steps(joint)
        if steps:
            report.applied(
                f"joint {shown(joint.name)}", f"{joint.kind}: {len(steps)} joints in a chain"
            )
            chain = _chain(joint, steps, taken)
            links += [Link(part.child) for part in chain[:-1]]
            joints += chain
        else:
            joints.append(joint)
        links.append(link)
    return Lumped(tuple(links), tuple(joints), lumped.frames)


def _steps(joint: Joint) -> Sequence[Step]:
    if joint.kind == "planar":
        along, across = _plane(joint.axis)
        return (
            ("_x", "prismatic", along),
            ("_y", "prismatic", across),
            ("", "continuous", joint.axis),
        )
    if joint.kind == "floating":
        return (
            *(("_x", "prismatic", X), ("_y", "prismatic", Y), ("_z", "prismatic", Z)),
            *(("_yaw", "continuous", Z), ("_pitch", "continuous", Y), ("", "continuous", X)),
        )
    return ()


def _plane(normal: Vec3) -> tuple[Vec3, Vec3]:
    # Axes x and y for a normal along z; for others, turned there by the shortest way.
    nx, ny, nz = normal
    sign = copysign(1.0, nz)
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    return (1.0 + sign * nx * nx * a, sign * b, -sign * nx), (b, sign + ny * ny * a, -ny)


def _chain(joint: Joint, steps: Iterable[Step], taken: set[str]) -> list[Joint]:
    chain: list[Joint] = []
    parent, origin = joint.parent, joint.origin
    for suffix, kind, axis in steps:
        reach = REACH_M if kind == "prismatic" else 0.0
        child = _free_name(joint.child + suffix, taken) if suffix else joint.child
        chain.append(
            msgspec.structs.replace(
                joint,
                name=_free_name(joint.name + suffix, taken) if suffix else joint.name,
                kind=kind,
                parent=parent,
                child=child,
                origin=origin,
                axis=axis,
                lower=-reach,
                upper=reach,
                mimic=None,
            )
        )
        parent, origin = child, Origin()
    return chain


def _free_name(wish: str, taken: set[str]) -> str:
    while wish in taken:
        wish += "_"
    taken.add(wish)
    return wish
