"""Masses, sizes, inertias and axes must be such as matter can have."""

import math
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Inertial, Joint, Link, Shape, Vec3
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.wording import listed
from zensim.sim_server.errors import ModelError

TURNING_OR_SLIDING = ("revolute", "continuous", "prismatic", "planar")
SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}
"""How many numbers of `Shape.size` must be positive, by kind."""
MOST = 1e12
"""Of a distance [m], mass or moment: far beyond use, and its square still finite."""
ROUNDED = 1e-12
"""Moments [kg m^2] that exporters write below 0 where they mean 0."""
SLACK = 1e-3
"""Share by which rounded moments may break the triangle rule."""


def check_links(links: Sequence[Link], report: Report) -> None:
    """Check mass, inertia and sizes of links that nothing merged yet.

    Raises:
        ModelError: A mass or a moment is negative, a size is not positive, or one is too large.
    """
    for link in links:
        inertial = link.inertial
        _check_most(link.name, (inertial.mass_kg, *inertial.com_in_link, *inertial.inertia))
        _check_inertial(link.name, inertial, report)
        for shape in (*link.collisions, *link.visuals):
            _check_most(link.name, (*shape.size, *shape.origin.position))
            _check_size(link.name, shape)
    without = [link.name for link in links if link.inertial == Inertial()]
    if without:
        report.applied(f"links {listed(without)}", "no <inertial>: they weigh nothing")


def with_unit_axes(joints: Iterable[Joint]) -> tuple[Joint, ...]:
    """Give joints that turn or slide an axis of length one.

    Raises:
        ModelError: An axis is zero, or damping or friction is negative.
    """
    return tuple(_checked(joint) for joint in joints)


def check_moving(links: Iterable[Link], joints: Iterable[Joint], report: Report) -> None:
    """Note what moves oddly once fixed joints are lumped."""
    weights = {link.name: link.inertial.mass_kg for link in links}
    if not any(weights.values()):
        report.suspicious("robot", "nothing has a mass; it will not move")
    for joint in joints:
        if joint.kind != "fixed" and weights[joint.child] == 0.0:
            report.suspicious(f"link {joint.child!r}", "moves by a joint but weighs nothing")
        if joint.kind in ("revolute", "prismatic") and joint.lower > joint.upper:
            report.suspicious(
                f"joint {joint.name!r}", f"lower {joint.lower:g} is above upper {joint.upper:g}"
            )


def _check_most(name: str, numbers: Iterable[float]) -> None:
    largest = max(map(abs, numbers))
    if largest > MOST:
        raise ModelError(
            f"{name!r} has a size, distance or mass of {largest:g}; at most {MOST:g} is simulated",
            slug="urdf.number",
        )


def _check_inertial(link: str, inertial: Inertial, report: Report) -> None:
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    if inertial.mass_kg < 0.0 or min(ixx, iyy, izz) < -ROUNDED:
        raise ModelError(
            f"link {link!r} has mass {inertial.mass_kg:g} kg and moments "
            f"{ixx:g}, {iyy:g}, {izz:g}; none may be negative",
            slug="urdf.mass",
        )
    if inertial.mass_kg == 0.0:
        return
    least, middle, most = np.linalg.eigvalsh(
        [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]
    ).tolist()
    if most <= ROUNDED:
        report.suspicious(f"link {link!r}", "has a mass but no inertia")
    elif least < -SLACK * most or least + middle < (1.0 - SLACK) * most:
        report.suspicious(
            f"link {link!r}",
            f"no solid has the moments {least:.3g}, {middle:.3g}, {most:.3g}; used as written",
        )


def _check_size(link: str, shape: Shape) -> None:
    count = SIZES.get(shape.kind, 0)
    if shape.kind == "mesh" and 0.0 in shape.size:
        raise ModelError(
            f"mesh {shape.mesh!r} of link {link!r} has scale 0; write a scale such as 1 1 1",
            slug="urdf.size",
        )
    if any(size <= 0.0 for size in shape.size[:count]):
        raise ModelError(
            f"{shape.kind} of link {link!r} has size {shape.size[:count]}; sizes must be > 0",
            slug="urdf.size",
        )


def _checked(joint: Joint) -> Joint:
    mimic = (joint.mimic.multiplier, joint.mimic.offset) if joint.mimic else ()
    _check_most(joint.name, (*joint.origin.position, *mimic))
    if joint.damping < 0.0 or joint.friction < 0.0:
        raise ModelError(
            f"joint {joint.name!r} has damping {joint.damping:g} and friction {joint.friction:g}; "
            "neither may be negative",
            slug="urdf.dynamics",
        )
    if joint.kind not in TURNING_OR_SLIDING:
        return joint
    return msgspec.structs.replace(joint, axis=_unit(joint))


def _unit(joint: Joint) -> Vec3:
    length = math.hypot(*joint.axis)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"joint {joint.name!r} has axis {joint.axis}; write a direction such as 0 1 0",
            slug="urdf.axis",
        )
    x, y, z = joint.axis
    return (x / length, y / length, z / length)
