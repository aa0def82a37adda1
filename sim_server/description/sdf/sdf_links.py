"""Links of SDF models: inertia, collisions, visuals and lights, with poses in their link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Decay, Inertial, Light, Link, Origin, Shape
from zensim.proto.rigid_transforms import compose, invert
from zensim.proto.se3 import to_matrix
from zensim.sim_server.description.link_surfaces import to_decay_rate
from zensim.sim_server.description.sdf.sdf_solids import (
    apply_transparency,
    make_ground_slab,
    make_visual_sheet,
    read_colour,
    read_geometry,
    read_light,
    read_surface,
    read_texture,
)
from zensim.sim_server.description.sdf.sdf_values import read_flag, read_pose, read_scalar
from zensim.sim_server.description.strict_parsing import quote

if TYPE_CHECKING:
    from collections.abc import Iterator, Set

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
    from zensim.sim_server.description.report import ParseReport
    from zensim.sim_server.description.sdf.sdf_frames import PoseGraph


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
        mass_kg = read_scalar(inertial, "mass", 1.0, where)
        if (inertial.get("auto") or "").strip().lower() in ("true", "1"):
            fault = f"not found from volume and density; {mass_kg:g} kg is used, write <mass>"
            self.report.suspicious(f"{where}: attribute auto", fault)
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
        return Inertial(mass_kg, origin.position, (ixx, ixy, ixz, iyy, iyz, izz))

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
