"""Links and joints of a parsed description: ordered as one tree, values checked."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import LIMITED_KINDS, Inertial, Joint, Link, Shape, Vec3
from zensim.sim_server.description.strict_parsing import quote_names
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from zensim.sim_server.description.report import ParseReport


class ParsedModel(msgspec.Struct, frozen=True):
    """Links and joints of a description, in its order."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]


MAX_LINKS = 500
WORLD_LINK = "world"
MODEL_FRAME = "__model__"
"""Frame of an SDF model; also a link where the model's first link is elsewhere."""


def order_as_tree(parts: ParsedModel) -> ParsedModel:
    """Order links and joints depth first, so that `joints[i]` moves `links[i + 1]`.

    Raises:
        ModelError: Repeated names, unknown links, two parents, two roots, or a cycle.
    """
    _check_names(parts)
    by_name = {link.name: link for link in parts.links}
    _check_ends(parts.joints, by_name)
    _check_single_parents(parts.joints)
    root = _find_root(parts)
    joints = _depth_first(root, parts.joints)
    if len(joints) < len(parts.joints):
        reached = {root, *(joint.child for joint in joints)}
        unreached = [link.name for link in parts.links if link.name not in reached]
        raise ModelError(
            f"links {quote_names(unreached)} are in a cycle; connect each link to root {root!r}",
            slug="urdf.cycle",
        )
    links = (by_name[root], *(by_name[joint.child] for joint in joints))
    return ParsedModel(parts.name, links, tuple(joints))


def drop_floating_world(parts: ParsedModel, report: ParseReport) -> ParsedModel:
    """Drop a root link `world` whose only joint is floating: the robot is free without it."""
    if parts.links[0].name != WORLD_LINK or [
        j.kind for j in parts.joints if j.parent == WORLD_LINK
    ] != ["floating"]:
        return parts
    report.applied(f"joint {parts.joints[0].name!r}", "floating in the world: the robot is free")
    return ParsedModel(parts.name, parts.links[1:], parts.joints[1:])


def is_fixed_to_world(parts: ParsedModel, report: ParseReport) -> bool:
    """Whether the root link is `world`, which Gazebo fixes to the world."""
    if parts.links[0].name != WORLD_LINK or len(parts.links) == 1:
        return False
    report.applied(f"link {WORLD_LINK!r}", "the robot is fixed to the world")
    return True


def _check_names(parts: ParsedModel) -> None:
    if not parts.links:
        raise ModelError("the robot has no links; add at least one", slug="urdf.no_links")
    if len(parts.links) > MAX_LINKS:
        raise ModelError(
            f"the robot has {len(parts.links)} links; use at most {MAX_LINKS}", slug="urdf.size"
        )
    for what, names in (
        ("link", [link.name for link in parts.links]),
        ("joint", [joint.name for joint in parts.joints]),
    ):
        repeated = find_repeated(names)
        if repeated:
            raise ModelError(
                f"{what} names {quote_names(repeated)} are used more than once; make them unique",
                slug=f"urdf.duplicate_{what}",
            )


def _check_ends(joints: Iterable[Joint], links: dict[str, Link]) -> None:
    for joint in joints:
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise ModelError(
                    f"joint {joint.name!r} has {end} {name!r}, which is not a link of the robot",
                    slug=f"urdf.unknown_{end}",
                )
        if joint.parent == joint.child:
            raise ModelError(
                f"joint {joint.name!r} connects link {joint.child!r} to itself", slug="urdf.cycle"
            )


def _check_single_parents(joints: Iterable[Joint]) -> None:
    repeated = find_repeated([joint.child for joint in joints])
    if repeated:
        raise ModelError(
            f"links {quote_names(repeated)} are the child of several joints; use one joint each",
            slug="urdf.two_parents",
        )


def _find_root(parts: ParsedModel) -> str:
    children = {joint.child for joint in parts.joints}
    roots = [link.name for link in parts.links if link.name not in children]
    if not roots:
        raise ModelError("the joints form a cycle; one link must not be a child", slug="urdf.cycle")
    if len(roots) > 1:
        raise ModelError(
            f"links {quote_names(roots)} are all roots; connect them so that one is left",
            slug="urdf.two_roots",
        )
    return roots[0]


