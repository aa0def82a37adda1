"""Joints as engines simulate them: fixed joints lumped, planar and floating joints as chains.

Engines and joint states support joints with one degree of freedom. A planar joint becomes `_x` and
`_y` in its plane, then a rotation about the plane's normal; a floating joint becomes `_x`, `_y`,
`_z`, `_yaw`, `_pitch`, then a roll. The last joint of a chain keeps the name.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import copysign, fsum
from operator import mul

import msgspec

from zensim.proto.messages.model_messages import (
    IDENTITY,
    MOVABLE_KINDS,
    ZERO,
    Decay,
    Frame,
    Inertial,
    Joint,
    JointKind,
    Light,
    Link,
    Origin,
    Quat,
    Shape,
    Vec3,
)
from zensim.proto.rigid_transforms import compose, rotate, transform_point
from zensim.sim_server.description.collision_names import name_merged
from zensim.sim_server.description.model_geometry import NO_MESHES, FindCorners
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

MAX_JOINTS = 120
"""Joints after lumping: PyBullet reads the states of at most 127 joints of a body."""
Moments = tuple[float, float, float, float, float, float]
"""Moments of inertia (ixx, ixy, ixz, iyy, iyz, izz) [kg m^2]."""


def check_mimics(joints: Iterable[Joint], report: ParseReport) -> tuple[Joint, ...]:
    """Remove each <mimic> that cannot work; its joint then moves freely.

    Args:
        joints: After lumping.
        report: Gets what is unusual.
    """
    by_name = {joint.name: joint for joint in joints}
    checked = []
    for joint in by_name.values():
        if joint.mimic is None:
            checked.append(joint)
        elif fault := _find_mimic_fault(joint, by_name):
            report.suspicious(f"joint {quote(joint.name)}: <mimic>", f"{fault}; it moves freely")
            checked.append(msgspec.structs.replace(joint, mimic=None))
        else:
            report.applied(f"joint {quote(joint.name)}: <mimic>", f"mimics {joint.mimic.joint!r}")
            checked.append(joint)
    return tuple(checked)


def _find_mimic_fault(joint: Joint, by_name: Mapping[str, Joint]) -> str:
    leader, seen = joint, {joint.name}
    while leader.mimic is not None:
        name = leader.mimic.joint
        if name not in by_name:
            return f"joint {quote(name)} does not exist or is fixed"
        if name in seen:
            return f"joint {quote(name)} would mimic itself"
        seen.add(name)
        leader = by_name[name]
        if leader.kind not in MOVABLE_KINDS:
            return f"joint {quote(name)} is {leader.kind}"
    if joint.kind not in MOVABLE_KINDS:
        return f"a {joint.kind} joint cannot mimic"
    if joint.mimic is not None and joint.mimic.multiplier == 0.0:
        return "its multiplier is 0"
    return ""


class LumpedModel(msgspec.Struct, frozen=True):
    """Moving links, their joints, and the frames of links merged into them; in tree order."""

    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    frames: tuple[Frame, ...]
    corners: FindCorners = NO_MESHES
    """Corners of meshes; none before meshes are converted."""


def reduce_joints(
    links: Sequence[Link],
    joints: Sequence[Joint],
    *,
    kept: frozenset[str] = frozenset(),
    report: ParseReport,
) -> LumpedModel:
    """Lump fixed joints, check mimics and expand joints with several degrees of freedom.

    Args:
        links: In tree order: `joints[i]` moves `links[i + 1]`.
        joints: In tree order.
        kept: Fixed joints to keep.
        report: Gets what is unusual.

    Raises:
        ModelError: More than 120 joints are left.
    """
    lumped = lump_fixed_joints(links, joints, kept)
    mimics = check_mimics(lumped.joints, report)
    lumped = expand_multi_dof_joints(LumpedModel(lumped.links, mimics, lumped.frames), report)
    if len(lumped.joints) > MAX_JOINTS:
        raise ModelError(
            f"{len(lumped.joints)} joints are left after merging fixed ones; "
            f"use at most {MAX_JOINTS}",
            slug="urdf.joints",
        )
    return lumped


def lump_fixed_joints(
    links: Sequence[Link], joints: Sequence[Joint], kept: frozenset[str]
) -> LumpedModel:
    """Merge each link on a fixed joint that is not kept into its nearest moving ancestor."""
    places = {links[0].name: (links[0].name, Origin())}
    groups: dict[str, list[tuple[Link, Origin]]] = {links[0].name: [(links[0], Origin())]}
    moving: list[Joint] = []
    frames: list[Frame] = []
    for joint, link in zip(joints, links[1:], strict=True):
        base, above = places[joint.parent]
        origin = compose(above, joint.origin)
        if joint.kind == "fixed" and joint.name not in kept:
            places[link.name] = (base, origin)
            groups[base].append((link, origin))
            frames.append(Frame(link.name, base, origin))
        else:
            places[link.name] = (link.name, Origin())
            groups[link.name] = [(link, Origin())]
            moving.append(msgspec.structs.replace(joint, parent=base, origin=origin))
    merged = tuple(_merge_links(name, group) for name, group in groups.items())
    return LumpedModel(merged, tuple(moving), tuple(frames))


def combine_inertials(parts: Iterable[tuple[Inertial, Origin]]) -> Inertial:
    """Find the inertial of rigidly connected parts, each with its pose in a common frame.

    Source: parallel axis theorem, I = sum of R I R' + m (d.d E - d d').
    """
    heavy = [(part, origin) for part, origin in parts if part != Inertial()]
    if not heavy:
        return Inertial()
    if len(heavy) == 1 and heavy[0][1] == Origin():
        return heavy[0][0]
    masses = [part.mass_kg for part, _ in heavy]
    centres = [transform_point(origin, part.com_in_link) for part, origin in heavy]
    mass = fsum(masses)
    x, y, z = (
        fsum(map(mul, masses, column)) / mass if mass > 0.0 else 0.0
        for column in zip(*centres, strict=True)
    )
    about_com = [
        part_moments
        for (part, origin), (px, py, pz) in zip(heavy, centres, strict=True)
        for part_moments in (
            rotate_moments(part.inertia, origin.orientation),
            _find_point_moments(part.mass_kg, (px - x, py - y, pz - z)),
        )
    ]
    ixx, ixy, ixz, iyy, iyz, izz = map(fsum, zip(*about_com, strict=True))
    return Inertial(mass, (x, y, z), (ixx, ixy, ixz, iyy, iyz, izz))


def rotate_moments(moments: Moments, orientation: Quat) -> Moments:
    """Express moments of inertia, given in a frame with this orientation, outside of it: R I R'."""
    if orientation == IDENTITY:
        return moments
    ixx, ixy, ixz, iyy, iyz, izz = moments
    turned = [
        rotate(orientation, row) for row in ((ixx, ixy, ixz), (ixy, iyy, iyz), (ixz, iyz, izz))
    ]
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = (
        rotate(orientation, row) for row in zip(*turned, strict=True)
    )
    return (ixx, ixy, ixz, iyy, iyz, izz)


