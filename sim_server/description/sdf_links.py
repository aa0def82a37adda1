"""Links of SDF models: masses, collisions, visuals, each placed in its link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Decay, Inertial, Link, Origin, Shape
from zensim.sim_server.description.sdf_frames import Frames, inverse
from zensim.sim_server.description.sdf_shapes import (
    colour_of,
    is_here,
    moved,
    read_solid,
    seen_through,
    sheet_of,
    slab_of,
    surface_of,
)
from zensim.sim_server.description.sdf_values import read_flag, read_pose, read_scalar
from zensim.sim_server.description.surface import decay_rate
from zensim.sim_server.description.transforms import compose, matrix_of
from zensim.sim_server.description.wording import shown

if TYPE_CHECKING:
    from collections.abc import Set

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import Report
    from zensim.sim_server.description.shapes import MeshRule

MOMENTS = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
"""What SDF takes where one is not written [kg m^2]."""
DEFAULT = Inertial(mass_kg=1.0, inertia=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
"""What SDF takes for a link without <inertial>."""


@dataclass(frozen=True)
class LinkTag:
    """A <link>, the scoped name of the model that it is in, and its own."""

    element: Element
    scope: str
    name: str


@dataclass(frozen=True)
class LinkReader:
    """Reads links of one top model."""

    frames: Frames
    rule: MeshRule
    report: Report
    is_static: bool
    self_colliding: Set[str] = frozenset()
    """Scopes of models whose links touch each other."""

    def read(self, tag: LinkTag) -> Link:
        """Read a link.

        Raises:
            ModelError: A number is none, a size is not positive, or a collision's mesh is missing.
        """
        where, inertial = f"link {shown(tag.name)}", self._inertial(tag)
        has_gravity = read_flag(tag.element, "gravity", default=True, where=where)
        return Link(
            tag.name,
            inertial,
            tuple(self._collisions(tag)),
            tuple(self._visuals(tag)),
            weightless=Inertial() if has_gravity else inertial,
            decay=Decay(*(self._decay(tag, part) for part in ("linear", "angular"))),
            self_collides=tag.scope in self.self_colliding
            or read_flag(tag.element, "self_collide", default=False, where=where),
        )

    def _decay(self, tag: LinkTag, part: str) -> float:
        where = f"link {shown(tag.name)}"
        share = read_scalar(tag.element, f"velocity_decay/{part}", 0.0, where)
        return decay_rate(max(share, 0.0))

    def _inertial(self, tag: LinkTag) -> Inertial:
        inertial, where = tag.element.find("inertial"), f"link {shown(tag.name)}, inertial"
        if inertial is None:
            return Inertial()
        origin = self._place(tag, inertial, where)
        matrix = inertial.find("inertia")
        if matrix is None:
            self.report.suspicious(where, "has no <inertia>; 1 kg m^2 is used, as by SDF")
            moments = tuple(MOMENTS.values())
        else:
            moments = tuple(read_scalar(matrix, n, d, where) for n, d in MOMENTS.items())
        ixx, ixy, ixz, iyy, iyz, izz = moments
        turn = matrix_of(origin)
        turned = turn @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ turn.T
        ixx, ixy, ixz, _, iyy, iyz, _, _, izz = turned.ravel().tolist()
        return Inertial(
            read_scalar(inertial, "mass", 1.0, where),
            origin.position,
            (ixx, ixy, ixz, iyy, iyz, izz),
        )

    def _collisions(self, tag: LinkTag) -> list[Shape]:
        kept = []
        for element in tag.element.findall("collision"):
            where = _where(tag, element)
            shape = self._shape(tag, element, where)
            if shape is None:
                continue
            if shape.kind == "plane" and not self.is_static:
                self.report.suspicious(where, "a plane collides in static models only; left out")
                continue
            shape = slab_of(shape) if shape.kind == "plane" else shape
            if is_here(shape, where, rule=self.rule, report=self.report, collides=True):
                kept.append(surface_of(element, where, self.report).on(shape))
        return kept

    def _visuals(self, tag: LinkTag) -> list[Shape]:
        kept = []
        for element in tag.element.findall("visual"):
            where = _where(tag, element)
            shape = self._shape(tag, element, where)
            if shape is not None and is_here(
                shape, where, rule=self.rule, report=self.report, collides=False
            ):
                shape = sheet_of(shape) if shape.kind == "plane" else shape
                colour = colour_of(element, where, self.report)
                through = read_scalar(element, "transparency", 0.0, where)
                kept.append(msgspec.structs.replace(shape, rgba=seen_through(colour, through)))
        return kept

    def _shape(self, tag: LinkTag, element: Element, where: str) -> Shape | None:
        origin = self._place(tag, element, where)
        shape = read_solid(element, where, self.report)
        return None if shape is None else moved(shape, origin)

    def _place(self, tag: LinkTag, element: Element, where: str) -> Origin:
        pose = read_pose(element, where)
        if not pose.frame:
            return pose.origin
        outer = self.frames.pose(self.frames.full_name(tag.scope, pose.frame))
        return compose(inverse(self.frames.pose(tag.name)), compose(outer, pose.origin))


def _where(tag: LinkTag, element: Element) -> str:
    return f"link {shown(tag.name)}, {element.tag} {shown(element.get('name'))}"
