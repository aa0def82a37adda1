"""Which tags and attributes a URDF may hold, and how many numbers in each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.description.decimals import read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import Report

Counts = tuple[int, ...]
TEXT: Counts = ()
ONE: Counts = (1,)
THREE: Counts = (3,)
MAX_TEXT = 256


class Tag(msgspec.Struct, frozen=True):
    """What one element may hold."""

    attributes: dict[str, Counts] = {}
    """By name: how many numbers; `TEXT` for text."""
    required: tuple[str, ...] = ()
    """Attributes that must be there and not be empty."""
    children: dict[str, Tag] = {}
    needed: tuple[str, ...] = ()
    """Children that must be there."""
    many: tuple[str, ...] = ()
    """Children that may be there more than once."""
    unread: str = ""
    """Why the element has no effect; empty when it has."""
    is_opaque: bool = False
    """Its contents are checked elsewhere or never looked at."""


ORIGIN = Tag(attributes={"xyz": THREE, "rpy": THREE})
COLOUR = Tag(attributes={"rgba": (3, 4)})
TEXTURE = Tag(attributes={"filename": TEXT}, unread="textures are not drawn")
MATERIAL = Tag(attributes={"name": TEXT}, children={"color": COLOUR, "texture": TEXTURE})
GEOMETRY = Tag(
    children={
        "box": Tag(attributes={"size": THREE}, required=("size",)),
        "sphere": Tag(attributes={"radius": ONE}, required=("radius",)),
        "cylinder": Tag(attributes={"radius": ONE, "length": ONE}, required=("radius", "length")),
        "capsule": Tag(attributes={"radius": ONE, "length": ONE}, required=("radius", "length")),
        "mesh": Tag(attributes={"filename": TEXT, "scale": (1, 3)}, required=("filename",)),
    }
)
COLLISION = Tag(
    attributes={"name": TEXT},
    children={"origin": ORIGIN, "geometry": GEOMETRY},
    needed=("geometry",),
)
VISUAL = msgspec.structs.replace(COLLISION, children={**COLLISION.children, "material": MATERIAL})
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
INERTIAL = Tag(
    children={
        "origin": ORIGIN,
        "mass": Tag(attributes={"value": ONE}, required=("value",)),
        "inertia": Tag(attributes=dict.fromkeys(MOMENTS, ONE), required=("ixx", "iyy", "izz")),
    },
    needed=("mass", "inertia"),
)
LINK = Tag(
    attributes={"name": TEXT},
    required=("name",),
    children={
        "inertial": INERTIAL,
        "visual": VISUAL,
        "collision": COLLISION,
        "contact": Tag(is_opaque=True, unread="of Bullet; friction is set by <mu1> in <gazebo>"),
    },
    many=("visual", "collision"),
)
END = Tag(attributes={"link": TEXT}, required=("link",))
JOINT = Tag(
    attributes={"name": TEXT, "type": TEXT},
    required=("name", "type"),
    children={
        "origin": ORIGIN,
        "parent": END,
        "child": END,
        "axis": Tag(attributes={"xyz": THREE}),
        "limit": Tag(attributes=dict.fromkeys(("lower", "upper", "effort", "velocity"), ONE)),
        "dynamics": Tag(attributes={"damping": ONE, "friction": ONE}),
        "mimic": Tag(
            attributes={"joint": TEXT, "multiplier": ONE, "offset": ONE},
            required=("joint",),
        ),
        "calibration": Tag(
            attributes=dict.fromkeys(("rising", "falling", "reference_position"), ONE),
            unread="for real encoders only",
        ),
        "safety_controller": Tag(
            attributes=dict.fromkeys(
                ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), ONE
            ),
            unread="for real controllers only",
        ),
    },
    needed=("parent", "child"),
)
ROBOT = Tag(
    attributes={"name": TEXT, "version": TEXT},
    required=("name",),
    children={
        "link": LINK,
        "joint": JOINT,
        "material": msgspec.structs.replace(MATERIAL, required=("name",)),
        "gazebo": Tag(is_opaque=True),
        "transmission": Tag(is_opaque=True, unread="of ros_control, which is not used here"),
        "ros2_control": Tag(is_opaque=True, unread="of ros2_control, which is not used here"),
        "sensor": Tag(is_opaque=True, unread="outside <gazebo>, no simulator reads it"),
    },
    many=("link", "joint", "material", "gazebo", "transmission", "ros2_control", "sensor"),
)


def check_grammar(robot: Element, report: Report) -> None:
    """Check every tag and attribute of a <robot>, <gazebo> blocks apart; note what has no effect.

    Raises:
        ModelError: Something needed is missing, or a number is none.
    """
    _check(robot, ROBOT, "robot", report)


def _check(element: Element, tag: Tag, where: str, report: Report) -> None:
    if tag.unread:
        report.ignored(where, tag.unread)
    if tag.is_opaque:
        return
    _check_attributes(element, tag, where, report)
    if tag is GEOMETRY:
        _check_geometry(element, where, report)
    seen: set[str] = set()
    for child in element:
        _check_child(child, tag, where, report)
        if child.tag in seen and child.tag in tag.children and child.tag not in tag.many:
            report.suspicious(_where(where, child), "given more than once; the first counts")
        seen.add(child.tag)
    for needed in tag.needed:
        if needed not in seen:
            raise ModelError(f"{where} has no <{needed}>; add one", slug=f"urdf.{needed}")


def _check_child(child: Element, tag: Tag, where: str, report: Report) -> None:
    if child.tag in tag.children:
        _check(child, tag.children[child.tag], _where(where, child), report)
    else:
        report.unread_tag(where, child.tag, tag.children)


def _check_attributes(element: Element, tag: Tag, where: str, report: Report) -> None:
    for name, value in element.attrib.items():
        if name not in tag.attributes:
            report.unknown(f"{where}: attribute {name[:80]}", "not read")
        elif counts := tag.attributes[name]:
            read_numbers(value, counts=counts, where=f"{where}, {name}", slug="urdf.number")
        elif len(value) > MAX_TEXT or not value.isprintable():
            raise ModelError(
                f"{where}, {name}: {value[:40]!r}... cannot be used; "
                f"write at most {MAX_TEXT} printable characters",
                slug="urdf.text",
            )
    for name in tag.required:
        if not (element.get(name) or "").strip():
            raise ModelError(f'{where} has no {name}; write {name}="..."', slug=f"urdf.{name}")


def _check_geometry(geometry: Element, where: str, report: Report) -> None:
    shapes = [child.tag for child in geometry]
    if not shapes or shapes[0] not in GEOMETRY.children:
        held = f"<{shapes[0][:80]}>" if shapes else "nothing"
        raise ModelError(
            f"{where} holds {held}; write one of {', '.join(GEOMETRY.children)}",
            slug="urdf.geometry",
        )
    if len(shapes) > 1:
        report.suspicious(where, f"{len(shapes)} shapes; the first counts")


def _where(where: str, child: Element) -> str:
    if where != "robot":
        return f"{where}, {child.tag}"
    name = child.get("name")
    return f"{child.tag} {name[:80]!r}" if name else f"{child.tag} at line {child.sourceline}"
