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
from itertools import count
from typing import TYPE_CHECKING, get_args

import msgspec

from zensim.proto.messages.model_messages import Dynamics, Inertial, Joint, Link, Model, Origin
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.rigid_transforms import compose, invert
from zensim.sim_server.description.element_rules import POSE, check_element, zensim_tag
from zensim.sim_server.description.joint_reduction import reduce_joints
from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
from zensim.sim_server.description.meshes.mesh_triangles import find_no_file
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
from zensim.sim_server.description.sdf.sdf_frames import SCOPE_SEPARATOR, PoseGraph, to_scoped_name
from zensim.sim_server.description.sdf.sdf_includes import (
    IncludeExpander,
    ResolveInclude,
    no_includes,
    parse_sdf,
)
from zensim.sim_server.description.sdf.sdf_joints import (
    JointElement,
    SdfJointReader,
    find_spanning_tree,
    leave_out_couplings,
)
from zensim.sim_server.description.sdf.sdf_links import DEFAULT_INERTIAL, LinkElement, SdfLinkReader
from zensim.sim_server.description.sdf.sdf_rules import MODEL, VERSION_ATTRIBUTE
from zensim.sim_server.description.sdf.sdf_values import read_flag, read_name, read_pose, read_text
from zensim.sim_server.description.strict_parsing import parse_flag, quote, quote_names
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.meshes.mesh_triangles import FindFile

MAX_FRAMES = 5000
LAX_NAME_VERSIONS = ("1.2", "1.3", "1.4", "1.5", "1.6")
"""Versions in which siblings of different kinds may share a name."""
NAMED_TAGS = ("link", "joint", "frame", "model")


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


@dataclass
class FlattenedModel:
    """Elements of a top model and its nested models.

    Attributes:
        attached_to: Link or frame that carries each frame, joint and nested model, by scoped name.
        plugins: Of the top model.
        self_colliding: Scopes of models whose links collide with each other.
        static_scopes: Scopes of static nested models.
    """

    frames: PoseGraph = field(default_factory=PoseGraph)
    links: list[LinkElement] = field(default_factory=list)
    joints: list[JointElement] = field(default_factory=list)
    sensors: list[SensorElement] = field(default_factory=list)
    plugins: list[Element] = field(default_factory=list)
    attached_to: dict[str, str] = field(default_factory=dict)
    self_colliding: set[str] = field(default_factory=set)
    static_scopes: set[str] = field(default_factory=set)

    def find_link(self, name: str, where: str, *, slug: str) -> str:
        """Find the link that carries the frame with a scoped name.

        Raises:
            ModelError: It does not exist.
        """
        links = {tag.name for tag in self.links}
        at, seen = name, set[str]()
        while at not in links:
            if at in seen:
                raise ModelError(
                    f"{where}: frame {quote(at)} is attached to itself; attach one of "
                    f"{quote_names(sorted(seen))} to a link",
                    slug="sdf.attachment_cycle",
                )
            if at not in self.attached_to:
                raise ModelError(
                    f"{where}: {quote(at)} is not a link; links: "
                    f"{quote_names([tag.name for tag in self.links]) or 'none'}",
                    slug=slug,
                )
            seen.add(at)
            at = self.attached_to[at]
        return at

    def check_attachments(self) -> None:
        """Check that a link carries each frame.

        Raises:
            ModelError: Frames are attached to each other in a cycle, or to none that exists.
        """
        carried = {tag.name for tag in self.links}
        for name in self.attached_to if self.links else ():
            chain, at = dict[str, None](), name
            while at not in carried and at not in chain and at in self.attached_to:
                chain[at] = None
                at = self.attached_to[at]
            if at not in carried:
                slug = "sdf.canonical_link" if name == MODEL_FRAME else "sdf.unknown_frame"
                self.find_link(name, f"frame {quote(name)}", slug=slug)
            carried.update(chain)


