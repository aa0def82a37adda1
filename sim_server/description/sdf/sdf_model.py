"""SDF text to Model: nested models flattened to scoped names, then the same steps as for URDF.

An element of the zensim namespace sets the dynamics of a model:

```xml
<model name="cart_1" xmlns:zensim="urn:zensim">
  <zensim:dynamics>auto</zensim:dynamics>
</model>
```
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, get_args

import msgspec

from zensim.proto.messages.model_messages import Dynamics, Inertial, Joint, Link, Model, Origin
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.rigid_transforms import compose, invert
from zensim.sim_server.description.joint_reduction import reduce_joints
from zensim.sim_server.description.meshes.mesh_lookup import HasMesh, MeshPolicy, no_meshes
from zensim.sim_server.description.parsed_model import (
    MAX_LINKS,
    MODEL_FRAME,
    WORLD_LINK,
    ParsedModel,
    check_links,
    check_moving_parts,
    find_repeated,
    normalize_axes,
    order_as_tree,
)
from zensim.sim_server.description.plugins.plugin_registry import make_model
from zensim.sim_server.description.plugins.sensor_tags import SensorElement
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.sdf.sdf_frames import PoseGraph, to_scoped_name
from zensim.sim_server.description.sdf.sdf_includes import (
    IncludeExpander,
    ResolveInclude,
    mark_versions,
    no_includes,
)
from zensim.sim_server.description.sdf.sdf_links import (
    DEFAULT_INERTIAL,
    JointElement,
    LinkElement,
    SdfJointReader,
    SdfLinkReader,
    find_spanning_tree,
)
from zensim.sim_server.description.sdf.sdf_values import (
    read_flag,
    read_name,
    read_pose,
    read_text,
    zensim_tag,
)
from zensim.sim_server.description.strict_parsing import parse_flag, parse_xml, quote, quote_names
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lxml.etree import _Element as Element

NO_EFFECT = "Gazebo tag without effect"
NOT_DRAWN = "the page draws plain colours"


class SdfElementRule(msgspec.Struct, frozen=True):
    """Children of one element."""

    children: dict[str, SdfElementRule] = {}
    many: tuple[str, ...] = ()
    """Children that may be repeated."""
    unread: str = ""
    """Reason why the element has no effect; empty when it has one."""
    is_opaque: bool = False
    """Its contents are not checked here."""


LEAF = SdfElementRule()
ZENSIM_MODEL_TAGS = ("{urn:zensim}dynamics", "zensim:dynamics")
OPAQUE = SdfElementRule(is_opaque=True)
UNUSED = SdfElementRule(unread=NO_EFFECT, is_opaque=True)
PLAIN = SdfElementRule(unread=NOT_DRAWN, is_opaque=True)
MATERIAL = SdfElementRule(
    children={
        "script": OPAQUE,
        "ambient": LEAF,
        "diffuse": LEAF,
        **dict.fromkeys(
            (
                "specular", "emissive", "lighting", "shader", "pbr", "render_order",
                "double_sided", "shininess",
            ),
            PLAIN,
        ),
    }
)  # fmt: skip
COLLISION = SdfElementRule(
    children={
        "pose": LEAF,
        "geometry": OPAQUE,
        "surface": OPAQUE,
        "laser_retro": UNUSED,
        "max_contacts": UNUSED,
        "density": UNUSED,
        "frame": UNUSED,
    }
)
VISUAL = SdfElementRule(
    children={
        "pose": LEAF,
        "geometry": OPAQUE,
        "material": MATERIAL,
        "transparency": LEAF,
        "cast_shadows": PLAIN,
        "laser_retro": UNUSED,
        "meta": PLAIN,
        "plugin": UNUSED,
        "visibility_flags": PLAIN,
        "frame": UNUSED,
    }
)
INERTIAL = SdfElementRule(
    children={
        "pose": LEAF,
        "mass": LEAF,
        "inertia": SdfElementRule(
            children=dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), LEAF)
        ),
        "fluid_added_mass": UNUSED,
        "density": UNUSED,
        "frame": UNUSED,
    }
)
LINK = SdfElementRule(
    children={
        "pose": LEAF,
        "inertial": INERTIAL,
        "collision": COLLISION,
        "visual": VISUAL,
        "sensor": OPAQUE,
        **dict.fromkeys(
            (
                "audio_sink", "audio_source", "battery", "enable_wind", "frame", "kinematic",
                "light", "must_be_base_link", "particle_emitter", "plugin", "projector",
            ),
            UNUSED,
        ),
        **dict.fromkeys(("gravity", "self_collide"), LEAF),
        "velocity_decay": SdfElementRule(children=dict.fromkeys(("linear", "angular"), LEAF)),
    },
    many=("collision", "visual", "sensor", "light", "plugin", "battery"),
)  # fmt: skip
AXIS = SdfElementRule(
    children={
        "xyz": LEAF,
        "use_parent_model_frame": LEAF,
        "initial_position": UNUSED,
        "mimic": OPAQUE,
        "limit": SdfElementRule(
            children={
                **dict.fromkeys(("lower", "upper", "effort", "velocity"), LEAF),
                "stiffness": UNUSED,
                "dissipation": UNUSED,
            }
        ),
        "dynamics": SdfElementRule(
            children={
                "damping": LEAF,
                "friction": LEAF,
                "spring_reference": UNUSED,
                "spring_stiffness": UNUSED,
            }
        ),
    }
)
JOINT = SdfElementRule(
    children={
        **dict.fromkeys(("pose", "parent", "child"), LEAF),
        "axis": AXIS,
        "axis2": AXIS,
        "sensor": OPAQUE,
        **dict.fromkeys(
            (
                "frame", "gearbox_ratio", "gearbox_reference_body", "physics", "plugin",
                "screw_thread_pitch", "thread_pitch",
            ),
            UNUSED,
        ),
    },
    many=("sensor", "plugin"),
)  # fmt: skip
MODEL = SdfElementRule(
    children={
        **dict.fromkeys(("pose", "static", "frame", "self_collide", *ZENSIM_MODEL_TAGS), LEAF),
        "link": LINK,
        "joint": JOINT,
        "model": OPAQUE,
        "plugin": OPAQUE,
        **dict.fromkeys(
            ("allow_auto_disable", "enable_wind", "gripper", "static_origin"),
            UNUSED,
        ),
    },
    many=("frame", "link", "joint", "model", "plugin", "gripper"),
)


def report_unused_tags(model: Element, scope: str, report: ParseReport) -> None:
    """Report the tags of a <model> that have no effect, without nested models."""
    _report_element(model, MODEL, f"model {scope!r}" if scope else "model", report)


def _report_element(element: Element, tag: SdfElementRule, where: str, report: ParseReport) -> None:
    if tag.unread:
        report.ignored(where, tag.unread)
    if tag.is_opaque:
        return
    seen: set[str] = set()
    for child in element:
        if child.tag not in tag.children:
            report.unread_tag(where, child.tag, tag.children)
            continue
        below = _describe_place(where, child)
        if child.tag in seen and child.tag not in tag.many:
            report.suspicious(below, "given more than once; the first is used")
        elif tag.children[child.tag] is not LEAF:
            _report_element(child, tag.children[child.tag], below, report)
        seen.add(child.tag)


def _describe_place(where: str, child: Element) -> str:
    name = child.get("name")
    if name and where.startswith("model"):
        return f"{child.tag} {name[:80]!r}"
    return f"{where}: <{child.tag}>" if ": <" not in where else f"{where[:-1]}/{child.tag}>"


def read_dynamics(model: Element, report: ParseReport) -> Dynamics:
    """Read the dynamics of a <model>; empty when missing or unknown."""
    texts = [(child.text or "").strip() for child in model if zensim_tag(child) == "dynamics"]
    if not texts:
        return ""
    for known in get_args(Dynamics):
        if known and known == texts[-1]:
            return known  # type: ignore[no-any-return]
    kinds = ", ".join(known for known in get_args(Dynamics) if known)
    report.suspicious("dynamics", f"{quote(texts[-1])} is unknown; use {kinds}")
    return ""


MAX_FRAMES = 5000


@dataclass
class FlattenedModel:
    """Elements of a top model and its nested models.

    Attributes:
        attached_to: Link or frame that carries each frame, joint and nested model, by scoped name.
        plugins: Of the top model.
        self_colliding: Scopes of models whose links collide with each other.
    """

    frames: PoseGraph = field(default_factory=PoseGraph)
    links: list[LinkElement] = field(default_factory=list)
    joints: list[JointElement] = field(default_factory=list)
    sensors: list[SensorElement] = field(default_factory=list)
    plugins: list[Element] = field(default_factory=list)
    attached_to: dict[str, str] = field(default_factory=dict)
    self_colliding: set[str] = field(default_factory=set)

    def find_link(self, name: str, where: str, *, slug: str) -> str:
        """Find the link that carries the frame with a scoped name.

        Raises:
            ModelError: It does not exist.
        """
        links = {tag.name for tag in self.links}
        at, seen = name, set[str]()
        while at not in links:
            if at in seen or at not in self.attached_to:
                raise ModelError(
                    f"{where}: {quote(name)} is not a link; links: "
                    f"{quote_names([tag.name for tag in self.links]) or 'none'}",
                    slug=slug,
                )
            seen.add(at)
            at = self.attached_to[at]
        return at


def flatten_model(model: Element, report: ParseReport) -> FlattenedModel:
    """Collect the elements of a top model after expanding includes.

    Raises:
        ModelError: A name or a pose is invalid, or a joint's link does not exist.
    """
    found = FlattenedModel()
    pending = [("", model)]
    while pending:
        scope, element = pending.pop()
        report_unused_tags(element, scope, report)
        if read_flag(element, "self_collide", default=False, where="model"):
            found.self_colliding.add(scope)
        _add_links(element, scope, found)
        _add_frames(element, scope, found)
        pending += [
            (_add_nested_model(nested, scope, found, report), nested)
            for nested in element.findall("model")
        ]
        found.plugins += [] if scope else element.findall("plugin")
        for plugin in element.findall("plugin") if scope else ():
            report.ignored(
                f"plugin {quote(plugin.get('name'))}", f"in nested model {quote(scope)}; not read"
            )
    _check_unique("link", [tag.name for tag in found.links])
    _check_unique("joint", [tag.name for tag in found.joints])
    # Joints may connect links of nested models, so they come last.
    found.joints = [_resolve_joint_ends(tag, found) for tag in found.joints]
    return found


def _check_unique(what: str, names: list[str]) -> None:
    if repeated := find_repeated(names):
        raise ModelError(
            f"{what} names {quote_names(repeated)} are used more than once; make them unique",
            slug="sdf.duplicate_link" if what == "link" else "sdf.duplicate_joint",
        )


def _add_links(model: Element, scope: str, found: FlattenedModel) -> None:
    for element in model.findall("link"):
        where = f"link {quote(element.get('name'))}"
        name = read_name(element, where)
        full = to_scoped_name(scope, name)
        found.frames.add(name, read_pose(element, where), scope=scope, implied=MODEL_FRAME)
        found.attached_to.setdefault(PoseGraph.full_name(scope, MODEL_FRAME), full)
        found.links.append(LinkElement(element, scope, full))
        found.sensors += [SensorElement(full, sensor) for sensor in element.findall("sensor")]
    canonical = (model.get("canonical_link") or "").strip()
    if canonical:
        found.attached_to[PoseGraph.full_name(scope, MODEL_FRAME)] = to_scoped_name(
            scope, canonical
        )
    if len(found.links) > MAX_LINKS:
        raise ModelError(
            f"the model has more than {MAX_LINKS} links; use at most {MAX_LINKS}",
            slug="sdf.size",
        )


def _add_frames(model: Element, scope: str, found: FlattenedModel) -> None:
    frames, joints = model.findall("frame"), model.findall("joint")
    if len(found.attached_to) + len(frames) + len(joints) > MAX_FRAMES:
        raise ModelError(
            f"the model has more than {MAX_FRAMES} frames and joints; use fewer",
            slug="sdf.size",
        )
    for element in frames:
        where = f"frame {quote(element.get('name'))}"
        name = read_name(element, where)
        parent = (element.get("attached_to") or "").strip() or MODEL_FRAME
        found.frames.add(name, read_pose(element, where), scope=scope, implied=parent)
        found.attached_to.setdefault(
            to_scoped_name(scope, name), PoseGraph.full_name(scope, parent)
        )
    for element in joints:
        where = f"joint {quote(element.get('name'))}"
        name, child = read_name(element, where), read_text(element, "child")
        pose = read_pose(element, where)
        frame = f"{name} (joint)"  # differs from a link of the same name
        found.frames.add(frame, pose, scope=scope, implied=child)
        found.frames.add(name, pose, scope=scope, implied=child)
        found.attached_to.setdefault(to_scoped_name(scope, name), to_scoped_name(scope, child))
        found.joints.append(
            JointElement(
                element, scope, to_scoped_name(scope, name), to_scoped_name(scope, frame), "", ""
            )
        )


def _add_nested_model(
    nested: Element, scope: str, found: FlattenedModel, report: ParseReport
) -> str:
    where = f"model {quote(nested.get('name'))}"
    name = read_name(nested, where)
    full = to_scoped_name(scope, name)
    if found.frames.has(full):
        raise ModelError(
            f"{where}: another model, link or frame has this name; make them unique",
            slug="sdf.duplicate_name",
        )
    found.frames.add(name, read_pose(nested, where), scope=scope, implied=MODEL_FRAME)
    if placement := (nested.get("placement_frame") or "").strip():
        found.frames.set_placement_frame(full, placement)
    if parse_flag(read_text(nested, "static")):
        report.suspicious(f"{where}: <static>", "a nested model moves with its parent model")
    return full


def _resolve_joint_ends(tag: JointElement, found: FlattenedModel) -> JointElement:
    """Set the links of a joint."""
    where = f"joint {quote(tag.name)}"
    parent, child = (read_text(tag.element, end) for end in ("parent", "child"))
    if child == WORLD_LINK:
        raise ModelError(
            f"{where} has the world as its child; make it the parent", slug="sdf.unknown_child"
        )
    if parent != WORLD_LINK:
        parent = found.find_link(
            to_scoped_name(tag.scope, parent), where, slug="sdf.unknown_parent"
        )
    child = found.find_link(to_scoped_name(tag.scope, child), where, slug="sdf.unknown_child")
    return replace(tag, parent=parent, child=child)


def find_canonical_link(found: FlattenedModel) -> str:
    """Find the link that carries the frame of a top model.

    Raises:
        ModelError: It does not exist.
    """
    return found.find_link(MODEL_FRAME, "canonical_link", slug="sdf.canonical_link")


def _map_slug(urdf_slug: str, *, slug: str) -> tuple[str, str]:
    return urdf_slug, slug


SDF_SLUGS = dict(
    (
        _map_slug("urdf.axis", slug="sdf.axis"),
        _map_slug("urdf.cycle", slug="sdf.cycle"),
        _map_slug("urdf.dynamics", slug="sdf.dynamics"),
        _map_slug("urdf.joints", slug="sdf.joints"),
        _map_slug("urdf.mass", slug="sdf.mass"),
        _map_slug("urdf.no_links", slug="sdf.no_links"),
        _map_slug("urdf.number", slug="sdf.number"),
        _map_slug("urdf.sensor", slug="sdf.sensor"),
        _map_slug("urdf.size", slug="sdf.size"),
        _map_slug("urdf.two_parents", slug="sdf.two_parents"),
        _map_slug("urdf.two_roots", slug="sdf.two_roots"),
    )
)
"""SDF's slugs of faults that URDF and SDF share."""


