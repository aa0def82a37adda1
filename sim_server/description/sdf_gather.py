"""Everything that an SDF model lists, its nested models too, under scoped names."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from zensim.sim_server.description.sdf_frames import MODEL, Frames, scoped
from zensim.sim_server.description.sdf_grammar import note_tags
from zensim.sim_server.description.sdf_joints import JointTag
from zensim.sim_server.description.sdf_links import LinkTag
from zensim.sim_server.description.sdf_values import read_flag, read_name, read_pose, read_text
from zensim.sim_server.description.sensors import SensorTag
from zensim.sim_server.description.wording import listed, shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import Report

MAX_LINKS = 500
MAX_FRAMES = 5000
WORLD = "world"


@dataclass
class Gathered:
    """What a top model lists.

    Attributes:
        carriers: What each frame, joint and nested model is attached to, by scoped name.
        plugins: Of the top model.
        self_colliding: Scopes of models whose links touch each other.
    """

    frames: Frames = field(default_factory=Frames)
    links: list[LinkTag] = field(default_factory=list)
    joints: list[JointTag] = field(default_factory=list)
    sensors: list[SensorTag] = field(default_factory=list)
    plugins: list[Element] = field(default_factory=list)
    carriers: dict[str, str] = field(default_factory=dict)
    self_colliding: set[str] = field(default_factory=set)

    def link_of(self, name: str, where: str, *, slug: str) -> str:
        """Find the link that carries a scoped name.

        Raises:
            ModelError: There is none.
        """
        links = {tag.name for tag in self.links}
        at, seen = name, set[str]()
        while at not in links:
            if at in seen or at not in self.carriers:
                raise ModelError(
                    f"{where}: {shown(name)} is no link here; links: "
                    f"{listed([tag.name for tag in self.links]) or 'none'}",
                    slug=slug,
                )
            seen.add(at)
            at = self.carriers[at]
        return at


def gather(model: Element, report: Report) -> Gathered:
    """Gather a top model whose includes were expanded.

    Raises:
        ModelError: A name is none, a pose is no numbers, or a joint joins what is not there.
    """
    found = Gathered()
    waiting = [("", model)]
    while waiting:
        scope, element = waiting.pop()
        note_tags(element, scope, report)
        if read_flag(element, "self_collide", default=False, where="model"):
            found.self_colliding.add(scope)
        _gather_links(element, scope, found)
        _gather_frames(element, scope, found)
        waiting += [
            (_nested(nested, scope, found, report), nested) for nested in element.findall("model")
        ]
        found.plugins += [] if scope else element.findall("plugin")
        for plugin in element.findall("plugin") if scope else ():
            report.ignored(
                f"plugin {shown(plugin.get('name'))}", f"in nested model {shown(scope)}; not read"
            )
    _check_unique("link", [tag.name for tag in found.links])
    _check_unique("joint", [tag.name for tag in found.joints])
    # Joints may name what a nested model holds, so these come last.
    found.joints = [_joined(tag, found) for tag in found.joints]
    return found


def _check_unique(what: str, names: list[str]) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ModelError(
            f"{what} names {listed(twice)} are used more than once; make them unique",
            slug="sdf.duplicate_link" if what == "link" else "sdf.duplicate_joint",
        )


def _gather_links(model: Element, scope: str, found: Gathered) -> None:
    for element in model.findall("link"):
        where = f"link {shown(element.get('name'))}"
        name = read_name(element, where)
        full = scoped(scope, name)
        found.frames.add(name, read_pose(element, where), scope=scope, implied=MODEL)
        found.carriers.setdefault(Frames.full_name(scope, MODEL), full)
        found.links.append(LinkTag(element, scope, full))
        found.sensors += [SensorTag(full, sensor) for sensor in element.findall("sensor")]
    canonical = (model.get("canonical_link") or "").strip()
    if canonical:
        found.carriers[Frames.full_name(scope, MODEL)] = scoped(scope, canonical)
    if len(found.links) > MAX_LINKS:
        raise ModelError(
            f"the model has more than {MAX_LINKS} links; at most {MAX_LINKS} are simulated",
            slug="sdf.size",
        )


def _gather_frames(model: Element, scope: str, found: Gathered) -> None:
    frames, joints = model.findall("frame"), model.findall("joint")
    if len(found.carriers) + len(frames) + len(joints) > MAX_FRAMES:
        raise ModelError(
            f"the model has more than {MAX_FRAMES} frames and joints; at most so many are read",
            slug="sdf.size",
        )
    for element in frames:
        where = f"frame {shown(element.get('name'))}"
        name = read_name(element, where)
        holder = (element.get("attached_to") or "").strip() or MODEL
        found.frames.add(name, read_pose(element, where), scope=scope, implied=holder)
        found.carriers.setdefault(scoped(scope, name), Frames.full_name(scope, holder))
    for element in joints:
        where = f"joint {shown(element.get('name'))}"
        name, child = read_name(element, where), read_text(element, "child")
        pose = read_pose(element, where)
        frame = f"{name} (joint)"  # so that a link of the same name does not hide it
        found.frames.add(frame, pose, scope=scope, implied=child)
        found.frames.add(name, pose, scope=scope, implied=child)
        found.carriers.setdefault(scoped(scope, name), scoped(scope, child))
        found.joints.append(
            JointTag(element, scope, scoped(scope, name), scoped(scope, frame), "", "")
        )


def _nested(nested: Element, scope: str, found: Gathered, report: Report) -> str:
    where = f"model {shown(nested.get('name'))}"
    name = read_name(nested, where)
    full = scoped(scope, name)
    if found.frames.has(full):
        raise ModelError(
            f"{where}: another model, link or frame has this name; make them unique",
            slug="sdf.duplicate_name",
        )
    found.frames.add(name, read_pose(nested, where), scope=scope, implied=MODEL)
    if placement := (nested.get("placement_frame") or "").strip():
        found.frames.place_by(full, placement)
    if read_text(nested, "static") in ("true", "1"):
        report.suspicious(f"{where}: <static>", "a nested model moves with the one it is in")
    return full


def _joined(tag: JointTag, found: Gathered) -> JointTag:
    """Give a joint the links that it joins."""
    where = f"joint {shown(tag.name)}"
    parent, child = (read_text(tag.element, end) for end in ("parent", "child"))
    if child == WORLD:
        raise ModelError(
            f"{where} has the world as its child; make it the parent", slug="sdf.unknown_child"
        )
    if parent != WORLD:
        parent = found.link_of(scoped(tag.scope, parent), where, slug="sdf.unknown_parent")
    child = found.link_of(scoped(tag.scope, child), where, slug="sdf.unknown_child")
    return replace(tag, parent=parent, child=child)


def canonical_link(found: Gathered) -> str:
    """Find the link that a top model's frame moves with.

    Raises:
        ModelError: It does not exist.
    """
    return found.link_of(MODEL, "canonical_link", slug="sdf.canonical_link")