def _depth_first(root: str, joints: Sequence[Joint]) -> list[Joint]:
    children: dict[str, list[Joint]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint)
    ordered: list[Joint] = []
    pending = children.get(root, [])[::-1]
    while pending:
        joint = pending.pop()
        ordered.append(joint)
        pending.extend(children.get(joint.child, [])[::-1])
    return ordered


def find_repeated(names: Iterable[str]) -> list[str]:
    """Find the names that occur more than once, in order."""
    return [name for name, count in Counter(names).items() if count > 1]


AXIS_KINDS = ("revolute", "continuous", "prismatic", "planar")
SIZE_COUNTS = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "mesh": 3}
"""Count of numbers in `Shape.size`, by kind; positive, or not 0 for a mesh."""
MAX_QUANTITY = 1e12
"""Bound of a distance [m], mass or moment: the square is still finite."""
MOMENT_ROUNDING = 1e-12
"""Exporters round moments of 0 [kg m^2] to this much below 0."""
TRIANGLE_RULE_SLACK = 1e-3
"""Share by which rounded moments may violate the triangle inequality."""


def has_no_extent(shape: Shape) -> bool:
    """Whether a size of a shape is 0, so that it has no volume."""
    return 0.0 in shape.size[: SIZE_COUNTS.get(shape.kind, 0)]


def check_links(links: Sequence[Link], report: ParseReport) -> tuple[Link, ...]:
    """Check mass, inertia and sizes of links before lumping.

    Moments that no body can have become the nearest possible ones.

    Raises:
        ModelError: A mass is negative, a size is not positive, or one is too large.
    """
    return tuple(_check_link(link, report) for link in _report_massless(links, report))


def _report_massless(links: Sequence[Link], report: ParseReport) -> Sequence[Link]:
    without = [link.name for link in links if link.inertial == Inertial()]
    if without:
        report.applied(f"links {quote_names(without)}", "no <inertial>: massless")
    return links


def _check_link(link: Link, report: ParseReport) -> Link:
    inertial = link.inertial
    check_magnitude(link.name, (inertial.mass_kg, *inertial.com_in_link, *inertial.inertia))
    for shape in (*link.collisions, *link.visuals):
        check_magnitude(link.name, (*shape.size, *shape.origin.position))
        _check_size(link.name, shape)
    return msgspec.structs.replace(link, inertial=_check_inertial(link.name, inertial, report))


def normalize_axes(joints: Iterable[Joint], report: ParseReport) -> tuple[Joint, ...]:
    """Scale the axes of joints to length one; negative damping and friction are left out.

    Raises:
        ModelError: An axis is zero.
    """
    return tuple(_check_joint(joint, report) for joint in joints)


def check_moving_parts(links: Iterable[Link], joints: Iterable[Joint], report: ParseReport) -> None:
    """Report massless moving links and reversed limits after lumping."""
    weights = {link.name: link.inertial.mass_kg for link in links}
    if not any(weights.values()):
        report.suspicious("robot", "no link has a mass; it will not move")
    for joint in joints:
        if joint.kind != "fixed" and weights[joint.child] == 0.0:
            report.suspicious(f"link {joint.child!r}", "on a moving joint but massless")
        if joint.kind in LIMITED_KINDS and joint.lower > joint.upper:
            report.suspicious(
                f"joint {joint.name!r}", f"lower {joint.lower:g} is above upper {joint.upper:g}"
            )


def check_magnitude(name: str, numbers: Iterable[float]) -> None:
    """Check that no number of a link or joint is so large that its square overflows.

    Raises:
        ModelError: One is.
    """
    largest = max(map(abs, numbers))
    if largest > MAX_QUANTITY:
        raise ModelError(
            f"{name!r} has a size, distance or mass of {largest:g}; use at most {MAX_QUANTITY:g}",
            slug="urdf.number",
        )