def read_sdf_model(
    text: str,
    *,
    has_mesh: HasMesh = no_meshes,
    allow_missing: bool = False,
    resolve: ResolveInclude = no_includes,
) -> Model:
    """Read a robot; the model's report lists the effect of its tags.

    Args:
        text: SDF with one <model>.
        has_mesh: Whether the server has a mesh; no file is opened.
        allow_missing: Leave out collisions whose mesh is missing.
        resolve: Finds the text of an included model.

    Raises:
        ModelError: The text is not a valid SDF model.
    """
    report = ParseReport()
    element = _find_model(
        mark_versions(parse_xml(text, root_tag="sdf", slug="sdf"), report), report
    )
    IncludeExpander(resolve, report).expand(element)
    if read_pose(element, "model").origin != Origin():
        report.ignored("model: <pose>", "the pose is set by the spawn request")
    model = read_model_element(element, MeshPolicy(has_mesh, allow_missing), report)
    return msgspec.structs.replace(model, report=report.entries())


def _find_model(sdf: Element, report: ParseReport) -> Element:
    owner = sdf[0] if len(sdf) == 1 and sdf[0].tag == "world" else sdf
    models = owner.findall("model")
    if len(models) != 1 or (len(owner) != 1 and owner is sdf):
        content = ", ".join(f"<{child.tag[:40]}>" for child in list(owner)[:5]) or "nothing"
        raise ModelError(
            f"<{owner.tag}> contains {content}; a robot file contains one <model> and nothing "
            "else; load a world with zensim serve --world",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="sdf.model",
        )
    if owner is not sdf:
        report.suspicious("world", "only its model is read")
    return models[0]


