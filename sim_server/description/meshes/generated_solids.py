"""Ellipsoids, cones and prisms as scaled meshes: no engine of ours has all these shapes."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache

from zensim.proto.messages.model_messages import Shape, Vec3

ELLIPSOID_URI = "zensim://solids/ellipsoid"
"""Unit sphere; scaled by the radii."""
CONE_URI = "zensim://solids/cone"
"""Radius 1, length 1, apex at z = 0.5; scaled by radius, radius, length."""
Triangle = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
SUBDIVISIONS = 4
"""Parts of an icosahedron's edge: 162 corners, at most 1.8 % inside the sphere, six on the axes."""
CONE_SIDES = 32
PRISM_URI = "zensim://solids/prism/"
"""Followed by x and y [m] of three corners; from z = 0 to 1, scaled by 1, 1, height."""
_PRISM = re.compile(re.escape(PRISM_URI) + r"(-?\d{1,12}(?:\.\d{1,9})?,?){6}")
PRISM_CORNERS = 3
MIN_AREA_M2 = 1e-10


def make_ellipsoid(radii: Vec3) -> Shape:
    """Make an ellipsoid with these radii [m] along x, y, z; a sphere if they are equal."""
    if radii[0] == radii[1] == radii[2]:
        return Shape("sphere", (radii[0], 0.0, 0.0))
    return Shape("mesh", radii, mesh=ELLIPSOID_URI)


def make_cone(radius: float, length: float) -> Shape:
    """Make a cone along z: base radius [m], length [m], apex at z = length / 2, as in SDF."""
    return Shape("mesh", (radius, radius, length), mesh=CONE_URI)


def make_prisms(outline: Sequence[tuple[float, float]], height: float) -> list[Shape]:
    """Make a solid over a simple polygon in x, y [m], from z = 0 to a height [m]: prisms.

    Their number is that of the corners less two; the polygon may be concave and of either sense.
    """
    triangles = [tri for tri in cut_ears(outline) if abs(_find_area(tri)) > MIN_AREA_M2]
    return [
        Shape(
            "mesh",
            (1.0, 1.0, height),
            mesh=PRISM_URI + ",".join(f"{value:.9f}" for corner in tri for value in corner),
        )
        for tri in triangles
    ]


def cut_ears(outline: Sequence[tuple[float, float]]) -> list[Triangle]:
    """Divide a simple polygon into triangles by ear clipping."""
    corners = list(dict.fromkeys(outline))
    edges = zip(corners, corners[1:] + corners[:1], strict=True)
    if sum(ax * by - bx * ay for (ax, ay), (bx, by) in edges) < 0.0:
        corners.reverse()
    found: list[Triangle] = []
    while len(corners) > PRISM_CORNERS:
        at = next((i for i in range(len(corners)) if _is_ear(corners, i)), 0)
        found.append((corners[at - 1], corners[at], corners[(at + 1) % len(corners)]))
        del corners[at]
    return [*found, (corners[0], corners[1], corners[2])] if len(corners) == PRISM_CORNERS else []


def _find_area(triangle: Triangle) -> float:
    (ax, ay), (bx, by), (cx, cy) = triangle
    return ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2.0


def _is_ear(corners: list[tuple[float, float]], at: int) -> bool:
    """Whether a corner is convex, and no other corner is in its triangle."""
    ear = (corners[at - 1], corners[at], corners[(at + 1) % len(corners)])
    if _find_area(ear) <= 0.0:
        return False
    edges = ((ear[0], ear[1]), (ear[1], ear[2]), (ear[2], ear[0]))
    return not any(
        all(_find_area((start, end, other)) >= 0.0 for start, end in edges)
        for other in corners
        if other not in ear
    )


def is_generated(uri: str) -> bool:
    """Whether a mesh URI names a mesh of this module, which no file holds."""
    return uri in _SOLIDS or _PRISM.fullmatch(uri) is not None


@cache
def list_corners(uri: str) -> tuple[Vec3, ...]:
    """List the corners of a generated mesh, which is their convex hull."""
    return tuple(_SOLIDS[uri]() if uri in _SOLIDS else _list_prism_corners(uri))


def _list_prism_corners(uri: str) -> Iterator[Vec3]:
    values = [float(word) for word in uri.removeprefix(PRISM_URI).split(",") if word]
    for x, y in zip(values[::2], values[1::2], strict=True):
        yield from ((x, y, 0.0), (x, y, 1.0))


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