def _check_inertial(link: str, inertial: Inertial, report: ParseReport) -> Inertial:
    if inertial.mass_kg < 0.0:
        raise ModelError(
            f"link {link!r} has mass {inertial.mass_kg:g} kg; use a value >= 0", slug="urdf.mass"
        )
    least, middle, most = find_principal_moments(inertial.inertia)
    if has_no_moments(inertial):
        if inertial.mass_kg > 0.0:
            report.suspicious(f"link {link!r}", "has a mass but no inertia")
        return inertial
    is_negative = least < -max(TRIANGLE_RULE_SLACK * most, MOMENT_ROUNDING)
    if not is_negative and least + middle >= (1.0 - TRIANGLE_RULE_SLACK) * most:
        return inertial
    # It needs numpy, and few robots need it.
    from zensim.sim_server.description.body_moments import describe_moments, find_nearest_moments

    nearest = find_nearest_moments(inertial.inertia)
    fault = "are negative" if is_negative else "violate the triangle inequality"
    report.suspicious(
        f"link {link!r}",
        f"moments {least:.3g}, {middle:.3g}, {most:.3g} {fault}: no body has them; "
        f"the nearest possible ones are used: {describe_moments(nearest)}",
    )
    return msgspec.structs.replace(inertial, inertia=nearest)


def has_no_moments(inertial: Inertial) -> bool:
    """Whether all moments of inertia are zero, as no body of some size has them."""
    return max(map(abs, inertial.inertia)) <= MOMENT_ROUNDING


def find_principal_moments(
    inertia: tuple[float, float, float, float, float, float],
) -> tuple[float, float, float]:
    """Find the principal moments [kg m^2], ascending, of (ixx, ixy, ixz, iyy, iyz, izz).

    Source: the roots of a cubic with three real roots by cosines; to about 1e-8 of the largest.
    """
    ixx, ixy, ixz, iyy, iyz, izz = inertia
    mean = (ixx + iyy + izz) / 3.0
    xx, yy, zz = ixx - mean, iyy - mean, izz - mean
    spread = math.sqrt(
        (xx * xx + yy * yy + zz * zz + 2.0 * (ixy * ixy + ixz * ixz + iyz * iyz)) / 6.0
    )
    if spread == 0.0 or not (ixy or ixz or iyz):
        least, middle, most = sorted((ixx, iyy, izz))
        return least, middle, most
    determinant = (
        xx * (yy * zz - iyz * iyz) - ixy * (ixy * zz - iyz * ixz) + ixz * (ixy * iyz - yy * ixz)
    )
    half_cosine = determinant / spread**3 / 2.0
    angle = math.acos(max(-1.0, min(1.0, half_cosine))) / 3.0
    most = mean + 2.0 * spread * math.cos(angle)
    least = mean + 2.0 * spread * math.cos(angle + math.tau / 3.0)
    return least, 3.0 * mean - most - least, most


def _check_size(link: str, shape: Shape) -> None:
    if shape.kind == "mesh":
        if 0.0 not in shape.size:
            return
        raise ModelError(
            f"mesh {shape.mesh!r} of link {link!r} has scale 0; write a scale such as 1 1 1",
            slug="urdf.size",
        )
    count = SIZE_COUNTS.get(shape.kind, 0)
    if any(size <= 0.0 for size in shape.size[:count]):
        raise ModelError(
            f"{shape.kind} of link {link!r} has size {shape.size[:count]}; use sizes > 0",
            slug="urdf.size",
        )


def _check_joint(joint: Joint, report: ParseReport) -> Joint:
    mimic = (joint.mimic.multiplier, joint.mimic.offset) if joint.mimic else ()
    check_magnitude(joint.name, (*joint.origin.position, *mimic))
    if joint.damping < 0.0 or joint.friction < 0.0:
        fault = (
            f"damping {joint.damping:g}, friction {joint.friction:g}: negative ones are left out"
        )
        report.suspicious(f"joint {joint.name!r}", fault)
        joint = msgspec.structs.replace(
            joint, damping=max(joint.damping, 0.0), friction=max(joint.friction, 0.0)
        )
    if joint.kind not in AXIS_KINDS:
        return joint
    return msgspec.structs.replace(joint, axis=_normalize_axis(joint))


def _normalize_axis(joint: Joint) -> Vec3:
    length = math.hypot(*joint.axis)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"joint {joint.name!r} has axis {joint.axis}; write a direction such as 0 1 0",
            slug="urdf.axis",
        )
    x, y, z = joint.axis
    return (x / length, y / length, z / length)