def read_model_element(element: Element, policy: MeshPolicy, report: ParseReport) -> Model:
    """Read a <model> after expanding includes; the model's own report stays empty.

    Raises:
        ModelError: The model is invalid.
    """
    name = read_name(element, "model")
    is_static = read_flag(element, "static", default=False, where="model")
    with _with_sdf_slugs():
        found = flatten_model(element, report)
        parts, pivots = _read_links_and_joints(
            name, found, is_static=is_static, policy=policy, report=report
        )
        check_links(parts.links, report)
        is_static = is_static or parts.links[0].name == WORLD_LINK
        lumped = reduce_joints(parts.links, normalize_axes(parts.joints), report=report)
        if not is_static:
            moving = [joint for joint in lumped.joints if joint.child not in pivots]
            check_moving_parts(lumped.links, moving, report)
        model = make_model(
            name, lumped, plugins=found.plugins, sensors=found.sensors, report=report
        )
    dynamics = read_dynamics(element, report)
    return msgspec.structs.replace(model, is_static=is_static, dynamics=dynamics)


@contextmanager
def _with_sdf_slugs() -> Iterator[None]:
    try:
        yield
    except ModelError as error:
        if error.slug not in SDF_SLUGS:
            raise
        message = error.message.removeprefix(f"{error.slug}: ")
        raise ModelError(message, code=error.code, slug=SDF_SLUGS[error.slug]) from error


