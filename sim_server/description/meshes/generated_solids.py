"""Ellipsoids and cones as scaled meshes of unit size: no engine of ours has both shapes."""

import math
from collections.abc import Callable, Iterator
from functools import cache

from zensim.proto.messages.model_messages import Shape, Vec3

ELLIPSOID_URI = "zensim://solids/ellipsoid"
"""Unit sphere; scaled by the radii."""
CONE_URI = "zensim://solids/cone"
"""Radius 1, length 1, apex at z = 0.5; scaled by radius, radius, length."""
SUBDIVISIONS = 4
"""Of each edge of an icosahedron: 162 corners, at most 1.8 % inside the sphere, six on the axes."""
CONE_SIDES = 32


def make_ellipsoid(radii: Vec3) -> Shape:
    """Make an ellipsoid with these radii [m] along x, y, z; a sphere if they are equal."""
    if radii[0] == radii[1] == radii[2]:
        return Shape("sphere", (radii[0], 0.0, 0.0))
    return Shape("mesh", radii, mesh=ELLIPSOID_URI)


def make_cone(radius: float, length: float) -> Shape:
    """Make a cone along z: base radius [m], length [m], apex at z = length / 2, as in SDF."""
    return Shape("mesh", (radius, radius, length), mesh=CONE_URI)


def is_generated(uri: str) -> bool:
    """Whether a mesh URI names a mesh of this module, which no file holds."""
    return uri in _SOLIDS


@cache
def list_corners(uri: str) -> tuple[Vec3, ...]:
    """List the corners of a generated mesh, which is their convex hull."""
    return tuple(_SOLIDS[uri]())


def _list_sphere_corners() -> Iterator[Vec3]:
    corners = [
        turned
        for y in (-1.0, 1.0)
        for z in (-1.0, 1.0)
        for turned in _turn_axes((0.0, y, z * (1.0 + math.sqrt(5.0)) / 2.0))
    ]
    edge = min(math.dist(corners[0], other) for other in corners[1:])
    shares = range(SUBDIVISIONS + 1)
    found = {
        _project_to_sphere(
            [(i * a + j * b + (SUBDIVISIONS - i - j) * c) for a, b, c in zip(*face, strict=True)]
        ): None
        for face in _list_faces(corners, edge)
        for i in shares
        for j in shares
        if i + j <= SUBDIVISIONS
    }
    yield from found


def _turn_axes(point: Vec3) -> list[Vec3]:
    x, y, z = point
    return [(x, y, z), (z, x, y), (y, z, x)]


def _list_faces(corners: list[Vec3], edge: float) -> Iterator[tuple[Vec3, Vec3, Vec3]]:
    def are_neighbours(a: Vec3, b: Vec3) -> bool:
        return math.isclose(math.dist(a, b), edge)

    for first, a in enumerate(corners):
        for second, b in enumerate(corners[:first]):
            if are_neighbours(a, b):
                yield from (
                    (a, b, c)
                    for c in corners[:second]
                    if are_neighbours(a, c) and are_neighbours(b, c)
                )


def _project_to_sphere(point: list[float]) -> Vec3:
    length = math.hypot(*point)
    # Rounded, so that a corner on the edge of two faces is one corner.
    x, y, z = (round(part / length, 9) + 0.0 for part in point)
    return (x, y, z)


def _list_cone_corners() -> Iterator[Vec3]:
    yield (0.0, 0.0, 0.5)
    for side in range(CONE_SIDES):
        angle = side * 2.0 * math.pi / CONE_SIDES
        yield (math.cos(angle), math.sin(angle), -0.5)


_SOLIDS: dict[str, Callable[[], Iterator[Vec3]]] = {
    ELLIPSOID_URI: _list_sphere_corners,
    CONE_URI: _list_cone_corners,
}
