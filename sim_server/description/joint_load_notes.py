"""Report entries on controlled joints: those that their efforts cannot hold, and what they cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from zensim.proto.messages.model_messages import Inertial, Origin, ReportEntry
from zensim.proto.rigid_transforms import cross, normalize, rotate, transform_point
from zensim.sim_server.description.mimic_joints import list_following_joints
from zensim.sim_server.description.model_geometry import find_link_poses, find_start_positions
from zensim.sim_server.description.rest_pose import GRAVITY
from zensim.sim_server.description.strict_parsing import quote

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from zensim.proto.messages.model_messages import Joint, Link, Model, Vec3

TOLERANCE = 1e-3
"""Share of its limit by which the load of a joint may be more without an entry."""
MOST_SHOWN = 3
"""Frictions or joints that an entry names."""
COST = ReportEntry(
    "applied",
    "cost",
    "its controlled joints and followers take about 0.05 ms of each step in PyBullet; while they "
    "bear contacts, other robots of its world may take 1.4 times as long",
)


def describe_joint_loads(model: Model) -> tuple[ReportEntry, ...]:
    """Describe which controlled joints fall or yield, the root level; nothing without controllers.

    Loads are those of gravity at the start: at the initial positions of controllers, else 0. A
    joint bears what hangs on it, and what hangs on the joints that mimic it.
    """
    names = {name for one in model.joint_controllers for name in one.joints}
    if not names and all(joint.mimic is None for joint in model.joints):
        return ()
    loads = _find_loads(model)
    fallen = (joint for joint in model.joints if joint.name in names and _falls(joint, loads))
    notes = [_describe_fall(joint, loads[joint.name]) for joint in fallen]
    if names and not _has_one_gravity(model):
        notes.append(UNEVEN)
    if bent := _list_bent(model, names):
        notes.append(_describe_bending(bent))
    if names and any(link.collisions for link in model.links[1:]):
        notes += _describe_grip(model)
    return (*notes, COST)


def _describe_grip(model: Model) -> Iterator[ReportEntry]:
    """Say what PyBullet makes of the frictions of links that hold or push what moves."""
    shapes = (shape for link in model.links for shape in link.collisions)
    frictions = sorted({shape.friction for shape in shapes} - {0.0, 1.0})
    if frictions:
        shown = ", ".join(f"{one:g}" for one in frictions[:MOST_SHOWN])
        note = f"{shown} on a moving body grips by the product with its friction in PyBullet, "
        yield ReportEntry("predicted", "friction", note + "not by the lesser")


def _list_bent(model: Model, names: set[str]) -> list[str]:
    """List the controlled joints, and with them followers, beyond which a link can touch."""
    touching = {link.name for link in model.links if link.collisions}
    for joint in reversed(model.joints):
        if joint.child in touching:
            touching.add(joint.parent)
    held = (one for one in model.joints if one.name in names or (names and one.mimic is not None))
    return [one.name for one in held if one.child in touching]


def _describe_bending(names: list[str]) -> ReportEntry:
    shown = ", ".join(quote(one) for one in names[:MOST_SHOWN])
    more = f" and {len(names) - MOST_SHOWN} more" if len(names) > MOST_SHOWN else ""
    return ReportEntry(
        "predicted",
        "joints",
        f"contacts bend {shown}{more} in PyBullet, with the square of the step; measured: a box of "
        "5 kg bends six joints over 1.5 m by 15 mrad at 100 Hz, 3 at 240 Hz (MuJoCo: 0.35, 0.06)",
    )


UNEVEN = ReportEntry(
    "predicted",
    "joints",
    "gravity acts on some of its links only: in PyBullet, heavy chains of joints yield",
)


def _has_one_gravity(model: Model) -> bool:
    moving = model.links[1:]
    is_free = [link.weightless == link.inertial for link in moving]
    return all(is_free) or all(link.weightless == Inertial() for link in moving)


def _falls(joint: Joint, loads: Mapping[str, float]) -> bool:
    most = joint.effort * joint.motor_factor
    return 0.0 < most < abs(loads[joint.name]) * (1.0 - TOLERANCE)


def _describe_fall(joint: Joint, load: float) -> ReportEntry:
    unit = "N" if joint.kind == "prismatic" else "N m"
    return ReportEntry(
        "predicted",
        f"joint {quote(joint.name)}",
        f"it falls: its effort is limited to {joint.effort * joint.motor_factor:.3g} {unit}, and "
        f"gravity takes {abs(load):.3g} {unit} where it starts; raise its effort, or lower masses",
    )


class _Weight(NamedTuple):
    """Mass [kg] on which gravity acts, and its first moment [kg m] in the root's axes."""

    mass_kg: float
    moment: Vec3


def _find_loads(model: Model) -> dict[str, float]:
    """Find the effort of gravity on each joint, followers' included."""
    positions = find_start_positions(model)
    poses = find_link_poses(model.links[0].name, model.joints, positions)
    beyond = {link.name: _weigh(link, poses[link.name]) for link in model.links}
    loads: dict[str, float] = {}
    for joint in reversed(model.joints):
        own, above = beyond[joint.child], beyond[joint.parent]
        loads[joint.name] = _find_own_load(joint, poses[joint.child], own)
        x, y, z = (one + other for one, other in zip(above.moment, own.moment, strict=True))
        beyond[joint.parent] = _Weight(above.mass_kg + own.mass_kg, (x, y, z))
    for follower, leader, ratio, _ in list_following_joints(model.joints):
        loads[model.joints[leader].name] += ratio * loads[model.joints[follower].name]
    return loads


def _weigh(link: Link, pose: Origin) -> _Weight:
    moment = [0.0, 0.0, 0.0]
    mass_kg = link.inertial.mass_kg - link.weightless.mass_kg
    for one, sign in ((link.inertial, 1.0), (link.weightless, -1.0)):
        place = transform_point(pose, one.com_in_link)
        for axis in range(3):
            moment[axis] += sign * one.mass_kg * place[axis]
    x, y, z = moment
    return _Weight(mass_kg, (x, y, z))


def _find_own_load(joint: Joint, pose: Origin, weight: _Weight) -> float:
    """Find the effort along the axis of what hangs on a joint."""
    if joint.kind == "fixed":
        return 0.0
    axis = normalize(rotate(pose.orientation, joint.axis))
    force = (0.0, 0.0, -GRAVITY)
    if joint.kind == "prismatic":
        return -GRAVITY * weight.mass_kg * axis[2]
    x, y, z = (
        total - weight.mass_kg * pivot
        for total, pivot in zip(weight.moment, pose.position, strict=True)
    )
    turning = cross((x, y, z), force)
    return sum(one * other for one, other in zip(axis, turning, strict=True))