def _read_links_and_joints(
    name: str, found: FlattenedModel, *, is_static: bool, policy: MeshPolicy, report: ParseReport
) -> tuple[ParsedModel, frozenset[str]]:
    reader = SdfLinkReader(found.frames, policy, report, is_static, found.self_colliding)
    links = [reader.read(tag) for tag in found.links]
    links = links if is_static else _with_default_masses(links, report)
    taken = {link.name for link in links} | {tag.name for tag in found.joints}
    joints = SdfJointReader(found.frames, report, taken)
    # The joints of a static model do not move.
    tags = (
        () if is_static else find_spanning_tree(found.joints, [link.name for link in links], report)
    )
    chains = [joint for tag in tags for joint in joints.read(tag)]
    parts = ParsedModel(name, (*links, *joints.pivots), tuple(chains))
    rooted = order_as_tree(_attach_root(parts, found, is_static=is_static, report=report))
    return rooted, frozenset(pivot.name for pivot in joints.pivots)


def _with_default_masses(links: list[Link], report: ParseReport) -> list[Link]:
    if any(link.inertial != Inertial() for link in links):
        return links
    report.suspicious("model", "no link has an <inertial>; SDF's default 1 kg is used")
    return [msgspec.structs.replace(link, inertial=DEFAULT_INERTIAL) for link in links]


