"""Joints of SDF models as chains of joints with one number each, placed where their child is.

A joint's axis runs through the joint's own frame, which need not be that of its child: then a
massless pivot link stands there, and the child is fixed to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Joint, JointKind, Link, Mimic, Origin, Vec3
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.sdf_frames import MODEL, Frames, inverse
from zensim.sim_server.description.sdf_includes import VERSION_MARK
from zensim.sim_server.description.sdf_values import (
    read_bound,
    read_flag,
    read_scalar,
    read_text,
    read_vector,
)
from zensim.sim_server.description.transforms import compose, turned
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import Report

UNLIMITED = 1e15
"""SDF writes 1e16 where there is no limit."""
REACH_M = 1e5
"""How far a joint slides that has no limit: the size of the world."""
MANY_TURNS_RAD = 1e6
NEAR_M = 1e-5
"""Files round their angles: by this much a joint may miss its child's origin."""
X: Vec3 = (1.0, 0.0, 0.0)
Y: Vec3 = (0.0, 1.0, 0.0)
Z: Vec3 = (0.0, 0.0, 1.0)
SINGLE = ("revolute", "continuous", "prismatic")
DOUBLE = ("universal", "revolute2")
KINDS = ("fixed", *SINGLE, "ball", *DOUBLE)
IN_MODEL_FRAME = ("1.0", "1.2", "1.3", "1.4")
"""Versions whose axes are given in the model's frame."""


@dataclass(frozen=True)
class JointTag:
    """A <joint>, the scope it is in, its scoped name, its frame, and the links it joins."""

    element: Element
    scope: str
    name: str
    frame: str
    parent: str
    child: str
    is_turned: bool = False
    """The file has parent and child the other way round."""


