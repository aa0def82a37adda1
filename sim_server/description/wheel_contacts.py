"""Contact shapes of wheels: what engines use in place of cylinders and round meshes.

A cylinder touches the ground along a line. Engines solve a few contact points of it one after the
other, so that the robot drifts while it turns on the spot, and a caster's edges rub when it
swivels; a free one gains speed in Bullet, as contacts that it has left bear a share of its load. A
sphere of the same radius rolls the same way and touches at one point. A round mesh is a polygon, on
which a robot hops; it becomes a sphere too, or a cylinder if its tread is wider than the diameter.
Where the twist is applied to the body, friction is removed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import ZERO, Joint, Link, Model, Origin, Shape, Vec3
from zensim.proto.rigid_transforms import compose, cross, from_directions, normalize, rotate
from zensim.sim_server.description.model_geometry import (
    NO_MESHES,
    FindCorners,
    find_ground_clearance,
    find_link_poses,
    turns_freely,
)

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from zensim.proto.messages.drive_messages import Drive


ROUND_KINDS = {"cylinder": "cylinders", "mesh": "round meshes"}
HALF = 0.5
MAX_AXLE_OFFSET = 0.01
"""Distance of a wheel cylinder from its axle, in radii."""
MIN_AXLE_COS = 0.9999
"""Cosine of the angle between the cylinder and its axle."""
MAX_LEVEL_AXLE_Z = 0.1
"""Slope of the axle of a wheel on the ground."""
FREE_LEVEL_AXLE_Z = 0.01
"""The same without a drive: a sphere in place of a cambered wheel is lower."""
MAX_WHEEL_WIDTH = 2.0
"""Width in radii; wider cylinders are rollers."""
MIN_WHEEL_WIDTH = 0.1
"""Width in radii of a wheel without a drive; thinner discs are propellers."""
MAX_WHEEL_LIFT = 0.25
"""Height over the lowest point up to which a wheel without a drive is on the ground, in radii."""
MIN_TREAD_SHARE = 0.97
"""Share of the largest radius from which corners of a mesh belong to the tread."""
MAX_TREAD_GAP_RAD = math.radians(30.0) + 1e-3
"""Largest angle between neighbouring corners of a round tread."""


def links_in_contact(model: Model, corners: FindCorners = NO_MESHES) -> tuple[Link, ...]:
    """List the links with the collisions that engines use: spheres for wheels.

    Args:
        model: The robot.
        corners: Needed for wheels with meshes.
    """
    if model.drive is not None and _is_driven_by_twist(model.drive):
        return tuple(_without_friction(link) for link in model.links)
    if not (axles := _find_wheels(model, corners)):
        return model.links
    return tuple(
        _with_round_wheels(link, axles[link.name], corners) if link.name in axles else link
        for link in model.links
    )


def align_friction_to_axle(link: Link, joint: Joint | None) -> Link:
    """Replace friction directions of a link that turns without limits by its axle.

    Only along and across the axle is a direction the same at any angle. Along it is the friction of
    the direction that is nearer to it at joint position zero.
    """
    if joint is None or not turns_freely(joint):
        return link
    if all(shape.contact.direction == ZERO for shape in link.collisions):
        return link
    shapes = tuple(_align_shape_friction(shape, joint.axis) for shape in link.collisions)
    return msgspec.structs.replace(link, collisions=shapes)


def _align_shape_friction(shape: Shape, axle: Vec3) -> Shape:
    contact = shape.contact
    if contact.direction == ZERO:
        return shape
    cosine = _dot(contact.direction, normalize(axle))
    along, across = shape.friction, contact.friction_across
    if cosine * cosine < HALF:
        along, across = across, along
    contact = msgspec.structs.replace(contact, direction=normalize(axle), friction_across=across)
    return msgspec.structs.replace(shape, friction=along, contact=contact)


def describe_contacts(model: Model, corners: FindCorners) -> list[str]:
    """Describe what `links_in_contact` changes."""
    if model.drive is not None and _is_driven_by_twist(model.drive):
        return ["friction of its collisions is not used: the twist is applied to the body"]
    axles = _find_wheels(model, corners)
    found: dict[str, list[str]] = {}
    for link in model.links:
        for shape in link.collisions if link.name in axles else ():
            if (wheel := find_round_wheel(shape, axles[link.name], corners)) is not None:
                what = f"{wheel.kind}s of their largest radius, {wheel.size[0]:.4g} m"
                key = f"{ROUND_KINDS[shape.kind]} of {{}} touch the ground as {what}"
                found.setdefault(key, []).append(repr(link.name))
    return [text.format(", ".join(dict.fromkeys(names))) for text, names in found.items()]


def find_round_wheel(shape: Shape, axle: Joint, corners: FindCorners = NO_MESHES) -> Shape | None:
    """Find the sphere or cylinder that rolls like a wheel's collision; None if it is not round.

    Args:
        shape: Of the child link of `axle`.
        axle: The joint about which the wheel turns.
        corners: Needed for meshes.
    """
    if is_wheel_cylinder(shape, axle):
        return _make_wheel(shape, axle, shape.size[0], 0.0, shape.origin.position)
    if shape.kind != "mesh":
        return None
    import numpy as np

    from zensim.proto.se3 import from_origin, transform_points

    scaled = np.asarray(corners(shape.mesh), np.float64) * np.array(shape.size)
    points = transform_points(from_origin(shape.origin), scaled)
    tread = _find_tread(points, np.array(normalize(axle.axis))) if len(points) else None
    return None if tread is None else _make_wheel(shape, axle, *tread)


def is_wheel_cylinder(shape: Shape, axle: Joint) -> bool:
    """Whether a collision is a cylinder around the axle of its link."""
    radius, length, _ = shape.size
    if shape.kind != "cylinder" or not 0.0 < length <= MAX_WHEEL_WIDTH * radius:
        return False
    axis = normalize(axle.axis)
    along = rotate(shape.origin.orientation, (0.0, 0.0, 1.0))
    if abs(_dot(along, axis)) < MIN_AXLE_COS:
        return False
    return math.hypot(*cross(shape.origin.position, axis)) <= MAX_AXLE_OFFSET * radius


def _dot(first: Vec3, second: Vec3) -> float:
    return sum(a * b for a, b in zip(first, second, strict=True))


def _find_tread(
    points: npt.NDArray[np.float64], axis: npt.NDArray[np.float64]
) -> tuple[float, float, Vec3] | None:
    """Find the largest radius about an axis, the width if it is a roller, and its middle.

    None if the corners that reach that radius leave a gap in the circle, or are few of a wide mesh.
    """
    import numpy as np

    along = points @ axis
    spokes = points - along[:, None] * axis
    radii = np.linalg.norm(spokes, axis=1)
    radius = float(radii.max())
    is_tread = radii >= MIN_TREAD_SHARE * radius
    is_roller = np.ptp(along) >= MAX_WHEEL_WIDTH * radius
    width = float(np.ptp(along[is_tread])) if is_roller else 0.0
    if is_roller and width < MAX_WHEEL_WIDTH * radius:
        return None
    first = spokes[is_tread][0]
    turns = np.arctan2(spokes[is_tread] @ np.cross(axis, first), spokes[is_tread] @ first)
    if np.diff(np.sort(turns), append=turns.min() + math.tau).max() > MAX_TREAD_GAP_RAD:
        return None
    x, y, z = (axis * (along[is_tread].min() + along[is_tread].max()) / 2.0).tolist()
    return radius, width, (x, y, z)


def _make_wheel(shape: Shape, axle: Joint, radius: float, width: float, centre: Vec3) -> Shape:
    up = (0.0, 0.0, 1.0)
    origin = Origin(centre, from_directions(up, normalize(axle.axis) if width else up))
    kind, size = "cylinder" if width else "sphere", (radius, width, 0.0)
    return msgspec.structs.replace(shape, kind=kind, size=size, origin=origin, mesh="")


def _is_driven_by_twist(drive: Drive) -> bool:
    return any(actuator.mode == "twist" for actuator in drive.actuators)


def _find_wheels(model: Model, corners: FindCorners) -> dict[str, Joint]:
    """Find the axle of each wheel, by link: those of the drive, and passive ones on the ground."""
    drive, joints = model.drive, model.joints
    if drive is None:
        return _find_free_wheels(model, corners)
    held = {actuator.joint for actuator in drive.actuators}
    driven = {joint.child: joint for joint in joints if joint.name in drive.wheel_joints}
    passive = {
        joint.child: joint for joint in joints if turns_freely(joint) and joint.name not in held
    }
    if not passive or not driven:
        return driven
    wheels = _find_bottoms(model, passive | driven, corners, MAX_LEVEL_AXLE_Z)
    ground = min((low for name in driven for low, _ in wheels[name]), default=-math.inf)
    return driven | {
        name: joint
        for name, joint in passive.items()
        if any(low - radius <= ground for low, radius in wheels[name])
    }


def _find_free_wheels(model: Model, corners: FindCorners) -> dict[str, Joint]:
    """Find the axles of the wheels of a model without a drive: what is nothing but a wheel."""
    free = {joint.child: joint for joint in model.joints if turns_freely(joint)}
    if model.is_static or not free:
        return {}
    links = {link.name: link for link in model.links}
    rolling = {
        name: joint
        for name, joint in free.items()
        # Spheres of swivel casters would let a robot creep that their edges hold.
        if joint.parent not in free and _is_wheel(links[name], joint, corners)
    }
    wheels = _find_bottoms(model, rolling, corners, FREE_LEVEL_AXLE_Z)
    ground = find_ground_clearance(model, corners=corners) if any(wheels.values()) else 0.0
    return {
        name: rolling[name]
        for name, found in wheels.items()
        if any(low - MAX_WHEEL_LIFT * radius <= ground for low, radius in found)
    }


def _is_wheel(link: Link, axle: Joint, corners: FindCorners) -> bool:
    """Whether all collisions of a link become spheres, and none is a thin disc."""
    wheels = [find_round_wheel(shape, axle, corners) for shape in link.collisions]
    is_thick = all(
        shape.kind == "mesh" or shape.size[1] >= MIN_WHEEL_WIDTH * shape.size[0]
        for shape in link.collisions
    )
    return is_thick and bool(wheels) and all(one and one.kind == "sphere" for one in wheels)


def _find_bottoms(
    model: Model, axles: dict[str, Joint], corners: FindCorners, most: float
) -> dict[str, list[tuple[float, float]]]:
    """Find heights [m] in the root link and radii [m] of round shapes on axles of this slope."""
    poses = find_link_poses(model.links[0].name, model.joints)
    wheels: dict[str, list[tuple[float, float]]] = {name: [] for name in axles}
    for link in model.links:
        pose, axle = poses[link.name], axles.get(link.name)
        if axle and abs(rotate(pose.orientation, normalize(axle.axis))[2]) <= most:
            for shape in link.collisions:
                if (wheel := find_round_wheel(shape, axle, corners)) is not None:
                    radius = wheel.size[0]
                    low = compose(pose, wheel.origin).position[2] - radius
                    wheels[link.name].append((low, radius))
    return wheels


def _with_round_wheels(link: Link, axle: Joint, corners: FindCorners) -> Link:
    found = tuple(find_round_wheel(shape, axle, corners) or shape for shape in link.collisions)
    return msgspec.structs.replace(link, collisions=found)


def _without_friction(link: Link) -> Link:
    return msgspec.structs.replace(link, collisions=tuple(map(_frictionless, link.collisions)))


def _frictionless(shape: Shape) -> Shape:
    contact = msgspec.structs.replace(shape.contact, direction=ZERO, friction_across=0.0)
    return msgspec.structs.replace(shape, friction=0.0, contact=contact)