def flatten_model(model: Element, report: ParseReport) -> FlattenedModel:
    """Collect the elements of a top model after expanding includes.

    Raises:
        ModelError: A name or a pose is invalid, or a joint's link does not exist.
    """
    found = FlattenedModel()
    pending = [("", model)]
    while pending:
        scope, element = pending.pop()
        check_element(element, MODEL, f"model {scope!r}" if scope else "model", report)
        check_sibling_names(element, report)
        if read_flag(element, "self_collide", default=False, where="model"):
            found.self_colliding.add(scope)
        _add_links(element, scope, found)
        _add_frames(element, scope, found)
        pending += [
            (_add_nested_model(nested, scope, found), nested) for nested in element.findall("model")
        ]
        found.plugins += [] if scope else element.findall("plugin")
        for plugin in element.findall("plugin") if scope else ():
            report.ignored(
                f"plugin {quote(plugin.get('name'))}", f"in nested model {quote(scope)}; not read"
            )
    _check_unique("link", [tag.name for tag in found.links], slug="sdf.duplicate_link")
    _check_unique("joint", [tag.name for tag in found.joints], slug="sdf.duplicate_joint")
    # Joints may connect links of nested models, so they come last.
    found.joints = [_resolve_joint_ends(tag, found) for tag in found.joints]
    found.check_attachments()
    return found


def rename_repeated(root: Element, report: ParseReport) -> None:
    """Rename models, links and joints that have the name of an earlier one beside them.

    SDF up to 1.6 allowed it, and its editors wrote it; what names them means the first.
    """
    for owner in root.iter("world", "model"):
        if owner.get(VERSION_ATTRIBUTE) not in LAX_NAME_VERSIONS:
            continue
        named = [child for child in owner if child.tag in ("link", "joint", "model")]
        taken, seen = {child.get("name") for child in named}, set[tuple[str, str | None]]()
        for child in named:
            written = child.get("name")
            if written and (child.tag, written) in seen:
                free = (f"{written}_{number}" for number in count(2))
                child.set("name", next(name for name in free if name not in taken))
                taken.add(child.get("name"))
                fault = f"another has this name; renamed to {quote(child.get('name'))}"
                where = f"{child.tag} {quote(written)}"
                place = "" if owner.tag == "world" else f"model {quote(owner.get('name'))}: "
                report.suspicious(f"{place}{where}", fault)
            seen.add((child.tag, written))


def check_sibling_names(owner: Element, report: ParseReport) -> None:
    """Check that links, joints, frames and models of a model or a world have different names.

    Raises:
        ModelError: Two frames have one name, or two siblings of SDF 1.7 or later.
    """
    names = [(child.tag, child.get("name") or "") for child in owner if child.tag in NAMED_TAGS]
    frames = [name for tag, name in names if tag == "frame"]
    _check_unique("frame", frames, slug="sdf.duplicate_name")
    repeated = find_repeated([name for _, name in dict.fromkeys(names)])
    if not repeated:
        return
    fault = f"names {quote_names(repeated)} are those of siblings of different kinds"
    version = owner.get(VERSION_ATTRIBUTE)
    if version is None or version in LAX_NAME_VERSIONS:
        report.suspicious(f"{owner.tag} {quote(owner.get('name'))}", f"{fault}; make them unique")
        return
    raise ModelError(f"{fault}; make them unique", slug="sdf.duplicate_name")