@dataclass
class JointReader:
    """Reads joints of one top model; links that chains need are gathered in `pivots`."""

    frames: Frames
    report: Report
    taken: set[str]
    pivots: list[Link] = field(default_factory=list)

    def read(self, tag: JointTag) -> list[Joint]:
        """Read a joint as a chain from its parent to its child.

        Raises:
            ModelError: Its type is not simulated, or a number is none.
        """
        kind = (tag.element.get("type") or "").strip()
        if kind not in KINDS:
            raise ModelError(
                f"joint {shown(tag.name)} has type {shown(kind)}; use one of {', '.join(KINDS)}",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="sdf.joint_type",
            )
        parent = Origin() if tag.parent == "world" else self.frames.pose(tag.parent)
        child, joint = self.frames.pose(tag.child), self.frames.pose(tag.frame)
        start = compose(inverse(parent), child)
        if kind == "fixed":
            return [Joint(tag.name, "fixed", tag.parent, tag.child, start)]
        steps = self._steps(tag, kind, child)
        offset = compose(inverse(child), joint).position
        if not _moves_pivot(steps, offset):
            offset = (0.0, 0.0, 0.0)
        if len(steps) > 1:
            self.report.applied(
                f"joint {shown(tag.name)}", f"{kind}: {len(steps)} joints in a chain"
            )
        return self._chain(tag, steps, start, offset)

    def _chain(
        self, tag: JointTag, steps: Sequence[Joint], start: Origin, offset: Vec3
    ) -> list[Joint]:
        chain: list[Joint] = []
        parent, origin = tag.parent, compose(start, Origin(offset))
        is_offset = any(offset)
        for number, step in enumerate(steps, start=1):
            is_last = number == len(steps)
            child = tag.child if is_last and not is_offset else self._pivot(tag.name)
            name = tag.name if is_last else self._free(f"{tag.name}_{number}")
            chain.append(
                msgspec.structs.replace(step, name=name, parent=parent, child=child, origin=origin)
            )
            parent, origin = child, Origin()
        if is_offset:
            back = Origin((-offset[0], -offset[1], -offset[2]))
            held = self._free(f"{tag.name}_held")
            chain.append(Joint(held, "fixed", parent, tag.child, back))
        return chain

    def _steps(self, tag: JointTag, kind: str, child: Origin) -> list[Joint]:
        if kind == "ball":
            # Rolling, about y, comes first: a chain sticks when its middle turns by a quarter.
            return [_step("continuous", axis) for axis in (Y, Z, X)]
        tags = ("axis", "axis2") if kind in DOUBLE else ("axis",)
        steps = [self._step(tag, name, kind, child) for name in tags]
        return steps[::-1] if tag.is_turned else steps

    def _step(self, tag: JointTag, name: str, kind: str, child: Origin) -> Joint:
        where = f"joint {shown(tag.name)}, {name}"
        axis = tag.element.find(name)
        if axis is None:
            if kind in SINGLE:
                self.report.suspicious(f"joint {shown(tag.name)}", "has no <axis>; 0 0 1 is used")
            axis = _empty(tag.element)
        lower = read_bound(axis, "limit/lower", -UNLIMITED, where)
        upper = read_bound(axis, "limit/upper", UNLIMITED, where)
        is_free = kind == "continuous" or (lower <= -UNLIMITED and upper >= UNLIMITED)
        reach = REACH_M if kind == "prismatic" else MANY_TURNS_RAD
        moves: JointKind = "prismatic" if kind == "prismatic" else "revolute"
        return msgspec.structs.replace(
            _step("continuous" if is_free and moves == "revolute" else moves, Z),
            axis=self._direction(tag, axis, child, where),
            lower=0.0 if is_free and moves == "revolute" else max(lower, -reach),
            upper=0.0 if is_free and moves == "revolute" else min(upper, reach),
            effort=_limit(read_bound(axis, "limit/effort", -1.0, where)),
            velocity=_limit(read_bound(axis, "limit/velocity", -1.0, where)),
            damping=read_scalar(axis, "dynamics/damping", 0.0, where),
            friction=read_scalar(axis, "dynamics/friction", 0.0, where),
            mimic=_mimic(tag, axis, where),
        )

    def _direction(self, tag: JointTag, axis: Element, child: Origin, where: str) -> Vec3:
        xyz = axis.find("xyz")
        direction = read_vector(axis, "xyz", Z, where)
        frame = ((xyz.get("expressed_in") or "") if xyz is not None else "").strip()
        if not frame and self._is_in_model(tag, axis, where):
            frame = MODEL
        name = self.frames.full_name(tag.scope, frame) if frame else tag.frame
        in_model = turned(self.frames.pose(name), direction)
        x, y, z = turned(Origin(orientation=inverse(child).orientation), in_model)
        # The joint turns the other body by as much the other way.
        return (-x, -y, -z) if tag.is_turned else (x, y, z)

    @staticmethod
    def _is_in_model(tag: JointTag, axis: Element, where: str) -> bool:
        model = tag.element.getparent()
        version = (model.get(VERSION_MARK) or "") if model is not None else ""
        return read_flag(
            axis, "use_parent_model_frame", default=version in IN_MODEL_FRAME, where=where
        )

    def _pivot(self, joint: str) -> str:
        name = self._free(f"{joint}_pivot")
        self.pivots.append(Link(name))
        return name

    def _free(self, wish: str) -> str:
        while wish in self.taken:
            wish += "_"
        self.taken.add(wish)
        return wish


def _step(kind: JointKind, axis: Vec3) -> Joint:
    return Joint("", kind, "", "", axis=axis)


def _limit(number: float) -> float:
    # SDF writes a negative or a huge number for none; here 0 is none.
    return number if 0.0 < number < UNLIMITED else 0.0


def _moves_pivot(steps: Sequence[Joint], offset: Vec3) -> bool:
    """Whether turning happens about another line than one through the child's origin."""
    if len(steps) > 1:
        return math.hypot(*offset) > NEAR_M
    (step,) = steps
    if step.kind == "prismatic":
        return False
    axis = np.array(step.axis)
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return False
    return float(np.linalg.norm(np.cross(axis / length, offset))) > NEAR_M


def _mimic(tag: JointTag, axis: Element, where: str) -> Mimic | None:
    mimic = axis.find("mimic")
    if mimic is None:
        return None
    multiplier = read_scalar(mimic, "multiplier", 1.0, where)
    reference = read_scalar(mimic, "reference", 0.0, where)
    offset = read_scalar(mimic, "offset", 0.0, where) - multiplier * reference
    leader = Frames.full_name(tag.scope, mimic.get("joint") or read_text(mimic, "joint"))
    return Mimic(leader, multiplier, offset)


def _empty(joint: Element) -> Element:
    return joint.makeelement("axis")
