"""Joints of an SDF model, where they make a graph, as a tree: some turned round, some left out."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import replace
from typing import TYPE_CHECKING

from zensim.sim_server.description.wording import shown

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

    from zensim.sim_server.description.report import Report
    from zensim.sim_server.description.sdf_joints import JointTag

COUPLING = ("gearbox", "screw")
"""Types of joints that couple links, which others may hold."""
WORLD = "world"


def as_tree(
    joints: Sequence[JointTag], links: Sequence[str], report: Report
) -> tuple[JointTag, ...]:
    """Direct joints away from the first link where a link is the child of two; note what is lost.

    Joints that cannot be part of a tree otherwise are as they were, for others to refuse.
    """
    held = {joint.child for joint in joints if joint.element.get("type") not in COUPLING}
    holding = [joint for joint in joints if not _only_couples(joint, held)]
    for joint in joints:
        if _only_couples(joint, held):
            kind = joint.element.get("type")
            report.suspicious(f"joint {shown(joint.name)}", f"{kind} is not simulated; left out")
    children = Counter(joint.child for joint in holding)
    has_root = any(joint.parent == WORLD for joint in holding) or set(links) - set(children)
    if not has_root or max(children.values(), default=0) <= 1:
        return tuple(holding)
    return tuple(_directed(_root(holding, links), holding, report))


def _only_couples(joint: JointTag, held: Container[str]) -> bool:
    return joint.element.get("type") in COUPLING and joint.child in held


def _root(joints: Iterable[JointTag], links: Sequence[str]) -> str:
    return WORLD if any(joint.parent == WORLD for joint in joints) else links[0]


def _directed(root: str, joints: Sequence[JointTag], report: Report) -> Iterable[JointTag]:
    ahead, back = _ends(joints)
    reached = {root}
    tree: dict[str, JointTag] = {}
    forward, backward = deque(ahead.get(root, [])), deque(back.get(root, []))
    while forward or backward:
        # A joint is turned round only when nothing else leads to its link.
        joint = forward.popleft() if forward else _turned(backward.popleft())
        if joint.child in reached:
            continue
        reached.add(joint.child)
        tree[joint.name] = joint
        forward.extend(ahead.get(joint.child, []))
        backward.extend(back.get(joint.child, []))
    for joint in joints:
        if joint.name in tree:
            yield tree[joint.name]
        elif joint.child in reached and joint.parent != joint.child:
            report.suspicious(
                f"joint {shown(joint.name)}", "closes a loop of joints; loops are left open"
            )
        else:
            yield joint
    for joint in tree.values():
        if joint.is_turned:
            report.applied(
                f"joint {shown(joint.name)}", f"turned round: it moves {shown(joint.child)}"
            )


def _ends(
    joints: Iterable[JointTag],
) -> tuple[dict[str, list[JointTag]], dict[str, list[JointTag]]]:
    ahead: dict[str, list[JointTag]] = {}
    back: dict[str, list[JointTag]] = {}
    for joint in joints:
        ahead.setdefault(joint.parent, []).append(joint)
        back.setdefault(joint.child, []).append(joint)
    return ahead, back


def _turned(joint: JointTag) -> JointTag:
    return replace(joint, parent=joint.child, child=joint.parent, is_turned=True)
