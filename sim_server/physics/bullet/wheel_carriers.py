"""Carriers of sliding wheels in Bullet: they make a wheel yield alike in all directions.

Bullet scales the two friction rows of a contact, which are along the world's axes, by their own
compliances before it clips them to a circle, so that friction points along the slip only where a
contact yields alike in all directions (ADR 44). A wheel yields ahead by its moment about the axle.
A carrier, a link between body and wheel whose motor holds it, lets it yield as easily sideways.

Its axis is upright and abeam of the robot's centre of mass, so that a force on the wheel in one
direction does not move it in the other by turning the robot. Wheels that are abeam themselves, or
too heavy for that, have a level axis ahead through their centre.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import ZERO, Contact, Joint, Origin, Quat, Shape, Vec3
from zensim.proto.rigid_transforms import (
    compose,
    conjugate,
    cross,
    from_directions,
    invert,
    multiply,
    normalize,
    rotate,
    transform_point,
)
from zensim.proto.se3 import FloatArray
from zensim.sim_server.physics.blueprint import (
    X_AXIS,
    Blueprint,
    RigidPart,
    find_nearest_principal_axis,
    find_principal_axes,
    order_depth_first,
)
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG
from zensim.sim_server.physics.joint_inertia import MassMatrix, find_part_poses, make_mass_matrix

CARRIER_LINK = -1
"""`RigidPart.link` of carriers."""
MIN_SKID_WHEELS = 3
"""Driven wheels from which a robot is skid steered."""
MAX_AXLE_RISE = 0.1
"""Largest sine of the angle between an axle and the ground."""
MAX_UPRIGHT_Z = 0.5
"""Axes with a greater z count as upright: a wheel beyond such a joint is steered."""
MIN_LEVER_RADII = 0.5
"""Distance ahead of the centre of mass, over the wheel's radius, from which axes are upright."""
ROUNDS = 6
"""Rounds that find the moments of all carriers, each of which changes how the others yield."""
MAX_MOMENT_RATIO = 50.0
"""Bound of a carrier's moment, over the wheel's about its axle."""
KEPT_MOMENT_SHARE = 0.5
"""Share of a wheel's moment about the axle that it keeps, as a disc has across it."""
UP: Vec3 = (0.0, 0.0, 1.0)
AXES: tuple[Vec3, ...] = (X_AXIS, (0.0, 1.0, 0.0), UP)


@dataclass(frozen=True)
class Carrier:
    """The carrier of a wheel; directions and places are in the root, joints at zero.

    Attributes:
        link: Index of the wheel's link.
        axle: Unit.
        touching: Lowest point of the wheel.
        radius_m: Of the wheel.
        friction_ratio: See `_find_friction_ratio`.
        axis: Unit.
        pivot: A point of the axis.
        moment: About the axis [kg m^2].
    """

    link: int
    axle: Vec3
    touching: Vec3
    radius_m: float
    friction_ratio: float
    axis: Vec3
    pivot: Vec3
    moment: float

    @property
    def lever_m(self) -> float:
        """How far the wheel's lowest point moves sideways by a turn of one radian."""
        arm = _subtract(self.touching, self.pivot)
        return abs(_dot(cross(self.axis, arm), self.axle))


def add_wheel_carriers(blueprint: Blueprint) -> Blueprint:
    """Put a carrier between the body and each driven wheel of a robot that slides; depth first.

    It does with three or more driven wheels, or if it drags. Others stay as they are, and those
    with a wheel that is no sphere on a level axle or is steered, links that collide with each
    other, or sizes and masses that differ too much for the numbers.
    """
    wheels = [i for i, part in enumerate(blueprint.parts) if part.reflected_inertia > 0.0]
    if (
        not wheels
        or (len(wheels) < MIN_SKID_WHEELS and not blueprint.drags)
        or any(link.self_collides for link in blueprint.links)
        or not all(_can_be_carried(blueprint, i) for i in wheels)
    ):
        return blueprint
    try:
        # A description may have any numbers up to 1e12.
        with np.errstate(all="ignore"):
            found = _carry(blueprint, wheels)
    except (ArithmeticError, np.linalg.LinAlgError):
        return blueprint
    return found if np.isfinite([part.inertia for part in found.parts]).all() else blueprint


def _carry(blueprint: Blueprint, wheels: Sequence[int]) -> Blueprint:
    com = _find_center_of_mass(blueprint)
    carriers = [_place_carrier(blueprint, i, com) for i in wheels]
    moments = _balance_moments(blueprint, carriers)
    if min(moments) <= MIN_INERTIA:
        carriers = [
            one if moment > MIN_INERTIA else _make_level(blueprint, one)
            for one, moment in zip(carriers, moments, strict=True)
        ]
        moments = _balance_moments(blueprint, carriers)
    if min(moments) <= MIN_INERTIA:
        blueprint = _move_moments_inwards(blueprint, wheels)
        moments = _balance_moments(blueprint, carriers)
    return _put_on_carriers(blueprint, _with_moments(carriers, moments))


