"""Carriers of skid-steered wheels in Bullet: they make a wheel yield alike in both directions.

Bullet scales the two friction rows of a contact by their own compliances before it clips them to a
circle, so that friction points along the slip only where both are alike (ADR 44). A wheel yields
ahead by its moment about the axle. A carrier, a link between body and wheel whose motor holds it,
lets it yield as easily sideways: about the axis ahead through the wheel's centre.
"""

from dataclasses import replace

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import ZERO, Contact, Joint, Origin, Vec3
from zensim.proto.rigid_transforms import conjugate, cross, from_directions, normalize, rotate
from zensim.proto.se3 import FloatArray
from zensim.sim_server.physics.blueprint import X_AXIS, Blueprint, RigidPart, order_depth_first
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG
from zensim.sim_server.physics.joint_inertia import MassMatrix, find_part_poses, make_mass_matrix

CARRIER_LINK = -1
"""`RigidPart.link` of carriers."""
MIN_SKID_WHEELS = 3
"""Driven wheels from which a robot is skid steered."""
MAX_AXLE_RISE = 0.1
"""Largest sine of the angle between an axle and the ground."""
ROUNDS = 4
"""Of finding the moments of all carriers, each of which changes how the others yield."""
MAX_MOMENT_RATIO = 50.0
"""Bound of a carrier's moment, over the wheel's about its axle."""


def add_wheel_carriers(blueprint: Blueprint) -> Blueprint:
    """Put a carrier between the body and each wheel of a skid-steered robot; depth first.

    Others stay as they are: with fewer than three driven wheels, a wheel that is no sphere on a
    level axle of the root, or links that collide with each other.
    """
    wheels = [i for i, part in enumerate(blueprint.parts) if part.reflected_inertia > 0.0]
    if (
        len(wheels) < MIN_SKID_WHEELS
        or not all(_can_be_carried(blueprint.parts[i]) for i in wheels)
        or any(link.self_collides for link in blueprint.links)
    ):
        return blueprint
    moments = [blueprint.parts[i].reflected_inertia for i in wheels]
    for _ in range(ROUNDS):
        found = _put_on_carriers(blueprint, wheels, moments)
        moments = _balance_moments(found)
    return _put_on_carriers(blueprint, wheels, moments)


def list_carriers(blueprint: Blueprint) -> tuple[int, ...]:
    """List Bullet's numbers of carriers."""
    parts = enumerate(blueprint.parts, start=-1)
    return tuple(number for number, part in parts if part.link == CARRIER_LINK)


def _can_be_carried(part: RigidPart) -> bool:
    return (
        part.parent == 0
        and part.joint is not None
        and [shape.kind for shape in part.shapes] == ["sphere"]
        and abs(_find_axle(part)[2]) < MAX_AXLE_RISE
    )


def _find_axle(part: RigidPart) -> Vec3:
    """Find the axle in the frame in which its joint is."""
    assert part.joint is not None
    return normalize(rotate(part.joint.origin.orientation, part.joint.axis))


def _put_on_carriers(blueprint: Blueprint, wheels: list[int], moments: list[float]) -> Blueprint:
    parts = list(blueprint.parts)
    for i, moment in zip(wheels, moments, strict=True):
        joint = parts[i].joint
        assert joint is not None
        parts.append(_make_carrier(parts[i], joint, moment))
        on_carrier = msgspec.structs.replace(joint, origin=Origin())
        parts[i] = replace(parts[i], parent=len(parts) - 1, joint=on_carrier)
    return order_depth_first(replace(blueprint, parts=tuple(parts)))


def _make_carrier(wheel: RigidPart, joint: Joint, moment: float) -> RigidPart:
    ahead = normalize(cross(_find_axle(wheel), (0.0, 0.0, 1.0)))
    axis = rotate(conjugate(joint.origin.orientation), ahead)
    held = Joint(f"{joint.name} (carrier)", "continuous", joint.parent, "", joint.origin, axis=axis)
    return RigidPart(
        mass_kg=MIN_MASS_KG,
        com=ZERO,
        principal=from_directions(X_AXIS, axis),
        inertia=(max(moment, MIN_INERTIA), MIN_INERTIA, MIN_INERTIA),
        shapes=(),
        friction=0.0,
        contact=Contact(),
        parent=0,
        link=CARRIER_LINK,
        joint=held,
    )


def _balance_moments(blueprint: Blueprint) -> list[float]:
    """Find the moments with which each wheel yields alike ahead and sideways, as friction goes."""
    mass = make_mass_matrix(blueprint.parts)
    inverse, poses = mass.invert(is_static=blueprint.is_static), find_part_poses(blueprint.parts)
    found = {}
    for i, wheel in enumerate(blueprint.parts):
        if wheel.reflected_inertia == 0.0:
            continue
        radius = wheel.shapes[0].size[0]
        carrier = blueprint.parts[wheel.parent]
        touching = np.array(poses[i].position) - [0.0, 0.0, radius]
        axle = rotate(poses[wheel.parent].orientation, _find_axle(wheel))
        ahead = cross(axle, (0.0, 0.0, 1.0))
        sideways, forwards = (
            _find_mobility(mass, inverse, blueprint, i, touching, np.array(way))
            for way in (axle, ahead)
        )
        own = radius * radius / carrier.inertia[0]
        wanted = forwards * _find_friction_ratio(wheel) - (sideways - own)
        least = radius * radius / (MAX_MOMENT_RATIO * wheel.reflected_inertia)
        found[wheel.link] = radius * radius / max(wanted, least)
    return [found[link] for link in sorted(found)]


def _find_friction_ratio(wheel: RigidPart) -> float:
    """Find (friction across the axle / friction along it) squared."""
    across, along = wheel.contact.friction_across, wheel.friction
    if wheel.contact.direction == ZERO or along == 0.0:
        return 1.0
    return (across / along) ** 2


def _find_mobility(
    mass: MassMatrix,
    inverse: FloatArray,
    blueprint: Blueprint,
    part: int,
    point: FloatArray,
    way: FloatArray,
) -> float:
    """Find the acceleration of a point of a part along a direction per unit of force there."""
    wrench = np.concatenate([np.cross(point, way), way])
    effort = np.zeros(len(inverse))
    effort[: len(wrench)] = wrench
    while part > 0:
        if part in mass.rows:
            effort[mass.rows[part]] = mass.axes[part] @ wrench
        part = blueprint.parts[part].parent
    return float(effort @ inverse @ effort)