def _check_unique(what: str, names: list[str], *, slug: str) -> None:
    if repeated := find_repeated(names):
        raise ModelError(
            f"{what} names {quote_names(repeated)} are used more than once; make them unique",
            slug=slug,
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
    if carrier := _find_carrier(model):
        found.attached_to[PoseGraph.full_name(scope, MODEL_FRAME)] = to_scoped_name(scope, carrier)
    if len(found.links) > MAX_LINKS:
        raise ModelError(
            f"the model has more than {MAX_LINKS} links; use at most {MAX_LINKS}", slug="sdf.size"
        )


def _find_carrier(model: Element) -> str:
    """Find the canonical link if it is not the first link; empty if it is.

    A model without links has that of its first nested model with links.
    """
    canonical = (model.get("canonical_link") or "").strip()
    if canonical or model.find("link") is not None:
        return canonical
    inner = (nested for nested in model.findall("model") if nested.find(".//link") is not None)
    return next((nested.get("name") or "" for nested in inner), "").strip()


def _add_frames(model: Element, scope: str, found: FlattenedModel) -> None:
    frames, joints = model.findall("frame"), model.findall("joint")
    if len(found.attached_to) + len(frames) + len(joints) > MAX_FRAMES:
        raise ModelError(
            f"the model has more than {MAX_FRAMES} frames and joints; use fewer", slug="sdf.size"
        )
    for element in frames:
        where = f"frame {quote(element.get('name'))}"
        name = read_name(element, where)
        parent = (element.get("attached_to") or "").strip() or MODEL_FRAME
        found.frames.add(name, read_pose(element, where), scope=scope, implied=parent)
        full = to_scoped_name(scope, name)
        found.attached_to.setdefault(full, PoseGraph.full_name(scope, parent))
        if placement := element.get("placement_frame"):
            found.frames.set_placement_frame(full, to_scoped_name(scope, placement))
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


def _add_nested_model(nested: Element, scope: str, found: FlattenedModel) -> str:
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
        found.frames.set_placement_frame(full, PoseGraph.full_name(full, placement))
    if scope in found.static_scopes or parse_flag(read_text(nested, "static")):
        found.static_scopes.add(full)
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
        _map_slug("urdf.joints", slug="sdf.joints"),
        _map_slug("urdf.mass", slug="sdf.mass"),
        _map_slug("urdf.no_links", slug="sdf.no_links"),
        _map_slug("urdf.number", slug="sdf.number"),
        _map_slug("urdf.size", slug="sdf.size"),
        _map_slug("urdf.two_parents", slug="sdf.two_parents"),
        _map_slug("urdf.two_roots", slug="sdf.two_roots"),
    )
)
"""SDF's slugs of faults that URDF and SDF share."""


def read_sdf_model(
    text: str,
    *,
    find_mesh: FindFile = find_no_file,
    allow_missing: bool = False,
    resolve: ResolveInclude = no_includes,
) -> Model:
    """Read a robot; the model's report lists the effect of its tags.

    Args:
        text: SDF with one <model>.
        find_mesh: Finds a mesh by its URI.
        allow_missing: Leave out collisions whose mesh is missing.
        resolve: Finds the text of an included model.

    Raises:
        ModelError: The text is not a valid SDF model.
    """
    report = ParseReport()
    element = _find_model(parse_sdf(text, report), report)
    IncludeExpander(resolve, report).expand(element)
    rename_repeated(element, report)
    if read_pose(element, "model").origin != Origin():
        report.ignored("model: <pose>", "the pose is set by the spawn request")
    if element.get("placement_frame"):
        reason = "the spawn request sets the pose of the model frame"
        report.ignored("model: attribute placement_frame", reason)
    model = read_model_element(element, MeshPolicy(find_mesh, allow_missing), report)
    return msgspec.structs.replace(model, report=report.entries())


def _find_model(sdf: Element, report: ParseReport) -> Element:
    owner = sdf[0] if len(sdf) == 1 and sdf[0].tag == "world" else sdf
    models = owner.findall("model")
    if len(models) != 1 or (len(owner) != 1 and owner is sdf):
        content = ", ".join(f"<{child.tag[:40]}>" for child in list(owner)[:5]) or "nothing"
        raise ModelError(
            f"<{owner.tag}> contains {content}; a robot file contains one <model> and nothing "
            "else; load a world with 'zensim serve --world FILE'",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="sdf.model",
        )
    if owner is not sdf:
        report.suspicious("world", "only its model is read")
    return models[0]


class ModelPart(msgspec.Struct, frozen=True):
    """Links of a model that joints connect, as a model of its own."""

    model: Model
    name: str = ""
    """Scoped name of its root link; empty for the part with the canonical link."""
    origin: Origin = Origin()
    """Pose in the frame of the top model."""


