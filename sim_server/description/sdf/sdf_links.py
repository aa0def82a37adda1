"""Links of SDF models: inertia, collisions, visuals and lights, with poses in their link."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, get_args

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import (
    DOWNWARD,
    Decay,
    Inertial,
    Joint,
    JointKind,
    Light,
    LightKind,
    Link,
    Mimic,
    Origin,
    Shape,
    Texture,
    Vec3,
)
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.rigid_transforms import (
    compose,
    conjugate,
    from_directions,
    invert,
    normalize,
    rotate,
)
from zensim.proto.se3 import to_matrix
from zensim.sim_server.description.joint_reduction import SLIDE_LIMIT_M, X, Y, Z, make_unique_name
from zensim.sim_server.description.link_surfaces import (
    SurfaceParameters,
    SurfaceTagReader,
    read_gazebo_material,
    read_rgba,
    read_surface_texts,
    to_decay_rate,
)
from zensim.sim_server.description.meshes.generated_solids import (
    make_cone,
    make_ellipsoid,
    make_prisms,
)
from zensim.sim_server.description.parsed_model import MODEL_FRAME, WORLD_LINK
from zensim.sim_server.description.sdf.sdf_frames import PoseGraph
from zensim.sim_server.description.sdf.sdf_rules import VERSION_ATTRIBUTE
from zensim.sim_server.description.sdf.sdf_values import (
    read_bound,
    read_child_numbers,
    read_flag,
    read_pose,
    read_scalar,
    read_text,
    read_vector,
)
from zensim.sim_server.description.strict_parsing import quote, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence, Set

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
    from zensim.sim_server.description.report import ParseReport

NO_LIMIT = 1e15
"""SDF writes 1e16 for no limit."""
TURN_LIMIT_RAD = 1e6
MAX_STIFFNESS = 1e12
"""[N m/rad or N/m]."""
OFFSET_TOLERANCE_M = 1e-5
"""Distance of a joint's axis from its child's origin that comes from rounded angles."""
SINGLE_AXIS_KINDS = ("revolute", "continuous", "prismatic")
DOUBLE_AXIS_KINDS = ("universal", "revolute2")
SDF_JOINT_KINDS = ("fixed", *SINGLE_AXIS_KINDS, "ball", *DOUBLE_AXIS_KINDS)
MODEL_FRAME_VERSIONS = ("1.0", "1.2", "1.3", "1.4")
"""Versions whose axes are in the model's frame."""


@dataclass(frozen=True)
class JointElement:
    """A <joint>, its scope, its scoped name, its frame, and its links."""

    element: Element
    scope: str
    name: str
    frame: str
    parent: str
    child: str
    is_reversed: bool = False
    """Parent and child are swapped in the file."""


