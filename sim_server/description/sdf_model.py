"""SDF text to Model, by the same parts, lumping and plug-ins as URDF."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from zensim.proto.messages.model_messages import Inertial, Joint, Link, Model, Origin
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.assets import HasMesh, no_meshes
from zensim.sim_server.description.following import with_true_mimics
from zensim.sim_server.description.free_joints import with_chains
from zensim.sim_server.description.lumping import Lumped, lump
from zensim.sim_server.description.part_list import Parts
from zensim.sim_server.description.plugins import read_plugins
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.sdf_dynamics import read_dynamics
from zensim.sim_server.description.sdf_frames import MODEL, inverse
from zensim.sim_server.description.sdf_gather import WORLD, Gathered, canonical_link, gather
from zensim.sim_server.description.sdf_includes import Includes, Resolve, marked, no_includes
from zensim.sim_server.description.sdf_joints import JointReader
from zensim.sim_server.description.sdf_links import DEFAULT, LinkReader
from zensim.sim_server.description.sdf_tree import as_tree
from zensim.sim_server.description.sdf_values import read_flag, read_name, read_pose
from zensim.sim_server.description.sensors import read_sensors
from zensim.sim_server.description.shapes import MeshRule
from zensim.sim_server.description.strict_xml import parse_xml
from zensim.sim_server.description.transforms import compose
from zensim.sim_server.description.tree import in_tree_order
from zensim.sim_server.description.values import check_links, check_moving, with_unit_axes
from zensim.sim_server.description.wording import listed, shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lxml.etree import _Element as Element

MAX_JOINTS = 120
"""Left after lumping, as for URDF."""


class Shared(NamedTuple):
    """A fault that URDF and SDF share, and what it is called in SDF."""

    of_urdf: str
    slug: str


SHARED = {
    fault.of_urdf: fault.slug
    for fault in (
        Shared("urdf.axis", slug="sdf.axis"),
        Shared("urdf.cycle", slug="sdf.cycle"),
        Shared("urdf.dynamics", slug="sdf.dynamics"),
        Shared("urdf.mass", slug="sdf.mass"),
        Shared("urdf.no_links", slug="sdf.no_links"),
        Shared("urdf.number", slug="sdf.number"),
        Shared("urdf.sensor", slug="sdf.sensor"),
        Shared("urdf.size", slug="sdf.size"),
        Shared("urdf.two_parents", slug="sdf.two_parents"),
        Shared("urdf.two_roots", slug="sdf.two_roots"),
    )
}


def read_sdf_model(
    text: str,
    *,
    has_mesh: HasMesh = no_meshes,
    allow_missing: bool = False,
    resolve: Resolve = no_includes,
) -> Model:
    """Read a robot; what became of each tag that matters is in the model's report.

    Args:
        text: SDF with one <model>.
        has_mesh: Whether a mesh URI is on the server; no file is opened here.
        allow_missing: Leave collisions out whose mesh is not on the server.
        resolve: Finds the text of an included model; nothing else is read.

    Raises:
        ModelError: The text is no SDF, or describes what cannot be.
    """
    report = Report()
    element = _only_model(marked(parse_xml(text, root_tag="sdf", slug="sdf"), report), report)
    Includes(resolve, report).expand(element)
    if read_pose(element, "model").origin != Origin():
        report.ignored("model: <pose>", "the pose is that of the spawn request")
    model = model_of(element, MeshRule(has_mesh, allow_missing), report)
    return msgspec.structs.replace(model, report=report.entries())


def _only_model(sdf: Element, report: Report) -> Element:
    owner = sdf[0] if len(sdf) == 1 and sdf[0].tag == "world" else sdf
    models = owner.findall("model")
    if len(models) != 1 or (len(owner) != 1 and owner is sdf):
        held = ", ".join(f"<{child.tag[:40]}>" for child in list(owner)[:5]) or "nothing"
        raise ModelError(
            f"the <{owner.tag}> holds {held}; a robot's holds one <model> and nothing else; "
            "a world is for zensim serve --world",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="sdf.model",
        )
    if owner is not sdf:
        report.suspicious("world", "a robot is spawned without its world: only its model is read")
    return models[0]


def model_of(element: Element, rule: MeshRule, report: Report) -> Model:
    """Read a <model> whose includes were expanded; its report is left empty.

    Raises:
        ModelError: It describes what cannot be.
    """
    name = read_name(element, "model")
    is_static = read_flag(element, "static", default=False, where="model")
    with _faults_of_sdf():
        found = gather(element, report)
        parts, pivots = _parts(name, found, is_static=is_static, rule=rule, report=report)
        check_links(parts.links, report)
        is_static = is_static or parts.links[0].name == WORLD
        lumped = _lumped(parts, report)
        if not is_static:
            moving = [joint for joint in lumped.joints if joint.child not in pivots]
            check_moving(lumped.links, moving, report)
        plugins = read_plugins(found.plugins, lumped, report)
        return Model(
            name=name,
            links=lumped.links,
            joints=lumped.joints,
            frames=lumped.frames,
            drive=plugins.drive,
            joint_state=plugins.joint_state,
            ground_truths=plugins.ground_truths,
            sensors=read_sensors(found.sensors, lumped, report),
            is_static=is_static,
            dynamics=read_dynamics(element, report),
        )


@contextmanager
def _faults_of_sdf() -> Iterator[None]:
    try:
        yield
    except ModelError as error:
        if error.slug not in SHARED:
            raise
        message = error.message.removeprefix(f"{error.slug}: ")
        raise ModelError(message, code=error.code, slug=SHARED[error.slug]) from error


def _parts(
    name: str, found: Gathered, *, is_static: bool, rule: MeshRule, report: Report
) -> tuple[Parts, frozenset[str]]:
    reader = LinkReader(found.frames, rule, report, is_static, found.self_colliding)
    links = [reader.read(tag) for tag in found.links]
    links = links if is_static else _weighed(links, report)
    taken = {link.name for link in links} | {tag.name for tag in found.joints}
    joints = JointReader(found.frames, report, taken)
    # Nothing of a static model moves, whatever its joints say.
    tags = () if is_static else as_tree(found.joints, [link.name for link in links], report)
    chains = [joint for tag in tags for joint in joints.read(tag)]
    parts = Parts(name, (*links, *joints.pivots), tuple(chains))
    rooted = in_tree_order(_rooted(parts, found, is_static=is_static, report=report))
    return rooted, frozenset(pivot.name for pivot in joints.pivots)


def _weighed(links: list[Link], report: Report) -> list[Link]:
    if any(link.inertial != Inertial() for link in links):
        return links
    report.suspicious("model", "no link has an <inertial>; each weighs 1 kg, as by SDF")
    return [msgspec.structs.replace(link, inertial=DEFAULT) for link in links]


def _rooted(parts: Parts, found: Gathered, *, is_static: bool, report: Report) -> Parts:
    """Hang the model from its own frame, unless its root link is there already."""
    if not parts.links:
        return parts
    if any(joint.parent == WORLD for joint in parts.joints):
        report.applied(f"link {WORLD!r}", "it is the world: the robot does not move from its place")
        return Parts(parts.name, (Link(WORLD), *parts.links), parts.joints)
    children = {joint.child for joint in parts.joints}
    roots = [link.name for link in parts.links if link.name not in children]
    canonical = canonical_link(found)
    if len(roots) > 1 and not is_static:
        raise ModelError(
            f"links {listed(roots)} are joined to nothing; join them so that one is left",
            slug="sdf.two_roots",
        )
    if len(roots) == 1 and canonical != roots[0]:
        report.suspicious(
            f"link {shown(canonical)}", f"canonical, but poses are those of {shown(roots[0])}"
        )
    if len(roots) == 1 and found.frames.pose(roots[0]) == Origin():
        return parts
    held = [
        Joint(f"{MODEL} {root}", "fixed", MODEL, root, found.frames.pose(root)) for root in roots
    ]
    return Parts(parts.name, (Link(MODEL), *parts.links), (*held, *parts.joints))


def _lumped(parts: Parts, report: Report) -> Lumped:
    lumped = lump(parts.links, with_unit_axes(parts.joints), kept=frozenset())
    joints = with_true_mimics(lumped.joints, report)
    lumped = with_chains(Lumped(lumped.links, joints, lumped.frames), report)
    if len(lumped.joints) > MAX_JOINTS:
        raise ModelError(
            f"{len(lumped.joints)} joints are left once fixed ones are merged; "
            f"at most {MAX_JOINTS} are simulated",
            slug="sdf.joints",
        )
    return lumped


def placement_of(element: Element, pose: Origin) -> Origin:
    """Find where a model stands whose <pose> may place one of its frames rather than itself.

    Raises:
        ModelError: That frame does not exist.
    """
    frame = (element.get("placement_frame") or "").strip()
    if not frame:
        return pose
    frames = gather(element, Report()).frames
    return compose(pose, inverse(frames.pose(frames.full_name("", frame))))