def _attach_root(
    parts: ParsedModel, found: FlattenedModel, *, is_static: bool, report: ParseReport
) -> ParsedModel:
    """Add a root link at the model frame, unless the root link is already there."""
    if not parts.links:
        return parts
    if any(joint.parent == WORLD_LINK for joint in parts.joints):
        report.applied(f"link {WORLD_LINK!r}", "the robot is fixed to the world")
        return ParsedModel(parts.name, (Link(WORLD_LINK), *parts.links), parts.joints)
    children = {joint.child for joint in parts.joints}
    roots = [link.name for link in parts.links if link.name not in children]
    canonical = find_canonical_link(found)
    if len(roots) > 1 and not is_static:
        raise ModelError(
            f"links {quote_names(roots)} are all roots; connect them so that one is left",
            slug="sdf.two_roots",
        )
    if len(roots) == 1 and canonical != roots[0]:
        report.suspicious(
            f"link {quote(canonical)}", f"canonical, but the root link is {quote(roots[0])}"
        )
    if len(roots) == 1 and found.frames.pose(roots[0]) == Origin():
        return parts
    fixed = [
        Joint(f"{MODEL_FRAME} {root}", "fixed", MODEL_FRAME, root, found.frames.pose(root))
        for root in roots
    ]
    return ParsedModel(parts.name, (Link(MODEL_FRAME), *parts.links), (*fixed, *parts.joints))


def find_placement(element: Element, pose: Origin) -> Origin:
    """Find the pose of a model frame, given the pose of its `placement_frame`.

    Raises:
        ModelError: The placement frame does not exist.
    """
    frame = (element.get("placement_frame") or "").strip()
    if not frame:
        return pose
    frames = flatten_model(element, ParseReport()).frames
    return compose(pose, invert(frames.pose(frames.full_name("", frame))))