def _find_point_moments(mass_kg: float, place: Vec3) -> Moments:
    """Find the moments of a point mass about the origin: m (d.d E - d d')."""
    x, y, z = place
    return (
        mass_kg * (y * y + z * z),
        -mass_kg * x * y,
        -mass_kg * x * z,
        mass_kg * (x * x + z * z),
        -mass_kg * y * z,
        mass_kg * (x * x + y * y),
    )


def _merge_links(name: str, group: list[tuple[Link, Origin]]) -> Link:
    return Link(
        name=name,
        inertial=combine_inertials((link.inertial, origin) for link, origin in group),
        collisions=tuple(
            shape if link.name == name else _rename_shape(shape, name, link.name)
            for link, origin in group
            for shape in _transform_shapes(link.collisions, origin)
        ),
        visuals=tuple(s for link, origin in group for s in _transform_shapes(link.visuals, origin)),
        weightless=combine_inertials((link.weightless, origin) for link, origin in group),
        decay=_mean_decay([link for link, _ in group]),
        self_collides=any(link.self_collides for link, _ in group),
        lights=tuple(_move_light(light, origin) for link, origin in group for light in link.lights),
    )


def _rename_shape(shape: Shape, parent: str, link: str) -> Shape:
    return msgspec.structs.replace(shape, name=name_merged(parent, link, shape.name))