@dataclass
class SdfJointReader:
    """Reads the joints of one top model; `pivots` gets the links between joints of chains."""

    frames: PoseGraph
    report: ParseReport
    taken: set[str]
    pivots: list[Link] = field(default_factory=list)

    def read(self, tag: JointElement) -> list[Joint]:
        """Read a joint as a chain from its parent to its child.

        Raises:
            ModelError: Its type is not supported, or a value is not a number.
        """
        kind = (tag.element.get("type") or "").strip()
        if kind not in SDF_JOINT_KINDS:
            raise ModelError(
                f"joint {quote(tag.name)} has type {quote(kind)}; "
                f"use one of {', '.join(SDF_JOINT_KINDS)}",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="sdf.joint_type",
            )
        parent = Origin() if tag.parent == WORLD_LINK else self.frames.pose(tag.parent)
        child, joint = self.frames.pose(tag.child), self.frames.pose(tag.frame)
        start = compose(invert(parent), child)
        if kind == "fixed":
            return [Joint(tag.name, "fixed", tag.parent, tag.child, start)]
        steps = self._read_steps(tag, kind, child)
        offset = compose(invert(child), joint).position
        if not _needs_pivot(steps, offset):
            offset = (0.0, 0.0, 0.0)
        if len(steps) > 1:
            self.report.applied(
                f"joint {quote(tag.name)}", f"{kind}: {len(steps)} joints in a chain"
            )
        return self._make_chain(tag, steps, start, offset)

    def _make_chain(
        self, tag: JointElement, steps: Sequence[Joint], start: Origin, offset: Vec3
    ) -> list[Joint]:
        chain: list[Joint] = []
        parent, origin = tag.parent, compose(start, Origin(offset))
        is_offset = any(offset)
        for number, step in enumerate(steps, start=1):
            is_last = number == len(steps)
            child = tag.child if is_last and not is_offset else self._add_pivot(tag.name)
            name = tag.name if is_last else make_unique_name(f"{tag.name}_{number}", self.taken)
            chain.append(
                msgspec.structs.replace(step, name=name, parent=parent, child=child, origin=origin)
            )
            parent, origin = child, Origin()
        if is_offset:
            back = Origin((-offset[0], -offset[1], -offset[2]))
            name = make_unique_name(f"{tag.name}_held", self.taken)
            chain.append(Joint(name, "fixed", parent, tag.child, back))
        return chain

    def _read_steps(self, tag: JointElement, kind: str, child: Origin) -> list[Joint]:
        if kind == "ball":
            # y comes first: the chain is singular when its middle joint, z, turns by 90 degrees.
            return [_make_step("continuous", axis) for axis in (Y, Z, X)]
        tags = ("axis", "axis2") if kind in DOUBLE_AXIS_KINDS else ("axis",)
        steps = [self._read_step(tag, name, kind, child) for name in tags]
        return steps[::-1] if tag.is_reversed else steps

    def _read_step(self, tag: JointElement, name: str, kind: str, child: Origin) -> Joint:
        where = f"joint {quote(tag.name)}, {name}"
        axis = tag.element.find(name)
        if axis is None:
            if kind in SINGLE_AXIS_KINDS:
                self.report.suspicious(f"joint {quote(tag.name)}", "has no <axis>; 0 0 1 is used")
            axis = _make_empty_axis(tag.element)
        lower = read_bound(axis, "limit/lower", -NO_LIMIT, where)
        upper = read_bound(axis, "limit/upper", NO_LIMIT, where)
        is_free = kind == "continuous" or (lower <= -NO_LIMIT and upper >= NO_LIMIT)
        reach = SLIDE_LIMIT_M if kind == "prismatic" else TURN_LIMIT_RAD
        moves: JointKind = "prismatic" if kind == "prismatic" else "revolute"
        return msgspec.structs.replace(
            _make_step("continuous" if is_free and moves == "revolute" else moves, Z),
            axis=self._read_direction(tag, axis, child, where),
            lower=0.0 if is_free and moves == "revolute" else max(lower, -reach),
            upper=0.0 if is_free and moves == "revolute" else min(upper, reach),
            effort=_to_limit(read_bound(axis, "limit/effort", -1.0, where)),
            velocity=_to_limit(read_bound(axis, "limit/velocity", -1.0, where)),
            damping=read_scalar(axis, "dynamics/damping", 0.0, where),
            friction=read_scalar(axis, "dynamics/friction", 0.0, where),
            spring_stiffness=self._read_stiffness(axis, where),
            spring_reference=read_scalar(axis, "dynamics/spring_reference", 0.0, where),
            mimic=_read_mimic(tag, axis, where),
        )

    def _read_stiffness(self, axis: Element, where: str) -> float:
        stiffness = read_scalar(axis, "dynamics/spring_stiffness", 0.0, where)
        if not 0.0 <= stiffness <= MAX_STIFFNESS:
            fault = f"{stiffness:g} is not between 0 and {MAX_STIFFNESS:g}; no spring"
            self.report.suspicious(f"{where}: <spring_stiffness>", fault)
            return 0.0
        return stiffness

    def _read_direction(self, tag: JointElement, axis: Element, child: Origin, where: str) -> Vec3:
        xyz = axis.find("xyz")
        direction = read_vector(axis, "xyz", Z, where)
        frame = ((xyz.get("expressed_in") or "") if xyz is not None else "").strip()
        if not frame and self._is_axis_in_model_frame(tag, axis, where):
            frame = MODEL_FRAME
        name = self.frames.full_name(tag.scope, frame) if frame else tag.frame
        in_model = rotate(self.frames.pose(name).orientation, direction)
        x, y, z = rotate(conjugate(child.orientation), in_model)
        # Seen from the parent, the child of a reversed joint moves the other way.
        return (-x, -y, -z) if tag.is_reversed else (x, y, z)

    @staticmethod
    def _is_axis_in_model_frame(tag: JointElement, axis: Element, where: str) -> bool:
        model = tag.element.getparent()
        version = (model.get(VERSION_ATTRIBUTE) or "") if model is not None else ""
        return read_flag(
            axis, "use_parent_model_frame", default=version in MODEL_FRAME_VERSIONS, where=where
        )

    def _add_pivot(self, joint: str) -> str:
        name = make_unique_name(f"{joint}_pivot", self.taken)
        self.pivots.append(Link(name))
        return name