def read_model_element(element: Element, policy: MeshPolicy, report: ParseReport) -> Model:
    """Read a <model> after expanding includes; the model's own report stays empty.

    Raises:
        ModelError: The model is invalid, or joints do not connect its links.
    """
    parts = read_model_parts(element, policy, report)
    if len(parts) > 1:
        raise ModelError(
            f"links {quote_names([part.model.links[0].name for part in parts])} are all roots; "
            "connect them so that one is left",
            slug="sdf.two_roots",
        )
    return parts[0].model


def read_model_parts(
    element: Element, policy: MeshPolicy, report: ParseReport
) -> tuple[ModelPart, ...]:
    """Read a <model> after expanding includes; links that no joint connects are separate parts.

    Raises:
        ModelError: The model is invalid.
    """
    name = read_name(element, "model")
    is_static = read_flag(element, "static", default=False, where="model")
    dynamics = read_dynamics(element, report)
    with _with_sdf_slugs():
        found = flatten_model(element, report)
        trees = split_trees(found, report) if found.links and not is_static else [found]
        parts = []
        for tree in trees:
            is_first = tree is trees[0]
            part_name = name if is_first else f"{name}{SCOPE_SEPARATOR}{tree.links[0].name}"
            own_static = is_static or _is_static_part(tree, report)
            part = _read_part(
                part_name, tree, is_first=is_first, is_static=own_static, policy=policy,
                report=report,
            )  # fmt: skip
            model = msgspec.structs.replace(part.model, dynamics=dynamics)
            parts.append(msgspec.structs.replace(part, model=model))
    return tuple(parts)


def split_trees(found: FlattenedModel, report: ParseReport) -> list[FlattenedModel]:
    """Split a model into the links that joints connect; the first has the canonical link."""
    group = {name: name for name in (WORLD_LINK, *(tag.name for tag in found.links))}

    def find_group(name: str) -> str:
        while group[name] != name:
            group[name] = name = group[group[name]]
        return name

    for joint in leave_out_couplings(found.joints):
        group[find_group(joint.parent)] = find_group(joint.child)
    names: dict[str, set[str]] = {find_group(find_canonical_link(found)): set()}
    for tag in found.links:
        names.setdefault(find_group(tag.name), set()).add(tag.name)
    if len(names) == 1:
        return [found]
    return _make_trees(found, list(names.values()), report)


def _make_trees(
    found: FlattenedModel, groups: list[set[str]], report: ParseReport
) -> list[FlattenedModel]:
    trees = [
        replace(
            found,
            links=[tag for tag in found.links if tag.name in group],
            joints=[
                tag
                for tag in found.joints
                if tag.child in group and tag.parent in (WORLD_LINK, *group)
            ],
            sensors=[tag for tag in found.sensors if tag.link in group],
            plugins=[],
        )
        for group in groups
    ]
    for plugin in found.plugins:
        _find_plugin_owner(plugin, trees).plugins.append(plugin)
    kept = {tag.name for tree in trees for tag in tree.joints}
    for tag in found.joints:
        if tag.name not in kept:
            kind = tag.element.get("type")
            report.suspicious(f"joint {quote(tag.name)}", f"{kind} is not simulated; left out")
    return trees


def _find_plugin_owner(plugin: Element, trees: list[FlattenedModel]) -> FlattenedModel:
    """Find the tree with a joint or a link that a plug-in names; the first without any."""
    words = {(child.text or "").strip() for child in plugin.iter()}
    named = (
        tree
        for tree in trees
        if words & {*(tag.name for tag in tree.joints), *(tag.name for tag in tree.links)}
    )
    return next(named, trees[0])


def _is_static_part(tree: FlattenedModel, report: ParseReport) -> bool:
    """Whether all links are in static nested models; reported if only some are."""
    static = {tag.scope for tag in tree.links if tag.scope in tree.static_scopes}
    is_static = bool(static) and all(tag.scope in static for tag in tree.links)
    for scope in sorted(static) if not is_static else ():
        report.suspicious(f"model {quote(scope)}: <static>", "it moves with its parent model")
    return is_static


