"""Links of SDF models: inertia, collisions, visuals and lights, with poses in their link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import Decay, Inertial, Light, Link, Origin, Shape
from zensim.proto.rigid_transforms import compose, invert
from zensim.sim_server.description.link_surfaces import to_decay_rate
from zensim.sim_server.description.sdf.sdf_inertia import InertiaReader
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
    from collections.abc import Iterator, Sequence, Set

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
    from zensim.sim_server.description.report import ParseReport
    from zensim.sim_server.description.sdf.sdf_frames import PoseGraph
    from zensim.sim_server.description.sdf.sdf_inertia import CollisionShapes


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
        where, collisions = f"link {quote(tag.name)}", list(self._read_collisions(tag))
        inertial = self._read_inertial(tag, collisions)
        has_gravity = read_flag(tag.element, "gravity", default=True, where=where)
        return Link(
            tag.name,
            inertial,
            tuple(shape for _, shapes in collisions for shape in shapes),
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

    def _read_inertial(self, tag: LinkElement, collisions: Sequence[CollisionShapes]) -> Inertial:
        inertial, where = tag.element.find("inertial"), f"link {quote(tag.name)}, inertial"
        if inertial is None:
            return Inertial()
        origin = self._read_origin(tag, inertial, where)
        reader = InertiaReader(where, self.policy.find_mesh, self.report)
        return reader.read(inertial, origin, collisions)

    def _read_collisions(self, tag: LinkElement) -> Iterator[CollisionShapes]:
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
                yield (
                    element,
                    [
                        msgspec.structs.replace(surface.apply_to_shape(shape), name=name)
                        for shape in shapes
                    ],
                )

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