def _make_step(kind: JointKind, axis: Vec3) -> Joint:
    return Joint("", kind, "", "", axis=axis)


def _to_limit(number: float) -> float:
    # No limit is a negative or a huge number in SDF, and 0 in `Joint`.
    return number if 0.0 < number < NO_LIMIT else 0.0


def _needs_pivot(steps: Sequence[Joint], offset: Vec3) -> bool:
    """Whether an axis of rotation does not run through the child's origin."""
    if len(steps) > 1:
        return math.hypot(*offset) > OFFSET_TOLERANCE_M
    (step,) = steps
    if step.kind == "prismatic":
        return False
    # Not of numpy, whose norm overflows for huge axes.
    length = math.hypot(*step.axis)
    if length == 0.0:
        return False
    arm = np.cross(np.array(step.axis) / length, offset)
    return math.hypot(*arm.tolist()) > OFFSET_TOLERANCE_M


def _read_mimic(tag: JointElement, axis: Element, where: str) -> Mimic | None:
    mimic = axis.find("mimic")
    if mimic is None:
        return None
    multiplier = read_scalar(mimic, "multiplier", 1.0, where)
    reference = read_scalar(mimic, "reference", 0.0, where)
    offset = read_scalar(mimic, "offset", 0.0, where) - multiplier * reference
    leader = PoseGraph.full_name(tag.scope, mimic.get("joint") or read_text(mimic, "joint"))
    return Mimic(leader, multiplier, offset)


def _make_empty_axis(joint: Element) -> Element:
    return joint.makeelement("axis")


COUPLING_KINDS = ("gearbox", "screw")
"""Types that couple links which other joints may carry."""


def find_spanning_tree(
    joints: Sequence[JointElement], links: Sequence[str], report: ParseReport
) -> tuple[JointElement, ...]:
    """Direct joints away from the root where a link has two parents; left out joints are reported.

    Joints that fit no tree are returned unchanged; `order_as_tree` raises errors for them.
    """
    kept = leave_out_couplings(joints)
    for joint in joints:
        if joint not in kept:
            kind = joint.element.get("type")
            report.suspicious(f"joint {quote(joint.name)}", f"{kind} is not simulated; left out")
    children = Counter(joint.child for joint in kept)
    has_root = any(joint.parent == WORLD_LINK for joint in kept) or set(links) - set(children)
    if not has_root or max(children.values(), default=0) <= 1:
        return tuple(kept)
    return tuple(_direct_joints(_find_root(kept, links), kept, report))


def leave_out_couplings(joints: Sequence[JointElement]) -> list[JointElement]:
    """Leave out the joints that only couple links which other joints carry."""
    carried = {joint.child for joint in joints if joint.element.get("type") not in COUPLING_KINDS}
    return [
        joint
        for joint in joints
        if joint.element.get("type") not in COUPLING_KINDS or joint.child not in carried
    ]


def _find_root(joints: Iterable[JointElement], links: Sequence[str]) -> str:
    return WORLD_LINK if any(joint.parent == WORLD_LINK for joint in joints) else links[0]


