"""Elements and attributes of URDF, and the count of numbers in each attribute."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.description.strict_parsing import read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport

NumberCounts = tuple[int, ...]
TEXT: NumberCounts = ()
ONE: NumberCounts = (1,)
THREE: NumberCounts = (3,)
MAX_TEXT_LENGTH = 256


class UrdfElementRule(msgspec.Struct, frozen=True):
    """Attributes and children of one element."""

    attributes: dict[str, NumberCounts] = {}
    """Allowed counts of numbers by name; `TEXT` for text."""
    required: tuple[str, ...] = ()
    """Attributes that must not be missing or empty."""
    children: dict[str, UrdfElementRule] = {}
    needed: tuple[str, ...] = ()
    """Children that must not be missing."""
    many: tuple[str, ...] = ()
    """Children that may be repeated."""
    unread: str = ""
    """Reason why the element has no effect; empty when it has one."""
    is_opaque: bool = False
    """Its contents are not checked here."""


ORIGIN = UrdfElementRule(attributes={"xyz": THREE, "rpy": THREE})
COLOUR = UrdfElementRule(attributes={"rgba": (3, 4)})
TEXTURE = UrdfElementRule(attributes={"filename": TEXT}, unread="textures are not drawn")
MATERIAL = UrdfElementRule(
    attributes={"name": TEXT}, children={"color": COLOUR, "texture": TEXTURE}
)
GEOMETRY = UrdfElementRule(
    children={
        "box": UrdfElementRule(attributes={"size": THREE}, required=("size",)),
        "sphere": UrdfElementRule(attributes={"radius": ONE}, required=("radius",)),
        "cylinder": UrdfElementRule(
            attributes={"radius": ONE, "length": ONE}, required=("radius", "length")
        ),
        "capsule": UrdfElementRule(
            attributes={"radius": ONE, "length": ONE}, required=("radius", "length")
        ),
        "mesh": UrdfElementRule(
            attributes={"filename": TEXT, "scale": (1, 3)}, required=("filename",)
        ),
    }
)
COLLISION = UrdfElementRule(
    attributes={"name": TEXT},
    children={"origin": ORIGIN, "geometry": GEOMETRY},
    needed=("geometry",),
)
VISUAL = msgspec.structs.replace(COLLISION, children={**COLLISION.children, "material": MATERIAL})
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
INERTIAL = UrdfElementRule(
    children={
        "origin": ORIGIN,
        "mass": UrdfElementRule(attributes={"value": ONE}, required=("value",)),
        "inertia": UrdfElementRule(
            attributes=dict.fromkeys(MOMENTS, ONE), required=("ixx", "iyy", "izz")
        ),
    },
    needed=("mass", "inertia"),
)
LINK = UrdfElementRule(
    attributes={"name": TEXT},
    required=("name",),
    children={
        "inertial": INERTIAL,
        "visual": VISUAL,
        "collision": COLLISION,
        "contact": UrdfElementRule(
            is_opaque=True, unread="Bullet only; set friction by <mu1> in <gazebo>"
        ),
    },
    many=("visual", "collision"),
)
JOINT_END = UrdfElementRule(attributes={"link": TEXT}, required=("link",))
JOINT = UrdfElementRule(
    attributes={"name": TEXT, "type": TEXT},
    required=("name", "type"),
    children={
        "origin": ORIGIN,
        "parent": JOINT_END,
        "child": JOINT_END,
        "axis": UrdfElementRule(attributes={"xyz": THREE}),
        "limit": UrdfElementRule(
            attributes=dict.fromkeys(("lower", "upper", "effort", "velocity"), ONE)
        ),
        "dynamics": UrdfElementRule(attributes={"damping": ONE, "friction": ONE}),
        "mimic": UrdfElementRule(
            attributes={"joint": TEXT, "multiplier": ONE, "offset": ONE},
            required=("joint",),
        ),
        "calibration": UrdfElementRule(
            attributes=dict.fromkeys(("rising", "falling", "reference_position"), ONE),
            unread="real encoders only",
        ),
        "safety_controller": UrdfElementRule(
            attributes=dict.fromkeys(
                ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), ONE
            ),
            unread="real controllers only",
        ),
    },
    needed=("parent", "child"),
)
ROBOT = UrdfElementRule(
    attributes={"name": TEXT, "version": TEXT},
    required=("name",),
    children={
        "link": LINK,
        "joint": JOINT,
        "material": msgspec.structs.replace(MATERIAL, required=("name",)),
        "gazebo": UrdfElementRule(is_opaque=True),
        "transmission": UrdfElementRule(is_opaque=True, unread="ros_control is not used"),
        "ros2_control": UrdfElementRule(is_opaque=True, unread="ros2_control is not used"),
        "sensor": UrdfElementRule(is_opaque=True, unread="no simulator reads it outside <gazebo>"),
    },
    many=("link", "joint", "material", "gazebo", "transmission", "ros2_control", "sensor"),
)


def check_urdf_schema(robot: Element, report: ParseReport) -> None:
    """Check all tags and attributes outside <gazebo>; tags without effect are reported.

    Raises:
        ModelError: A required tag or attribute is missing, or a value is not a number.
    """
    _check_element(robot, ROBOT, "robot", report)


def _check_element(element: Element, tag: UrdfElementRule, where: str, report: ParseReport) -> None:
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
            report.suspicious(
                _describe_place(where, child), "given more than once; the first is used"
            )
        seen.add(child.tag)
    for needed in tag.needed:
        if needed not in seen:
            raise ModelError(f"{where} has no <{needed}>; add one", slug=f"urdf.{needed}")


def _check_child(child: Element, tag: UrdfElementRule, where: str, report: ParseReport) -> None:
    if child.tag in tag.children:
        _check_element(child, tag.children[child.tag], _describe_place(where, child), report)
    else:
        report.unread_tag(where, child.tag, tag.children)


def _check_attributes(
    element: Element, tag: UrdfElementRule, where: str, report: ParseReport
) -> None:
    for name, value in element.attrib.items():
        if name not in tag.attributes:
            report.unknown(f"{where}: attribute {name[:80]}", "not read")
        elif counts := tag.attributes[name]:
            read_numbers(value, counts=counts, where=f"{where}, {name}", slug="urdf.number")
        elif len(value) > MAX_TEXT_LENGTH or not value.isprintable():
            raise ModelError(
                f"{where}, {name}: {value[:40]!r}... cannot be used; "
                f"write at most {MAX_TEXT_LENGTH} printable characters",
                slug="urdf.text",
            )
    for name in tag.required:
        if not (element.get(name) or "").strip():
            raise ModelError(f'{where} has no {name}; write {name}="..."', slug=f"urdf.{name}")


def _check_geometry(geometry: Element, where: str, report: ParseReport) -> None:
    shapes = [child.tag for child in geometry]
    if not shapes or shapes[0] not in GEOMETRY.children:
        content = f"<{shapes[0][:80]}>" if shapes else "nothing"
        raise ModelError(
            f"{where} contains {content}; write one of {', '.join(GEOMETRY.children)}",
            slug="urdf.geometry",
        )
    if len(shapes) > 1:
        report.suspicious(where, f"{len(shapes)} shapes; the first is used")


def _describe_place(where: str, child: Element) -> str:
    if where != "robot":
        return f"{where}, {child.tag}"
    name = child.get("name")
    return f"{child.tag} {name[:80]!r}" if name else f"{child.tag} at line {child.sourceline}"
