"""Joints of SDF models: chains of single axes, in an order from the root outward."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import (
    MOVABLE_KINDS,
    Joint,
    JointKind,
    Link,
    Mimic,
    Origin,
    Vec3,
)
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.rigid_transforms import compose, conjugate, invert, rotate
from zensim.sim_server.description.joint_reduction import SLIDE_LIMIT_M, X, Y, Z, make_unique_name
from zensim.sim_server.description.parsed_model import MODEL_FRAME, WORLD_LINK
from zensim.sim_server.description.sdf.sdf_frames import PoseGraph
from zensim.sim_server.description.sdf.sdf_rules import VERSION_ATTRIBUTE
from zensim.sim_server.description.sdf.sdf_values import (
    read_bound,
    read_flag,
    read_scalar,
    read_text,
    read_vector,
)
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport


NO_LIMIT = 1e15
"""SDF writes 1e16 for no limit."""
TURN_LIMIT_RAD = 1e6
MAX_STIFFNESS = 1e12
"""[N m/rad or N/m]."""
OFFSET_TOLERANCE_M = 1e-5
"""Distance of a joint's axis from its child's origin that comes from rounded angles."""
DOUBLE_AXIS_KINDS = ("universal", "revolute2")
SDF_JOINT_KINDS = ("fixed", *MOVABLE_KINDS, "ball", *DOUBLE_AXIS_KINDS)
MODEL_FRAME_VERSIONS = ("1.0", "1.2", "1.3", "1.4")
"""Versions whose axes are in the model's frame."""
COUPLING_KINDS = ("gearbox", "screw")
"""Types that couple links which other joints may carry."""


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
            if kind in MOVABLE_KINDS:
                self.report.suspicious(f"joint {quote(tag.name)}", "has no <axis>; 0 0 1 is used")
            axis = tag.element.makeelement("axis")
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