def _direct_joints(
    root: str, joints: Sequence[JointElement], report: ParseReport
) -> Iterable[JointElement]:
    by_parent, by_child = _index_ends(joints)
    reached = {root}
    tree: dict[str, JointElement] = {}
    forward, backward = deque(by_parent.get(root, [])), deque(by_child.get(root, []))
    while forward or backward:
        # A joint is reversed only when no other joint leads to its link.
        joint = forward.popleft() if forward else _reverse_joint(backward.popleft())
        if joint.child in reached:
            continue
        reached.add(joint.child)
        tree[joint.name] = joint
        forward.extend(by_parent.get(joint.child, []))
        backward.extend(by_child.get(joint.child, []))
    for joint in joints:
        if joint.name in tree:
            yield tree[joint.name]
        elif joint.child in reached and joint.parent != joint.child:
            report.suspicious(f"joint {quote(joint.name)}", "closes a loop of joints; left out")
        else:
            yield joint
    for joint in tree.values():
        if joint.is_reversed:
            report.applied(
                f"joint {quote(joint.name)}", f"reversed: its child is {quote(joint.child)}"
            )


def _index_ends(
    joints: Iterable[JointElement],
) -> tuple[dict[str, list[JointElement]], dict[str, list[JointElement]]]:
    by_parent: dict[str, list[JointElement]] = {}
    by_child: dict[str, list[JointElement]] = {}
    for joint in joints:
        by_parent.setdefault(joint.parent, []).append(joint)
        by_child.setdefault(joint.child, []).append(joint)
    return by_parent, by_child


def _reverse_joint(joint: JointElement) -> JointElement:
    return replace(joint, parent=joint.child, child=joint.parent, is_reversed=True)


GEOMETRY_TAGS = (
    "box", "sphere", "cylinder", "capsule", "plane", "mesh", "ellipsoid", "cone", "polyline",
)  # fmt: skip
UNSUPPORTED_GEOMETRIES = {
    "heightmap": "heightmaps are not simulated; use a mesh",
    "image": "shapes from images are not simulated; use a mesh",
}
MAX_POLYLINE_POINTS = 100
MIN_POLYLINE_POINTS = 3
UNIT_SIZE: Vec3 = (1.0, 1.0, 1.0)
UP: Vec3 = (0.0, 0.0, 1.0)
GROUND_SLAB_M: Vec3 = (1000.0, 1000.0, 1.0)
GROUND_SLAB_ORIGIN = Origin((0.0, 0.0, -0.5))
"""Centre of a slab relative to its plane."""
SHEET_THICKNESS_M = 0.002


def read_geometry(part: Element, where: str, report: ParseReport) -> list[Shape]:
    """Read the <geometry> of a collision or visual; empty and reported when not supported.

    Raises:
        ModelError: That of a collision is missing, or a size is not a positive number.
    """
    geometry = part.find("geometry")
    solids = (
        [child for child in geometry if child.tag in GEOMETRY_TAGS] if geometry is not None else []
    )
    if geometry is not None and len(geometry) and not solids:
        tag = geometry[0].tag
        if tag != "empty":
            fault = UNSUPPORTED_GEOMETRIES.get(tag, "unknown geometry")
            report.suspicious(f"{where}: <{tag[:80]}>", f"{fault}; left out")
        return []
    if not solids and part.tag == "visual":
        report.suspicious(where, "has no geometry; not drawn")
        return []
    if not solids:
        raise ModelError(
            f"{where} has no geometry; write one of {', '.join(GEOMETRY_TAGS)}", slug="sdf.geometry"
        )
    if solids[0].tag == "polyline":
        return _read_polylines(solids, where, report)
    _report_unused_shapes(solids, where, report)
    if _has_no_extent(solids[0]):
        report.suspicious(where, f"<{solids[0].tag}> of size 0; left out")
        return []
    return [_read_geometry_element(solids[0], where)]


def _report_unused_shapes(solids: Sequence[Element], where: str, report: ParseReport) -> None:
    if len(solids) > 1:
        report.suspicious(f"{where}: <geometry>", f"{len(solids)} shapes; the first is used")
    if solids[0].find("submesh") is not None:
        report.suspicious(f"{where}: <submesh>", "not supported; the whole mesh is used")


EXTENT_TAGS = ("size", "scale", "radius", "length", "radii")


def _has_no_extent(solid: Element) -> bool:
    """Whether one of its sizes is written as 0."""
    words = " ".join(read_text(solid, tag) for tag in EXTENT_TAGS).split()
    return any("0" in word and not word.strip("+-0.") for word in words)


