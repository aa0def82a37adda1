"""URDF text to Model: links, joints and shapes, then tree, lumping and plug-ins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, get_args

import msgspec

from zensim.proto.messages.model_messages import (
    Inertial,
    Joint,
    JointKind,
    Link,
    Mimic,
    Model,
    Origin,
    Shape,
    Vec3,
)
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.joint_reduction import (
    LumpedModel,
    reduce_joints,
    rotate_moments,
)
from zensim.sim_server.description.link_surfaces import SURFACE_TAG_NAMES as SURFACE_TAGS
from zensim.sim_server.description.link_surfaces import (
    SurfaceParameters,
    SurfaceTagReader,
    find_gazebo_colour,
    read_named_colours,
    read_visual_colour,
)
from zensim.sim_server.description.meshes.generated_solids import make_cone, make_ellipsoid
from zensim.sim_server.description.meshes.mesh_lookup import HasMesh, MeshPolicy, no_meshes
from zensim.sim_server.description.model_geometry import make_origin
from zensim.sim_server.description.parsed_model import (
    ParsedModel,
    check_links,
    check_magnitude,
    check_moving_parts,
    drop_floating_world,
    is_fixed_to_world,
    normalize_axes,
    order_as_tree,
)
from zensim.sim_server.description.plugins.control_interfaces import read_command_interfaces
from zensim.sim_server.description.plugins.plugin_registry import make_model
from zensim.sim_server.description.plugins.sensor_tags import SensorElement
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.strict_parsing import (
    parse_flag,
    parse_xml,
    quote,
    read_number,
    read_numbers,
)
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat

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
        "ellipsoid": UrdfElementRule(attributes={"radii": THREE}, required=("radii",)),
        "cone": UrdfElementRule(
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
        "transmission": UrdfElementRule(is_opaque=True),
        "ros2_control": UrdfElementRule(is_opaque=True),
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


_NO_EFFECT = "Gazebo tag without effect"
KEEP_JOINT_TAGS = ("preserveFixedJoint", "disableFixedJointLumping")
LINK_TAGS = (*SURFACE_TAGS, "material", "sensor")
UNUSED_LINK_TAGS = dict.fromkeys(("laserRetro", "maxContacts", "max_contacts"), _NO_EFFECT)
UNUSED_JOINT_TAGS = dict.fromkeys(
    (
        "cfmDamping", "dampingFactor", "erp", "fudgeFactor", "initial_joint_position",
        "provideFeedback", "stopCfm", "stopErp",
    ),
    _NO_EFFECT,
) | {"implicitSpringDamper": "the engine chooses how it integrates springs"}  # fmt: skip
SPRING_TAGS = ("springStiffness", "springReference")
SPRING_KINDS = ("revolute", "continuous", "prismatic")
MODEL_TAGS = ("plugin", "static", "self_collide")
UNUSED_MODEL_TAGS = {
    "allow_auto_disable": _NO_EFFECT,
    "enable_wind": _NO_EFFECT,
    "pose": "the pose is set by the spawn request",
}


@dataclass
class GazeboExtensions:
    """Contents of the <gazebo> blocks.

    Attributes:
        surface_texts: Texts of surface tags, by link.
        surfaces: The same, read.
        colours: By link; they override the colours of URDF materials, as in Gazebo.
        kept_joints: Fixed joints that are not lumped.
        spring_texts: Texts of spring tags, by joint.
        springs: Stiffness and reference, by joint.
        plugins: Of the model.
        sensors: Of links.
        is_static: The robot does not move.
        self_collides: All links collide with each other.
    """

    surface_texts: dict[str, dict[str, str]] = field(default_factory=dict)
    surfaces: dict[str, SurfaceParameters] = field(default_factory=dict)
    colours: dict[str, Quat] = field(default_factory=dict)
    kept_joints: set[str] = field(default_factory=set)
    spring_texts: dict[str, dict[str, str]] = field(default_factory=dict)
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    plugins: list[Element] = field(default_factory=list)
    sensors: list[SensorElement] = field(default_factory=list)
    is_static: bool = False
    self_collides: bool = False


def read_gazebo_extensions(
    robot: Element, parts: ParsedModel, report: ParseReport
) -> GazeboExtensions:
    """Read all <gazebo> blocks; the last of equal tags is used.

    Raises:
        ModelError: A friction is not a number >= 0.
    """
    blocks = GazeboExtensions()
    links = {link.name for link in parts.links}
    joints = {joint.name for joint in parts.joints}
    for block in robot.findall("gazebo"):
        reference = block.get("reference")
        if reference is None:
            for child in block:
                _read_model_tag(child, blocks, report)
        elif reference in links:
            for child in block:
                _read_link_tag(reference, child, blocks, report)
        elif reference in joints:
            for child in block:
                _read_joint_tag(reference, child, blocks, report)
        else:
            report.suspicious(
                f"gazebo {reference[:80]!r}", "no link or joint has this name; block not read"
            )
    _read_collected_texts(parts, blocks, report)
    return blocks


def _read_collected_texts(
    parts: ParsedModel, blocks: GazeboExtensions, report: ParseReport
) -> None:
    for link, texts in blocks.surface_texts.items():
        tags = SurfaceTagReader(texts, subject=f"gazebo {link!r}", slug="gazebo.mu1", report=report)
        blocks.surfaces[link] = tags.read()
    for joint in parts.joints:
        if written := blocks.spring_texts.get(joint.name):
            blocks.springs[joint.name] = _read_spring(joint, written, report)


def _read_spring(joint: Joint, texts: dict[str, str], report: ParseReport) -> tuple[float, float]:
    subject = f"gazebo {joint.name!r}: <{SPRING_TAGS[0]}>"
    if joint.kind not in SPRING_KINDS:
        report.ignored(subject, f"a {joint.kind} joint has no spring")
        return 0.0, 0.0
    try:
        stiffness, reference = (
            read_number(texts.get(tag, "0"), where=tag, slug="urdf.number") for tag in SPRING_TAGS
        )
        check_magnitude(joint.name, (stiffness, reference))
    except ModelError as error:
        report.suspicious(subject, f"{error.message}; no spring")
        return 0.0, 0.0
    if stiffness < 0.0:
        report.suspicious(subject, f"{stiffness:g} is negative; no spring")
    elif stiffness == 0.0:
        report.ignored(subject, "0 or missing: no spring")
    else:
        what = "N/m to {:g} m" if joint.kind == "prismatic" else "N m/rad to {:g} rad"
        report.applied(subject, f"{stiffness:g} {what.format(reference)}")
        return stiffness, reference
    return 0.0, 0.0


def apply_springs(joints: Iterable[Joint], blocks: GazeboExtensions) -> tuple[Joint, ...]:
    """Apply the springs of the blocks to joints before lumping."""
    return tuple(_apply_spring(joint, blocks.springs) for joint in joints)


def _apply_spring(joint: Joint, springs: dict[str, tuple[float, float]]) -> Joint:
    stiffness, reference = springs.get(joint.name, (0.0, 0.0))
    if stiffness == 0.0:
        return joint
    return msgspec.structs.replace(joint, spring_stiffness=stiffness, spring_reference=reference)


def apply_surfaces(links: Iterable[Link], blocks: GazeboExtensions) -> tuple[Link, ...]:
    """Apply the surfaces and colours of the blocks to links before lumping."""
    return tuple(_apply_surface(link, blocks) for link in links)


def _apply_surface(link: Link, blocks: GazeboExtensions) -> Link:
    replace = msgspec.structs.replace
    if link.name in blocks.surfaces:
        link = blocks.surfaces[link.name].apply_to_link(link)
    if link.name in blocks.colours:
        colour = blocks.colours[link.name]
        link = replace(link, visuals=tuple(replace(shape, rgba=colour) for shape in link.visuals))
    return replace(link, self_collides=True) if blocks.self_collides else link


def _read_model_tag(child: Element, blocks: GazeboExtensions, report: ParseReport) -> None:
    if child.tag == "plugin":
        blocks.plugins.append(child)
    elif child.tag == "static":
        blocks.is_static = bool(parse_flag(_element_text(child)))
        report.applied("gazebo: <static>", "the robot does not move" if blocks.is_static else "")
    elif child.tag == "self_collide":
        blocks.self_collides = bool(parse_flag(_element_text(child)))
        report.applied("gazebo: <self_collide>")
    elif child.tag in UNUSED_MODEL_TAGS:
        report.ignored(f"gazebo: <{child.tag}>", UNUSED_MODEL_TAGS[child.tag])
    else:
        report.unread_tag("gazebo", child.tag, (*MODEL_TAGS, *UNUSED_MODEL_TAGS))


def _read_link_tag(
    link: str, child: Element, blocks: GazeboExtensions, report: ParseReport
) -> None:
    subject = f"gazebo {link!r}"
    if child.tag in SURFACE_TAGS:
        blocks.surface_texts.setdefault(link, {})[SURFACE_TAGS[child.tag]] = _element_text(child)
    elif child.tag == "material":
        _read_material(link, child, blocks, report)
    elif child.tag == "sensor":
        blocks.sensors.append(SensorElement(link, child))
    elif child.tag == "plugin":
        report.suspicious(
            f"{subject}: <plugin>", "not read in a block with a reference; remove the reference"
        )
    elif child.tag in UNUSED_LINK_TAGS:
        report.ignored(f"{subject}: <{child.tag}>", UNUSED_LINK_TAGS[child.tag])
    else:
        report.unread_tag(subject, child.tag, (*LINK_TAGS, *UNUSED_LINK_TAGS))


def _read_material(
    link: str, child: Element, blocks: GazeboExtensions, report: ParseReport
) -> None:
    subject, name = f"gazebo {link!r}: <material>", _element_text(child)
    colour = find_gazebo_colour(name)
    if colour is None:
        report.unknown(subject, f"no colour is named {name[:80]!r}")
    else:
        blocks.colours[link] = colour
        report.applied(subject, name)


def _read_joint_tag(
    joint: str, child: Element, blocks: GazeboExtensions, report: ParseReport
) -> None:
    subject = f"gazebo {joint!r}"
    if child.tag in KEEP_JOINT_TAGS:
        if parse_flag(_element_text(child)):
            blocks.kept_joints.add(joint)
        report.applied(f"{subject}: <{child.tag}>")
    elif child.tag in SPRING_TAGS:
        blocks.spring_texts.setdefault(joint, {})[child.tag] = _element_text(child)
    elif child.tag in UNUSED_JOINT_TAGS:
        report.ignored(f"{subject}: <{child.tag}>", UNUSED_JOINT_TAGS[child.tag])
    else:
        report.unread_tag(subject, child.tag, (*KEEP_JOINT_TAGS, *SPRING_TAGS, *UNUSED_JOINT_TAGS))


def _element_text(child: Element) -> str:
    return (child.text or child.get("value") or "").strip()


ROUND_SIZE_ATTRIBUTES = {
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "cone": ("radius", "length"),
}
"""Attributes of `Shape.size`, by kind."""


def read_collisions(link: Element, policy: MeshPolicy, report: ParseReport) -> tuple[Shape, ...]:
    """Read the collisions of a <link>.

    Raises:
        ModelError: A mesh is missing and must not be.
    """
    where = f"link {quote(link.get('name'))}"
    shapes = [_read_shape(collision) for collision in link.findall("collision")]
    return tuple(
        shape for shape in shapes if policy.can_use(shape, where, collides=True, report=report)
    )


def read_visuals(
    link: Element, policy: MeshPolicy, colours: dict[str, Quat], report: ParseReport
) -> tuple[Shape, ...]:
    """Read the visuals of a <link>; a missing mesh or a size of 0 is reported."""
    visuals, kept = link.findall("visual"), []
    for number, visual in enumerate(visuals, start=1):
        colour = read_visual_colour(visual, colours, report)
        shape = msgspec.structs.replace(_read_shape(visual), rgba=colour)
        where = f"link {quote(link.get('name'))}"
        where += f", visual {number}" if len(visuals) > 1 else ""
        if shape.kind != "mesh" and not any(shape.size):
            report.suspicious(where, f"{shape.kind} of size 0; not drawn")
        elif policy.can_use(shape, where, collides=False, report=report):
            kept.append(shape)
    return tuple(kept)


def read_origin(part: Element) -> Origin:
    """Read the <origin> of an element; identity without one."""
    origin = part.find("origin")
    if origin is None:
        return Origin()
    x, y, z = _read_attribute(origin, "xyz", 3)
    return make_origin((x, y, z), _read_attribute(origin, "rpy", 3))


def _read_shape(part: Element) -> Shape:
    geometry = part.find("geometry")
    if geometry is None or not len(geometry):
        raise ModelError(f"a <{part.tag}> has no geometry; add one", slug="urdf.geometry")
    solid, origin = geometry[0], read_origin(part)
    if solid.tag == "box":
        x, y, z = _read_attribute(solid, "size", 3)
        return Shape("box", (x, y, z), origin)
    if solid.tag == "ellipsoid":
        x, y, z = _read_attribute(solid, "radii", 3)
        return msgspec.structs.replace(make_ellipsoid((x, y, z)), origin=origin)
    if solid.tag == "mesh":
        return Shape("mesh", _read_scale(solid), origin, mesh=(solid.get("filename") or "").strip())
    radius, *length = (
        _read_attribute(solid, name, 1)[0] for name in ROUND_SIZE_ATTRIBUTES[solid.tag]
    )
    size = (radius, length[0] if length else 0.0, 0.0)
    if solid.tag == "sphere":
        return Shape("sphere", size, origin)
    if solid.tag == "cone":
        return msgspec.structs.replace(make_cone(*size[:2]), origin=origin)
    return Shape("cylinder" if solid.tag == "cylinder" else "capsule", size, origin)


def _read_scale(mesh: Element) -> Vec3:
    written = read_numbers(
        mesh.get("scale", "1"), counts=(1, 3), where="mesh, scale", slug="urdf.number"
    )
    x, y, z = written * 3 if len(written) == 1 else written
    return (x, y, z)


def _read_attribute(
    element: Element | None, name: str, count: int, *, default: str = ""
) -> tuple[float, ...]:
    written = None if element is None else element.get(name)
    if element is None or written is None:
        written = default or " ".join(["0"] * count)
    where = f"{element.tag}, {name}" if element is not None else name
    return read_numbers(written, counts=(count,), where=where, slug="urdf.number")


def _read_scalar(element: Element | None, name: str) -> float:
    """Read the number of an attribute; 0 where it or the element is missing."""
    return _read_attribute(element, name, 1)[0]


JOINT_KINDS: dict[str, JointKind] = {kind: kind for kind in get_args(JointKind)}
LIMITED_KINDS = ("revolute", "prismatic")
DEFAULT_AXIS = "1 0 0"
"""Of a joint without one. Source: URDF."""


def read_links_and_joints(robot: Element, policy: MeshPolicy, report: ParseReport) -> ParsedModel:
    """Read the links and joints of a <robot> after the schema check.

    Raises:
        ModelError: A joint's type is unknown, or a limit or a collision mesh is missing.
    """
    colours = read_named_colours(robot, report)
    links = tuple(
        Link(
            name=element.get("name") or "",
            inertial=_read_inertial(element),
            collisions=read_collisions(element, policy, report),
            visuals=read_visuals(element, policy, colours, report),
        )
        for element in robot.findall("link")
    )
    joints = tuple(_read_joint(element, report) for element in robot.findall("joint"))
    return ParsedModel(robot.get("name") or "", links, joints)


def _read_joint(joint: Element, report: ParseReport) -> Joint:
    name, kind = joint.get("name") or "", _read_joint_kind(joint)
    limit, axis = joint.find("limit"), joint.find("axis")
    if kind in LIMITED_KINDS:
        _check_limit(limit, f"joint {quote(name)}", kind, report)
    x, y, z = _read_attribute(axis, "xyz", 3, default=DEFAULT_AXIS)
    lower, upper, effort, velocity = (
        _read_scalar(limit, part) for part in ("lower", "upper", "effort", "velocity")
    )
    dynamics = joint.find("dynamics")
    return Joint(
        name=name,
        kind=kind,
        parent=_read_end(joint, "parent"),
        child=_read_end(joint, "child"),
        origin=read_origin(joint),
        axis=(x, y, z),
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        damping=_read_scalar(dynamics, "damping"),
        friction=_read_scalar(dynamics, "friction"),
        mimic=_read_mimic(joint),
    )


def _read_joint_kind(joint: Element) -> JointKind:
    written = joint.get("type") or ""
    kind = JOINT_KINDS.get(written.strip())
    if kind is None:
        raise ModelError(
            f"joint {quote(joint.get('name'))} has type {quote(written)}; "
            f"use one of {', '.join(JOINT_KINDS)}",
            slug="urdf.joint_type",
        )
    return kind


def _check_limit(limit: Element | None, where: str, kind: JointKind, report: ParseReport) -> None:
    if limit is None:
        raise ModelError(
            f"{kind} {where} has no <limit>; add one or make it continuous", slug="urdf.limit"
        )
    if limit.get("lower") is None and limit.get("upper") is None:
        report.suspicious(where, "its <limit> has no lower and upper: locked at 0")


def _read_end(joint: Element, tag: str) -> str:
    end = joint.find(tag)
    return "" if end is None else (end.get("link") or "")


def _read_mimic(joint: Element) -> Mimic | None:
    mimic = joint.find("mimic")
    if mimic is None:
        return None
    (multiplier,) = _read_attribute(mimic, "multiplier", 1, default="1")
    return Mimic(mimic.get("joint") or "", multiplier, _read_scalar(mimic, "offset"))


def _read_inertial(link: Element) -> Inertial:
    inertial = link.find("inertial")
    if inertial is None:
        return Inertial()
    origin, matrix = read_origin(inertial), inertial.find("inertia")
    ixx, ixy, ixz, iyy, iyz, izz = (_read_scalar(matrix, moment) for moment in MOMENTS)
    return Inertial(
        mass_kg=_read_scalar(inertial.find("mass"), "value"),
        com_in_link=origin.position,
        inertia=rotate_moments((ixx, ixy, ixz, iyy, iyz, izz), origin.orientation),
    )


UNEXPANDED_TAGS = ("gazebo", "transmission", "ros2_control")
"""Elements whose plug-ins may expand xacro themselves."""


def read_urdf(text: str, *, has_mesh: HasMesh = no_meshes, allow_missing: bool = False) -> Model:
    """Read a robot; the model's report lists the effect of its tags.

    Args:
        text: URDF with xacro expanded.
        has_mesh: Whether the server has a mesh; no file is opened.
        allow_missing: Leave out collisions whose mesh is missing.

    Raises:
        ModelError: The text is not a valid URDF.
    """
    report = ParseReport()
    robot = parse_xml(text, root_tag="robot", slug="urdf")
    _refuse_xacro(robot)
    check_urdf_schema(robot, report)
    parts = order_as_tree(read_links_and_joints(robot, MeshPolicy(has_mesh, allow_missing), report))
    parts = drop_floating_world(parts, report)
    check_links(parts.links, report)
    blocks = read_gazebo_extensions(robot, parts, report)
    lumped = _reduce_joints(parts, blocks, report)
    model = make_model(
        parts.name, lumped, plugins=blocks.plugins, sensors=blocks.sensors, report=report
    )
    is_static = blocks.is_static or is_fixed_to_world(parts, report)
    interfaces = read_command_interfaces(robot, lumped.joints, report)
    return msgspec.structs.replace(
        model, is_static=is_static, command_interfaces=interfaces, report=report.entries()
    )


def _reduce_joints(
    parts: ParsedModel, blocks: GazeboExtensions, report: ParseReport
) -> LumpedModel:
    joints = normalize_axes(apply_springs(parts.joints, blocks))
    lumped = reduce_joints(
        apply_surfaces(parts.links, blocks),
        _fix_joints(joints) if blocks.is_static else joints,
        kept=frozenset(blocks.kept_joints),
        report=report,
    )
    added = {link.name for link in lumped.links} - {link.name for link in parts.links}
    moving = [joint for joint in lumped.joints if joint.child not in added]
    check_moving_parts(lumped.links, moving, report)
    return lumped


def _fix_joints(joints: tuple[Joint, ...]) -> tuple[Joint, ...]:
    return tuple(msgspec.structs.replace(joint, kind="fixed", mimic=None) for joint in joints)


def _refuse_xacro(robot: Element) -> None:
    for element in robot.iter():
        if "/xacro}" in element.tag or element.tag.startswith("xacro:"):
            raise _xacro_error(element, element.tag.rpartition("}")[2])
    for part in robot:
        for element in () if part.tag in UNEXPANDED_TAGS else part.iter():
            for value in element.attrib.values():
                if "${" in value or "$(" in value:
                    raise _xacro_error(element, value)


def _xacro_error(element: Element, what: str) -> ModelError:
    return ModelError(
        f"the description has the xacro expression {quote(what)} at line {element.sourceline}; "
        "run xacro first",
        code=SpawnCode.UNSUPPORTED_FORMAT,
        slug="urdf.xacro",
    )