def _read_part(
    name: str, tree: FlattenedModel, *, is_first: bool, is_static: bool, policy: MeshPolicy,
    report: ParseReport,
) -> ModelPart:  # fmt: skip
    parts, pivots, origin = _read_links_and_joints(
        name, tree, is_first=is_first, is_static=is_static, policy=policy, report=report
    )
    links = check_links(parts.links, report)
    is_static = is_static or parts.links[0].name == WORLD_LINK
    lumped = reduce_joints(links, normalize_axes(parts.joints, report), report=report)
    if not is_static:
        moving = [joint for joint in lumped.joints if joint.child not in pivots]
        check_moving_parts(lumped.links, moving, report)
    sensors = [_place_sensor(tag, tree, report) for tag in tree.sensors]
    model = make_model(name, lumped, plugins=tree.plugins, sensors=sensors, report=report)
    model = msgspec.structs.replace(model, is_static=is_static)
    return ModelPart(model, "" if is_first else parts.links[0].name, origin)


def _place_sensor(tag: SensorElement, tree: FlattenedModel, report: ParseReport) -> SensorElement:
    """Find the pose, in its link, of a sensor whose <pose> has attributes."""
    pose = tag.element.find("pose")
    if pose is None or not pose.keys():
        return tag
    check_element(pose, POSE, f"sensor {quote(tag.element.get('name'))}, pose", report)
    found = read_pose(tag.element, f"sensor {quote(tag.element.get('name'))}")
    if not found.frame:
        return replace(tag, origin=found.origin)
    scope = tag.link.rpartition(SCOPE_SEPARATOR)[0]
    outer = tree.frames.pose(tree.frames.full_name(scope, found.frame))
    in_link = compose(invert(tree.frames.pose(tag.link)), compose(outer, found.origin))
    return replace(tag, origin=in_link)


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
    name: str, found: FlattenedModel, *, is_first: bool, is_static: bool, policy: MeshPolicy,
    report: ParseReport,
) -> tuple[ParsedModel, frozenset[str], Origin]:  # fmt: skip
    """Read the links and joints of a part, its pivots, and its pose in the top model."""
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
    pivots, origin = frozenset(pivot.name for pivot in joints.pivots), Origin()
    if is_first or any(joint.parent == WORLD_LINK for joint in parts.joints):
        parts = _attach_root(parts, found, report)
    elif parts.links and is_static:
        parts = _attach_to_model_frame(parts, found)
    rooted = order_as_tree(parts)
    if not is_first and rooted.links[0].name not in (WORLD_LINK, MODEL_FRAME):
        origin = found.frames.pose(rooted.links[0].name)
    return rooted, pivots, origin


def _with_default_masses(links: list[Link], report: ParseReport) -> list[Link]:
    if any(link.inertial != Inertial() for link in links):
        return links
    report.suspicious("model", "no link has an <inertial>; SDF's default 1 kg is used")
    return [msgspec.structs.replace(link, inertial=DEFAULT_INERTIAL) for link in links]


def _attach_root(parts: ParsedModel, found: FlattenedModel, report: ParseReport) -> ParsedModel:
    """Add a root link at the model frame, unless the root link is already there."""
    if not parts.links:
        return parts
    if any(joint.parent == WORLD_LINK for joint in parts.joints):
        report.applied(f"link {WORLD_LINK!r}", "the robot is fixed to the world")
        return ParsedModel(parts.name, (Link(WORLD_LINK), *parts.links), parts.joints)
    children = {joint.child for joint in parts.joints}
    roots = [link.name for link in parts.links if link.name not in children]
    canonical = find_canonical_link(found)
    if len(roots) == 1 and canonical != roots[0]:
        report.suspicious(
            f"link {quote(canonical)}", f"canonical, but the root link is {quote(roots[0])}"
        )
    if len(roots) == 1 and found.frames.pose(roots[0]) == Origin():
        return parts
    return _attach_to_model_frame(parts, found)


def _attach_to_model_frame(parts: ParsedModel, found: FlattenedModel) -> ParsedModel:
    children = {joint.child for joint in parts.joints}
    roots = [link.name for link in parts.links if link.name not in children]
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