def _read_polylines(polylines: Sequence[Element], where: str, report: ParseReport) -> list[Shape]:
    """Read outlines that are extruded along z; an outline within another is a hole in SDF."""
    if len(polylines) > 1:
        report.suspicious(f"{where}: <polyline>", "given more than once; holes are filled")
    shapes: list[Shape] = []
    for polyline in polylines:
        texts = [point.text for point in polyline.findall("point")]
        if not MIN_POLYLINE_POINTS <= len(texts) <= MAX_POLYLINE_POINTS:
            raise ModelError(
                f"{where}: a polyline has {len(texts)} points; "
                f"use {MIN_POLYLINE_POINTS} to {MAX_POLYLINE_POINTS}",
                slug="sdf.size",
            )
        points = [read_numbers(text, counts=(2,), where=where, slug="sdf.number") for text in texts]
        height = read_scalar(polyline, "height", 1.0, where)
        if height <= 0.0 or max(abs(value) for point in points for value in point) > MAX_POLYLINE_M:
            raise ModelError(f"{where}: a polyline is too flat or too wide", slug="sdf.size")
        shapes += make_prisms([(x, y) for x, y in points], height)
    return shapes


MAX_POLYLINE_M = 1e6


def read_surface(collision: Element, where: str, report: ParseReport) -> SurfaceParameters:
    """Read the surface of a collision.

    Raises:
        ModelError: Its friction is not a number >= 0.
    """
    texts = read_surface_texts(collision)
    return SurfaceTagReader(texts, subject=where, slug="sdf.friction", report=report).read()


def read_colour(visual: Element, where: str, report: ParseReport) -> Quat | None:
    """Read the colour of a visual: that of a known Gazebo script, else diffuse or ambient.

    Raises:
        ModelError: A colour is not three or four numbers.
    """
    material = visual.find("material")
    if material is None:
        return None
    return read_gazebo_material(material, where=where, slug="sdf.number", report=report)


ALBEDO_PATHS = ("material/pbr/metal/albedo_map", "material/pbr/specular/albedo_map")


def read_texture(visual: Element) -> Texture | None:
    """Read the image of a visual's physically based material."""
    named = (read_text(visual, path) for path in ALBEDO_PATHS)
    return next((Texture(uri) for uri in named if uri), None)


LIGHT_KINDS: dict[str, LightKind] = {kind: kind for kind in get_args(LightKind)}


def read_light(light: Element, origin: Origin, report: ParseReport) -> Light | None:
    """Read a <light>; None and reported when its type is unknown or it is off.

    Args:
        light: Of a world or a link.
        origin: Its pose in its owner's frame.
        report: Gets what was read.

    Raises:
        ModelError: A value is not a number.
    """
    where = f"light {quote(light.get('name'))}"
    kind = LIGHT_KINDS.get(light.get("type") or "")
    if kind is None:
        report.unknown(where, f"unknown light type {quote(light.get('type'))}")
        return None
    if not read_flag(light, "light_on", default=True, where=where):
        report.applied(where, "off")
        return None
    report.applied(where, kind)
    diffuse, default = read_text(light, "diffuse"), Light("", kind)
    factors = zip(("constant", "linear", "quadratic"), default.attenuation, strict=True)
    constant, linear, quadratic = (
        max(read_scalar(light, f"attenuation/{tag}", value, where), 0.0) for tag, value in factors
    )
    return Light(
        name=(light.get("name") or "")[:80],
        kind=kind,
        origin=origin,
        direction=rotate(origin.orientation, read_vector(light, "direction", DOWNWARD, where)),
        rgba=read_rgba(diffuse, where=f"{where}, diffuse", slug="sdf.number", report=None)
        if diffuse
        else default.rgba,
        intensity=max(read_scalar(light, "intensity", default.intensity, where), 0.0),
        range_m=max(read_scalar(light, "attenuation/range", default.range_m, where), 0.0),
        attenuation=(constant, linear, quadratic),
        outer_angle_rad=max(read_scalar(light, "spot/outer_angle", 0.0, where), 0.0),
        casts_shadows=read_flag(light, "cast_shadows", default=False, where=where),
    )


