"""Mass, centre and moments of SDF links: as written, or from the volumes of their collisions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from zensim.proto.messages.model_messages import Inertial
from zensim.sim_server.description.joint_reduction import Moments, combine_inertials, rotate_moments
from zensim.sim_server.description.meshes.generated_solids import CONE_URI, ELLIPSOID_URI
from zensim.sim_server.description.sdf.sdf_rules import MOMENT_TAGS
from zensim.sim_server.description.sdf.sdf_values import read_scalar
from zensim.sim_server.description.strict_parsing import parse_flag, quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Origin, Shape, Vec3
    from zensim.sim_server.description.meshes.mesh_triangles import FindFile
    from zensim.sim_server.description.report import ParseReport

DEFAULT_MOMENTS: Moments = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
"""SDF's defaults [kg m^2]."""
WATER_KG_M3 = 1000.0
"""SDF's default density."""
CollisionShapes: TypeAlias = "tuple[Element, Sequence[Shape]]"
"""A <collision> and its shapes in the link."""


@dataclass(frozen=True)
class InertiaReader:
    """Reads an <inertial>; with auto="true" the collisions give it, and a <mass> scales it.

    Attributes:
        where: Names the element.
        find_mesh: Finds the meshes of collisions.
        report: Gets what was used.
    """

    where: str
    find_mesh: FindFile
    report: ParseReport

    def read(
        self, inertial: Element, origin: Origin, collisions: Sequence[CollisionShapes]
    ) -> Inertial:
        """Read the element, whose pose in the link is `origin`.

        Raises:
            ModelError: A value is not a number, or a density is not positive.
        """
        owners = (inertial, *(element for element, _ in collisions))
        if parse_flag(inertial.get("auto")):
            if collisions:
                return self._find(inertial, collisions)
            fault = "no effect: the link has no collisions"
            self.report.suspicious(f"{self.where}: attribute auto", fault)
        elif any(owner.find("density") is not None for owner in owners):
            self.report.ignored(f"{self.where}: <density>", 'needs <inertial auto="true">')
        mass_kg = read_scalar(inertial, "mass", 1.0, self.where)
        moments = rotate_moments(self._read_moments(inertial), origin.orientation)
        return Inertial(mass_kg, origin.position, moments)

    def _read_moments(self, inertial: Element) -> Moments:
        matrix = inertial.find("inertia")
        if matrix is None:
            self.report.suspicious(self.where, "has no <inertia>; SDF's default 1 kg m^2 is used")
            return DEFAULT_MOMENTS
        ixx, ixy, ixz, iyy, iyz, izz = (
            read_scalar(matrix, name, default, self.where)
            for name, default in zip(MOMENT_TAGS, DEFAULT_MOMENTS, strict=True)
        )
        return ixx, ixy, ixz, iyy, iyz, izz

    def _find(self, inertial: Element, collisions: Sequence[CollisionShapes]) -> Inertial:
        """Find it from volumes and densities. Source: SDFormat's auto inertials."""
        subject = f"{self.where}: attribute auto"
        of_link = self._read_density(inertial, WATER_KG_M3)
        parts = []
        for element, shapes in collisions:
            density = self._read_density(element, of_link)
            for shape in shapes:
                try:
                    solid, is_closed = measure_solid(shape, self.find_mesh)
                except ModelError:
                    # Its conversion refuses it, or leaves its model out of a world.
                    continue
                if not is_closed:
                    fault = f"mesh of {quote(element.get('name'))} has holes; its hull is measured"
                    self.report.suspicious(subject, fault)
                parts.append((_multiply(solid, density), shape.origin))
        found = combine_inertials(parts)
        if found.mass_kg and inertial.find("mass") is not None:
            mass_kg = read_scalar(inertial, "mass", 1.0, self.where)
            found = _multiply(found, mass_kg / found.mass_kg)
        self.report.applied(subject, f"{found.mass_kg:.4g} kg, from the volumes of collisions")
        return found

    def _read_density(self, owner: Element, default: float) -> float:
        density = read_scalar(owner, "density", default, self.where)
        if density <= 0.0:
            fault = f"density {density:g} kg/m^3 is not positive; that of water is {WATER_KG_M3:g}"
            raise ModelError(f"{self.where}: {fault}", slug="sdf.mass")
        return density


def _multiply(one: Inertial, factor: float) -> Inertial:
    ixx, ixy, ixz, iyy, iyz, izz = (factor * moment for moment in one.inertia)
    return Inertial(factor * one.mass_kg, one.com_in_link, (ixx, ixy, ixz, iyy, iyz, izz))


def measure_solid(shape: Shape, find_mesh: FindFile) -> tuple[Inertial, bool]:
    """Find the inertial of a shape of density 1 kg/m^3 in its own frame.

    Returns:
        The inertial, and whether the surface is closed; if it is not, the inertial is that of the
        convex hull.

    Raises:
        ModelError: A mesh is missing or invalid.
    """
    measure = _SOLIDS.get(shape.mesh or shape.kind)
    if measure is None:
        from zensim.sim_server.description.meshes.mesh_volume import measure_mesh

        return measure_mesh(shape, find_mesh)
    solid = measure(*shape.size)
    x, y, z = (solid.volume * square for square in solid.squares)
    moments = (y + z, 0.0, 0.0, x + z, 0.0, x + y)
    return Inertial(solid.volume, (0.0, 0.0, solid.centre_z), moments), True


class _SolidMeasure(NamedTuple):
    """Volume [m^3], mean squares of x, y and z about the centre [m^2], height of the centre [m]."""

    volume: float
    squares: Vec3
    centre_z: float = 0.0


def _measure_box(x: float, y: float, z: float) -> _SolidMeasure:
    return _SolidMeasure(x * y * z, (x * x / 12.0, y * y / 12.0, z * z / 12.0))


def _measure_ellipsoid(a: float, b: float, c: float) -> _SolidMeasure:
    return _SolidMeasure(4.0 / 3.0 * math.pi * a * b * c, (a * a / 5.0, b * b / 5.0, c * c / 5.0))


def _measure_cylinder(radius: float, length: float, _: float) -> _SolidMeasure:
    across = radius * radius / 4.0
    return _SolidMeasure(math.pi * radius**2 * length, (across, across, length * length / 12.0))


def _measure_capsule(radius: float, length: float, _: float) -> _SolidMeasure:
    """Measure a cylinder and two half balls, whose centres are 3/8 of the radius beyond it."""
    tube, ball = _measure_cylinder(radius, length, 0.0), _measure_ellipsoid(radius, radius, radius)
    volume = tube.volume + ball.volume
    share = ball.volume / volume
    across, along = (
        (1.0 - share) * tube.squares[axis] + share * ball.squares[axis] for axis in (0, 2)
    )
    along += share * (length**2 / 4.0 + 3.0 / 8.0 * radius * length)
    return _SolidMeasure(volume, (across, across, along))


def _measure_cone(radius: float, _: float, length: float) -> _SolidMeasure:
    across = 3.0 / 20.0 * radius * radius
    squares = (across, across, 3.0 / 80.0 * length * length)
    return _SolidMeasure(math.pi / 3.0 * radius**2 * length, squares, -length / 4.0)


_SOLIDS: dict[str, Callable[[float, float, float], _SolidMeasure]] = {
    "box": _measure_box,
    "sphere": lambda radius, _, __: _measure_ellipsoid(radius, radius, radius),
    "cylinder": _measure_cylinder,
    "capsule": _measure_capsule,
    ELLIPSOID_URI: _measure_ellipsoid,
    CONE_URI: _measure_cone,
}