def _move_moments_inwards(blueprint: Blueprint, wheels: Iterable[int]) -> Blueprint:
    """Move moments of wheels across their axles to their parents; it turns with them alike.

    Descriptions have moments that are far too large for the wheel's mass and radius: it would not
    yield on any carrier.
    """
    parts, poses = list(blueprint.parts), find_part_poses(blueprint.parts)
    for i in wheels:
        wheel, above = parts[i], parts[parts[i].parent]
        assert wheel.joint is not None
        axle = find_nearest_principal_axis(wheel, wheel.joint.axis)[0]
        kept = min(wheel.inertia[axle], wheel.reflected_inertia) * KEPT_MOMENT_SHARE
        moved = [
            0.0 if n == axle else max(0.0, moment - kept) for n, moment in enumerate(wheel.inertia)
        ]
        if above.contact.direction != ZERO:
            continue
        own = multiply(invert(poses[wheel.parent]).orientation, poses[i].orientation)
        tensor = _make_tensor(above.principal, above.inertia)
        tensor += _make_tensor(multiply(own, wheel.principal), moved)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor.tolist()
        inertia, principal = find_principal_axes((xx, xy, xz, yy, yz, zz))
        parts[wheel.parent] = replace(above, inertia=inertia, principal=principal)
        x, y, z = (moment - less for moment, less in zip(wheel.inertia, moved, strict=True))
        parts[i] = replace(wheel, inertia=(x, y, z))
    return replace(blueprint, parts=tuple(parts))


def _make_tensor(orientation: Quat, moments: Sequence[float]) -> FloatArray:
    """Make the inertia tensor of moments about the axes of a frame."""
    axes = np.array([rotate(orientation, axis) for axis in AXES])
    return np.asarray(axes.T @ np.diag(moments) @ axes)


def list_carriers(blueprint: Blueprint) -> tuple[int, ...]:
    """List Bullet's numbers of carriers."""
    parts = enumerate(blueprint.parts, start=-1)
    return tuple(number for number, part in parts if part.link == CARRIER_LINK)


def _can_be_carried(blueprint: Blueprint, wheel: int) -> bool:
    poses = find_part_poses(blueprint.parts)
    part = blueprint.parts[wheel]
    if not any(_list_spheres(blueprint, part.link)):
        return False
    if abs(_find_axis(part, poses[wheel])[2]) >= MAX_AXLE_RISE:
        return False
    above = part.parent
    while above > 0:
        joint = blueprint.parts[above].joint
        if joint and abs(_find_axis(blueprint.parts[above], poses[above])[2]) > MAX_UPRIGHT_Z:
            return False
        above = blueprint.parts[above].parent
    return True


def _list_spheres(blueprint: Blueprint, link: int) -> Iterator[tuple[RigidPart, Shape]]:
    """List the spheres of a link, each with its part: further surfaces have parts of their own."""
    for part in blueprint.parts:
        if part.link == link:
            yield from ((part, shape) for shape in part.shapes if shape.kind == "sphere")


def _find_axis(part: RigidPart, pose: Origin) -> Vec3:
    """Find the axis of the joint of a part in the root."""
    assert part.joint is not None
    return normalize(rotate(pose.orientation, part.joint.axis))


def _find_center_of_mass(blueprint: Blueprint) -> Vec3:
    """Find the centre of mass of all parts in the root."""
    matrix = make_mass_matrix(blueprint.parts).matrix
    x, y, z = (matrix[[2, 0, 1], [4, 5, 3]] / matrix[3, 3]).tolist()
    return x, y, z


def _place_carrier(blueprint: Blueprint, wheel: int, com: Vec3) -> Carrier:
    part, pose = blueprint.parts[wheel], find_part_poses(blueprint.parts)[wheel]
    surface, shape = max(
        _list_spheres(blueprint, part.link),
        key=lambda one: one[1].size[0] - transform_point(pose, one[1].origin.position)[2],
    )
    radius = shape.size[0]
    x, y, z = center = transform_point(pose, shape.origin.position)
    axle = _find_axis(part, pose)
    ahead = normalize(cross(axle, UP))
    lever = _dot(_subtract(center, com), ahead)
    level = Carrier(
        part.link,
        axle,
        touching=(x, y, z - radius),
        radius_m=radius,
        friction_ratio=_find_friction_ratio(surface),
        axis=ahead,
        pivot=center,
        moment=part.reflected_inertia,
    )
    if abs(lever) < MIN_LEVER_RADII * radius:
        return level
    px, py, pz = (place - lever * way for place, way in zip(center, ahead, strict=True))
    moment = part.reflected_inertia * (lever / radius) ** 2
    return replace(level, axis=UP, pivot=(px, py, pz), moment=moment)


def _make_level(blueprint: Blueprint, carrier: Carrier) -> Carrier:
    wheel = blueprint.parts[blueprint.link_parts[carrier.link]]
    x, y, z = carrier.touching
    return replace(
        carrier,
        axis=normalize(cross(carrier.axle, UP)),
        pivot=(x, y, z + carrier.radius_m),
        moment=wheel.reflected_inertia,
    )