def apply_transparency(colour: Quat | None, transparency: float) -> Quat | None:
    """Apply the transparency of a visual to its colour."""
    if transparency <= 0.0:
        return colour
    r, g, b, a = colour or (1.0, 1.0, 1.0, 1.0)
    return (r, g, b, a * max(0.0, 1.0 - transparency))


def make_ground_slab(plane: Shape) -> Shape:
    """Make the collision of a plane: a wide slab below it; Gazebo's is infinite."""
    return msgspec.structs.replace(
        plane,
        kind="box",
        size=GROUND_SLAB_M,
        origin=compose(plane.origin, GROUND_SLAB_ORIGIN),
    )


def make_visual_sheet(plane: Shape) -> Shape:
    """Make the visual of a plane: a sheet of its size."""
    return msgspec.structs.replace(plane, kind="box", size=(*plane.size[:2], SHEET_THICKNESS_M))


def _read_geometry_element(solid: Element, where: str) -> Shape:
    if solid.tag == "box":
        return _check_size(Shape("box", read_vector(solid, "size", UNIT_SIZE, where)), 3, where)
    if solid.tag == "plane":
        width, depth = read_child_numbers(solid, "size", (1.0, 1.0), where)
        up = Origin(orientation=_rotation_to_normal(solid, where))
        return _check_size(Shape("plane", (width, depth, 0.0), up), 2, where)
    if solid.tag == "mesh":
        uri, scale = read_text(solid, "uri"), read_vector(solid, "scale", UNIT_SIZE, where)
        if not uri:
            raise ModelError(f"{where}: its mesh has no <uri>; write one", slug="sdf.uri")
        return Shape("mesh", scale, mesh=uri)
    return _read_round_solid(solid, where)


def _read_round_solid(solid: Element, where: str) -> Shape:
    if solid.tag == "ellipsoid":
        radii = read_vector(solid, "radii", UNIT_SIZE, where)
        return _check_size(make_ellipsoid(radii), 3 if len(set(radii)) > 1 else 1, where)
    radius = read_scalar(solid, "radius", 1.0 if solid.tag == "sphere" else 0.5, where)
    if solid.tag == "sphere":
        return _check_size(Shape("sphere", (radius, 0.0, 0.0)), 1, where)
    length = read_scalar(solid, "length", 1.0, where)
    if solid.tag == "cone":
        return _check_size(make_cone(radius, length), 3, where)
    kind = "cylinder" if solid.tag == "cylinder" else "capsule"
    return _check_size(Shape(kind, (radius, length, 0.0)), 2, where)  # type: ignore[arg-type]


def _check_size(shape: Shape, count: int, where: str) -> Shape:
    if min(shape.size[:count]) <= 0.0:
        raise ModelError(
            f"{where}: {shape.kind} of size {shape.size[:count]}; use sizes > 0",
            slug="sdf.size",
        )
    return shape


def _rotation_to_normal(plane: Element, where: str) -> Quat:
    """Find the shortest rotation from z to the plane's normal."""
    normal = read_vector(plane, "normal", UP, where)
    length = math.hypot(*normal)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"{where}: the plane's normal is {normal}; write one such as 0 0 1", slug="sdf.size"
        )
    return from_directions(UP, normalize(normal))


