"""URDF text to Model: links, joints and shapes, then tree, lumping and plug-ins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

import msgspec

from zensim.proto.messages.model_messages import (
    LIMITED_KINDS,
    MOVABLE_KINDS,
    ZERO,
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
from zensim.sim_server.description.collision_names import name_collision
from zensim.sim_server.description.element_rules import check_element
from zensim.sim_server.description.joint_reduction import LumpedModel, reduce_joints, rotate_moments
from zensim.sim_server.description.link_surfaces import SURFACE_TAG_NAMES as SURFACE_TAGS
from zensim.sim_server.description.link_surfaces import (
    SurfaceParameters,
    SurfaceTagReader,
    find_gazebo_colour,
    read_gazebo_material,
    read_named_materials,
    read_surface_texts,
    read_visual_look,
)
from zensim.sim_server.description.meshes.generated_solids import make_cone, make_ellipsoid
from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
from zensim.sim_server.description.meshes.mesh_triangles import find_no_file
from zensim.sim_server.description.model_geometry import make_origin
from zensim.sim_server.description.parsed_model import (
    ParsedModel,
    check_links,
    check_magnitude,
    check_moving_parts,
    drop_floating_world,
    has_no_extent,
    is_fixed_to_world,
    normalize_axes,
    order_as_tree,
)
from zensim.sim_server.description.plugins.control_interfaces import read_command_interfaces
from zensim.sim_server.description.plugins.plugin_registry import make_model
from zensim.sim_server.description.plugins.sensor_tags import SensorElement
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.strict_parsing import (
    check_expanded,
    parse_flag,
    quote,
    read_number,
    read_numbers,
)
from zensim.sim_server.description.strict_xml import parse_xml
from zensim.sim_server.description.urdf.urdf_rules import (
    GAZEBO_OF_JOINT,
    GAZEBO_OF_LINK,
    GAZEBO_OF_MODEL,
    KEEP_JOINT_TAGS,
    MOMENTS,
    ROBOT,
    SCALE,
    SPRING_TAGS,
)
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.link_surfaces import UrdfMaterial
    from zensim.sim_server.description.meshes.mesh_triangles import FindFile

ROUND_KINDS: dict[str, Literal["sphere", "cylinder", "capsule"]] = {
    "sphere": "sphere",
    "cylinder": "cylinder",
    "capsule": "capsule",
}
JOINT_KINDS: dict[str, JointKind] = {kind: kind for kind in get_args(JointKind)}
DEFAULT_AXIS = "1 0 0"
"""Axis of a joint without one. Source: URDF."""
UNEXPANDED_TAGS = ("gazebo", "transmission", "ros2_control")
"""Elements whose plug-ins may expand xacro themselves."""


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
        subject = "gazebo" if reference is None else f"gazebo {reference[:80]!r}"
        if reference is None:
            check_element(block, GAZEBO_OF_MODEL, subject, report)
            for child in block:
                _read_model_tag(child, blocks, report)
        elif reference in links:
            check_element(block, GAZEBO_OF_LINK, subject, report)
            for child in block:
                _read_link_tag(reference, child, blocks, report)
        elif reference in joints:
            check_element(block, GAZEBO_OF_JOINT, subject, report)
            for child in block:
                _read_joint_tag(reference, child, blocks, report)
        else:
            report.suspicious(subject, "no link or joint has this name; block not read")
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
    if joint.kind not in MOVABLE_KINDS:
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
        painted = (replace(shape, rgba=colour, texture=None) for shape in link.visuals)
        link = replace(link, visuals=tuple(painted))
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


def _read_link_tag(
    link: str, child: Element, blocks: GazeboExtensions, report: ParseReport
) -> None:
    subject = f"gazebo {link!r}"
    if child.tag in SURFACE_TAGS:
        blocks.surface_texts.setdefault(link, {})[SURFACE_TAGS[child.tag]] = _element_text(child)
    elif child.tag == "collision":
        if texts := read_surface_texts(child):
            blocks.surface_texts.setdefault(link, {}).update(texts)
    elif child.tag == "material":
        _read_material(link, child, blocks, report)
    elif child.tag == "visual":
        _read_visual(link, child, blocks, report)
    elif child.tag == "sensor":
        blocks.sensors.append(SensorElement(link, child))
    elif child.tag == "plugin":
        report.suspicious(
            f"{subject}: <plugin>", "not read in a block with a reference; remove the reference"
        )


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


def _read_visual(link: str, visual: Element, blocks: GazeboExtensions, report: ParseReport) -> None:
    """Read the colour of a <visual> in a block; Gazebo adds it to the visuals of the link."""
    subject, material = f"gazebo {link!r}: <visual>", visual.find("material")
    try:
        colour = material is not None and read_gazebo_material(
            material, where=subject, slug="urdf.number", report=report
        )
    except ModelError as error:
        report.suspicious(subject, f"{error.fault}; left out")
        return
    if not colour:
        report.ignored(subject, "only the colour of its <material> is used")
        return
    blocks.colours.setdefault(link, colour)
    report.applied(subject, "its colour")


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


def _element_text(child: Element) -> str:
    return (child.text or child.get("value") or "").strip()


def read_collisions(link: Element, policy: MeshPolicy, report: ParseReport) -> tuple[Shape, ...]:
    """Read the collisions of a <link>; one without extent, which touches nothing, is left out.

    Raises:
        ModelError: A mesh is missing and must not be.
    """
    kept, link_name = [], link.get("name") or ""
    for number, (collision, where) in enumerate(_number_parts(link, "collision")):
        name = name_collision(collision.get("name") or link_name, number)
        shape = msgspec.structs.replace(_read_shape(collision, where, report), name=name)
        if has_no_extent(shape):
            report.suspicious(where, f"{_describe_solid(shape)} of size 0; left out")
        elif policy.can_use(shape, f"link {quote(link.get('name'))}", collides=True, report=report):
            kept.append(shape)
    return tuple(kept)


def read_visuals(
    link: Element, policy: MeshPolicy, looks: dict[str, UrdfMaterial], report: ParseReport
) -> tuple[Shape, ...]:
    """Read the visuals of a <link>; a missing mesh or a size of 0 is reported."""
    kept = []
    for visual, where in _number_parts(link, "visual"):
        look = read_visual_look(visual, looks, report)
        shape = _read_shape(visual, where, report)
        shape = msgspec.structs.replace(shape, rgba=look.rgba, texture=look.texture)
        if has_no_extent(shape) or (shape.kind != "mesh" and min(shape.size) < 0.0):
            report.suspicious(where, f"{_describe_solid(shape)} of size <= 0; not drawn")
        elif policy.can_use(shape, where, collides=False, report=report):
            kept.append(shape)
    return tuple(kept)


def _number_parts(link: Element, tag: str) -> list[tuple[Element, str]]:
    parts, where = link.findall(tag), f"link {quote(link.get('name'))}"
    if len(parts) == 1:
        return [(parts[0], f"{where}, {tag}")]
    return [(part, f"{where}, {tag} {number}") for number, part in enumerate(parts, start=1)]


def _describe_solid(shape: Shape) -> str:
    return f"mesh {quote(shape.mesh)}" if shape.mesh else shape.kind


def read_origin(part: Element) -> Origin:
    """Read the <origin> of an element; identity without one."""
    origin = part.find("origin")
    if origin is None:
        return Origin()
    x, y, z = _read_attribute(origin, "xyz", 3)
    return make_origin((x, y, z), _read_attribute(origin, "rpy", 3))


def _read_shape(part: Element, where: str, report: ParseReport) -> Shape:
    geometry = part.find("geometry")
    if geometry is None or not len(geometry):
        raise ModelError(f"{where} has no geometry; add one", slug="urdf.geometry")
    return msgspec.structs.replace(
        _read_solid(geometry[0], where, report), origin=read_origin(part)
    )


def _read_solid(solid: Element, where: str, report: ParseReport) -> Shape:
    if solid.tag == "mesh":
        uri = (solid.get("filename") or "").strip()
        return Shape("mesh", _read_scale(solid, where, report), mesh=uri)
    if solid.tag in ("box", "ellipsoid"):
        x, y, z = _read_attribute(solid, "size" if solid.tag == "box" else "radii", 3)
        return Shape("box", (x, y, z)) if solid.tag == "box" else make_ellipsoid((x, y, z))
    radius, length = _read_scalar(solid, "radius"), _read_scalar(solid, "length")
    if solid.tag == "cone":
        return make_cone(radius, length)
    return Shape(ROUND_KINDS[solid.tag], (radius, length, 0.0))


def _read_scale(mesh: Element, where: str, report: ParseReport) -> Vec3:
    written = read_numbers(
        mesh.get("scale", "1"), counts=SCALE, where=f"{where}, scale", slug="urdf.number"
    )
    if len(written) > len(ZERO):
        report.suspicious(f"{where}, scale", "has four numbers; the first three are used")
    x, y, z = written * 3 if len(written) == 1 else written[:3]
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


def read_links_and_joints(robot: Element, policy: MeshPolicy, report: ParseReport) -> ParsedModel:
    """Read the links and joints of a <robot> after the schema check.

    Raises:
        ModelError: A joint's type is unknown, or a limit or a collision mesh is missing.
    """
    looks = read_named_materials(robot, report)
    links = tuple(
        Link(
            name=element.get("name") or "",
            inertial=_read_inertial(element),
            collisions=read_collisions(element, policy, report),
            visuals=read_visuals(element, policy, looks, report),
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
        # Negative limits are none, as in Gazebo.
        effort=max(effort, 0.0),
        velocity=max(velocity, 0.0),
        damping=_read_scalar(dynamics, "damping"),
        friction=_read_scalar(dynamics, "friction"),
        mimic=_read_mimic(joint),
    )


def _read_joint_kind(joint: Element) -> JointKind:
    written = joint.get("type") or ""
    kind = JOINT_KINDS.get(written)
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


def read_urdf(
    text: str, *, find_mesh: FindFile = find_no_file, allow_missing: bool = False
) -> Model:
    """Read a robot; the model's report lists the effect of its tags.

    Args:
        text: URDF with xacro expanded.
        find_mesh: Finds a mesh by its URI.
        allow_missing: Leave out collisions whose mesh is missing.

    Raises:
        ModelError: The text is not a valid URDF.
    """
    report = ParseReport()
    robot = parse_xml(text, root_tag="robot", slug="urdf")
    _refuse_xacro(robot)
    check_element(robot, ROBOT, "robot", report)
    parts = order_as_tree(
        read_links_and_joints(robot, MeshPolicy(find_mesh, allow_missing), report)
    )
    parts = drop_floating_world(parts, report)
    parts = ParsedModel(parts.name, check_links(parts.links, report), parts.joints)
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
    joints = normalize_axes(apply_springs(parts.joints, blocks), report)
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
            raise ModelError(
                f"the description has the tag {quote(element.tag.rpartition('}')[2])} of xacro at "
                f"line {element.sourceline}; run xacro first",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="urdf.xacro",
            )
    for part in robot:
        for element in () if part.tag in UNEXPANDED_TAGS else part.iter():
            for name, value in element.attrib.items():
                check_expanded(value, f"line {element.sourceline}, <{element.tag[:80]} {name}>")