def _with_moments(carriers: Iterable[Carrier], moments: Iterable[float]) -> list[Carrier]:
    return [replace(one, moment=moment) for one, moment in zip(carriers, moments, strict=True)]


def _put_on_carriers(blueprint: Blueprint, carriers: Iterable[Carrier]) -> Blueprint:
    parts, poses = list(blueprint.parts), find_part_poses(blueprint.parts)
    for carrier in carriers:
        i = blueprint.link_parts[carrier.link]
        parent, joint = parts[i].parent, parts[i].joint
        assert joint is not None
        placed = Origin(carrier.pivot, poses[i].orientation)
        origin = compose(invert(poses[parent]), placed)
        on_carrier = compose(invert(placed), poses[i])
        parts.append(_make_carrier_part(joint, carrier, origin, placed, parent))
        moved = msgspec.structs.replace(joint, origin=on_carrier)
        parts[i] = replace(parts[i], parent=len(parts) - 1, joint=moved)
    return order_depth_first(replace(blueprint, parts=tuple(parts)))


def _make_carrier_part(
    joint: Joint, carrier: Carrier, origin: Origin, placed: Origin, parent: int
) -> RigidPart:
    axis = rotate(conjugate(placed.orientation), carrier.axis)
    held = Joint(f"{joint.name} (carrier)", "continuous", joint.parent, "", origin, axis=axis)
    return RigidPart(
        mass_kg=MIN_MASS_KG,
        com=ZERO,
        principal=from_directions(X_AXIS, axis),
        inertia=(max(carrier.moment, MIN_INERTIA), MIN_INERTIA, MIN_INERTIA),
        shapes=(),
        friction=0.0,
        contact=Contact(),
        parent=parent,
        link=CARRIER_LINK,
        joint=held,
    )


def _balance_moments(blueprint: Blueprint, carriers: Sequence[Carrier]) -> list[float]:
    """Find the moments with which each wheel yields alike ahead and sideways, as friction goes."""
    found = _put_on_carriers(blueprint, carriers)
    mass = make_mass_matrix(found.parts)
    efforts = [_find_efforts(mass, found, one) for one in carriers]
    matrix, moments = mass.matrix.copy(), [one.moment for one in carriers]
    for _ in range(ROUNDS):
        inverse = mass._replace(matrix=matrix).invert(is_static=blueprint.is_static)
        for n, (one, own) in enumerate(zip(carriers, efforts, strict=True)):
            lever = one.lever_m**2
            turning = matrix[own.row, own.row]
            wanted = one.friction_ratio * (own.ahead @ inverse @ own.ahead) + lever / turning
            wanted = max(wanted - own.aside @ inverse @ own.aside, lever / own.most)
            moment = max(lever / wanted - (turning - moments[n]), MIN_INERTIA)
            matrix += (moment - moments[n]) * np.outer(own.turn, own.turn)
            moments[n] = moment
    return moments


class _Efforts(NamedTuple):
    """Efforts of the joints and the root by a unit of force on a wheel's lowest point.

    Attributes:
        ahead, aside: By a force in this direction.
        turn: By a torque on the carrier.
        row: Of the carrier.
        most: Bound of the carrier's moment.
    """

    ahead: FloatArray
    aside: FloatArray
    turn: FloatArray
    row: int
    most: float


def _find_efforts(mass: MassMatrix, blueprint: Blueprint, carrier: Carrier) -> _Efforts:
    i = blueprint.link_parts[carrier.link]
    wheel = blueprint.parts[i]
    ahead, aside = cross(carrier.axle, UP), carrier.axle
    return _Efforts(
        _find_effort(mass, blueprint, i, (*cross(carrier.touching, ahead), *ahead)),
        _find_effort(mass, blueprint, i, (*cross(carrier.touching, aside), *aside)),
        _find_effort(mass, blueprint, wheel.parent, (*carrier.axis, *ZERO)),
        mass.rows[wheel.parent],
        MAX_MOMENT_RATIO * wheel.reflected_inertia,
    )


def _find_effort(
    mass: MassMatrix, blueprint: Blueprint, part: int, wrench: Sequence[float]
) -> FloatArray:
    """Find the efforts by a wrench (6,) on a part at the root's origin: torque, force."""
    effort = np.zeros(len(mass.matrix))
    effort[: len(wrench)] = wrench
    while part > 0:
        if part in mass.rows:
            effort[mass.rows[part]] = mass.axes[part] @ np.array(wrench)
        part = blueprint.parts[part].parent
    return effort


def _find_friction_ratio(surface: RigidPart) -> float:
    """Find (friction across the axle / friction along it) squared."""
    across, along = surface.contact.friction_across, surface.friction
    if surface.contact.direction == ZERO or along == 0.0:
        return 1.0
    return (across / along) ** 2


def _subtract(left: Vec3, right: Vec3) -> Vec3:
    return (left[0] - right[0], left[1] - right[1], left[2] - right[2])


def _dot(left: Vec3, right: Vec3) -> float:
    return left[0] * right[0] + left[1] * right[1] + left[2] * right[2]