DEFAULT_MOMENTS = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
"""SDF's defaults [kg m^2]."""
DEFAULT_INERTIAL = Inertial(mass_kg=1.0, inertia=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
"""SDF's default for a link without <inertial>."""


@dataclass(frozen=True)
class LinkElement:
    """A <link>, the scoped name of its model, and its scoped name."""

    element: Element
    scope: str
    name: str


@dataclass(frozen=True)
class SdfLinkReader:
    """Reads the links of one top model."""

    frames: PoseGraph
    policy: MeshPolicy
    report: ParseReport
    is_static: bool
    self_colliding: Set[str] = frozenset()
    """Scopes of models whose links collide with each other."""

    def read(self, tag: LinkElement) -> Link:
        """Read a link.

        Raises:
            ModelError: A value is not a number, a size is not positive, or a mesh is missing.
        """
        where, inertial = f"link {quote(tag.name)}", self._read_inertial(tag)
        has_gravity = read_flag(tag.element, "gravity", default=True, where=where)
        return Link(
            tag.name,
            inertial,
            tuple(self._read_collisions(tag)),
            tuple(self._read_visuals(tag)),
            weightless=Inertial() if has_gravity else inertial,
            decay=Decay(*(self._read_decay(tag, part) for part in ("linear", "angular"))),
            self_collides=tag.scope in self.self_colliding
            or read_flag(tag.element, "self_collide", default=False, where=where),
            lights=tuple(self._read_lights(tag)),
        )

    def _read_lights(self, tag: LinkElement) -> Iterator[Light]:
        for element in tag.element.findall("light"):
            origin = self._read_origin(tag, element, _describe_place(tag, element))
            if (light := read_light(element, origin, self.report)) is not None:
                yield light

    def _read_decay(self, tag: LinkElement, part: str) -> float:
        where = f"link {quote(tag.name)}"
        share = read_scalar(tag.element, f"velocity_decay/{part}", 0.0, where)
        return to_decay_rate(max(share, 0.0))

    def _read_inertial(self, tag: LinkElement) -> Inertial:
        inertial, where = tag.element.find("inertial"), f"link {quote(tag.name)}, inertial"
        if inertial is None:
            return Inertial()
        origin = self._read_origin(tag, inertial, where)
        matrix = inertial.find("inertia")
        if matrix is None:
            self.report.suspicious(where, "has no <inertia>; SDF's default 1 kg m^2 is used")
            moments = tuple(DEFAULT_MOMENTS.values())
        else:
            moments = tuple(read_scalar(matrix, n, d, where) for n, d in DEFAULT_MOMENTS.items())
        ixx, ixy, ixz, iyy, iyz, izz = moments
        turn = to_matrix(np.array(origin.orientation))
        turned = turn @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ turn.T
        ixx, ixy, ixz, _, iyy, iyz, _, _, izz = turned.ravel().tolist()
        return Inertial(
            read_scalar(inertial, "mass", 1.0, where),
            origin.position,
            (ixx, ixy, ixz, iyy, iyz, izz),
        )

    def _read_collisions(self, tag: LinkElement) -> list[Shape]:
        kept = []
        for element in tag.element.findall("collision"):
            where = _describe_place(tag, element)
            shapes = self._read_shapes(tag, element, where)
            if not shapes:
                continue
            if shapes[0].kind == "plane":
                if not self.is_static:
                    fault = "a plane collides in static models only; left out"
                    self.report.suspicious(where, fault)
                    continue
                shapes = [make_ground_slab(shapes[0])]
            if self.policy.can_use(shapes[0], where, collides=True, report=self.report):
                surface = read_surface(element, where, self.report)
                name = element.get("name") or ""
                kept += [
                    msgspec.structs.replace(surface.apply_to_shape(shape), name=name)
                    for shape in shapes
                ]
        return kept

    def _read_visuals(self, tag: LinkElement) -> list[Shape]:
        kept = []
        for element in tag.element.findall("visual"):
            where = _describe_place(tag, element)
            shapes = self._read_shapes(tag, element, where)
            if not shapes or not self.policy.can_use(
                shapes[0], where, collides=False, report=self.report
            ):
                continue
            colour = read_colour(element, where, self.report)
            transparency = read_scalar(element, "transparency", 0.0, where)
            rgba, texture = apply_transparency(colour, transparency), read_texture(element)
            for shape in shapes:
                drawn = make_visual_sheet(shape) if shape.kind == "plane" else shape
                kept.append(msgspec.structs.replace(drawn, rgba=rgba, texture=texture))
        return kept

    def _read_shapes(self, tag: LinkElement, element: Element, where: str) -> list[Shape]:
        origin = self._read_origin(tag, element, where)
        return [
            msgspec.structs.replace(shape, origin=compose(origin, shape.origin))
            for shape in read_geometry(element, where, self.report)
        ]

    def _read_origin(self, tag: LinkElement, element: Element, where: str) -> Origin:
        pose = read_pose(element, where)
        if not pose.frame:
            return pose.origin
        outer = self.frames.pose(self.frames.full_name(tag.scope, pose.frame))
        return compose(invert(self.frames.pose(tag.name)), compose(outer, pose.origin))


def _describe_place(tag: LinkElement, element: Element) -> str:
    return f"link {quote(tag.name)}, {element.tag} {quote(element.get('name'))}"