def _mean_decay(links: Sequence[Link]) -> Decay:
    """Average the decay of merged links, weighted by mass."""
    mass = fsum(link.inertial.mass_kg for link in links)
    if len(links) == 1 or mass == 0.0 or all(link.decay == Decay() for link in links):
        return links[0].decay
    return Decay(
        fsum(link.inertial.mass_kg * link.decay.linear for link in links) / mass,
        fsum(link.inertial.mass_kg * link.decay.angular for link in links) / mass,
    )


def _move_light(light: Light, origin: Origin) -> Light:
    return msgspec.structs.replace(
        light,
        origin=compose(origin, light.origin),
        direction=rotate(origin.orientation, light.direction),
    )


def _transform_shapes(shapes: Iterable[Shape], origin: Origin) -> Iterable[Shape]:
    for shape in shapes:
        contact = shape.contact
        if contact.direction != ZERO:
            along = rotate(origin.orientation, contact.direction)
            contact = msgspec.structs.replace(contact, direction=along)
        yield msgspec.structs.replace(shape, origin=compose(origin, shape.origin), contact=contact)


SLIDE_LIMIT_M = 1e5
"""Limit of sliding joints without a limit: the size of the world."""
X: Vec3 = (1.0, 0.0, 0.0)
Y: Vec3 = (0.0, 1.0, 0.0)
Z: Vec3 = (0.0, 0.0, 1.0)
ChainStep = tuple[str, JointKind, Vec3]


def expand_multi_dof_joints(lumped: LumpedModel, report: ParseReport) -> LumpedModel:
    """Replace each planar and floating joint by a chain; tree order is kept."""
    taken = {link.name for link in lumped.links} | {joint.name for joint in lumped.joints}
    links, joints = [lumped.links[0]], []
    for joint, link in zip(lumped.joints, lumped.links[1:], strict=True):
        steps = _chain_steps(joint)
        if steps:
            report.applied(
                f"joint {quote(joint.name)}", f"{joint.kind}: {len(steps)} joints in a chain"
            )
            chain = _make_chain(joint, steps, taken)
            links += [Link(part.child) for part in chain[:-1]]
            joints += chain
        else:
            joints.append(joint)
        links.append(link)
    return LumpedModel(tuple(links), tuple(joints), lumped.frames)


def _chain_steps(joint: Joint) -> Sequence[ChainStep]:
    if joint.kind == "planar":
        along, across = _plane_axes(joint.axis)
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


def _plane_axes(normal: Vec3) -> tuple[Vec3, Vec3]:
    # Axes x and y, rotated by the shortest rotation from z to the normal.
    nx, ny, nz = normal
    sign = copysign(1.0, nz)
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    return (1.0 + sign * nx * nx * a, sign * b, -sign * nx), (b, sign + ny * ny * a, -ny)


def _make_chain(joint: Joint, steps: Iterable[ChainStep], taken: set[str]) -> list[Joint]:
    chain: list[Joint] = []
    parent, origin = joint.parent, joint.origin
    for suffix, kind, axis in steps:
        reach = SLIDE_LIMIT_M if kind == "prismatic" else 0.0
        child = make_unique_name(joint.child + suffix, taken) if suffix else joint.child
        chain.append(
            msgspec.structs.replace(
                joint,
                name=make_unique_name(joint.name + suffix, taken) if suffix else joint.name,
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


def make_unique_name(name: str, taken: set[str]) -> str:
    """Append underscores to a name until it is not taken, and add it to `taken`."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name
