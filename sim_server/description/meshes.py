"""Meshes that a model names, made fit for the engine and the page: a hull, or fewer triangles.

A moving body collides by the convex hull of each mesh, a static one by the triangles themselves.
What comes out is binary STL in the file's own scale, named by its sha256.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from hashlib import sha256
from itertools import chain
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from zensim.proto.messages.model_messages import ReportEntry
from zensim.sim_server.description.merging import fewer
from zensim.sim_server.description.mesh_formats import Triangles, read_mesh, write_stl
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.proto.messages.model_messages import Link, Model, Shape

Points = NDArray[np.float64]
Files = dict[str, tuple[str, bytes | None]]
"""By mesh URI: sha256 and bytes."""

MAX_HULL_CORNERS = 96
MAX_SOUP = 20_000
"""Triangles of a static collision."""
MAX_SOUP_OF_ALL = 300_000
"""Triangles of all static collisions of a model."""
MAX_PIECE = 2_500
"""Triangles that the engine takes in a few milliseconds: a static mesh is cut into such pieces."""
MAX_DRAWN = 20_000
"""Triangles of a visual: 1 MB, which is sent in one piece."""
MANY_POINTS = 128
"""Above, a hull is made of the outstanding ones only."""
AT_ONCE = 1 << 11
"""Points whose reach in all directions is found at once: what fits near the core."""
FLAT = 1e-4
"""Thickness over width."""


@dataclass
class Conversions:
    """What was made of files so far; models that share files share it.

    Attributes:
        meshes: Bytes by sha256.
        known: Names of what was made, by the file's sha256, the purpose, and the most triangles.
    """

    meshes: dict[str, bytes] = field(default_factory=dict)
    known: dict[tuple[str, str, int], tuple[str, ...]] = field(default_factory=dict)


@dataclass
class _Made:
    files: dict[str, tuple[str, bytes]]
    purpose: str
    """Of collisions."""
    most: int
    """Triangles of a static collision."""
    conversions: Conversions
    notes: list[ReportEntry] = field(default_factory=list)
    read: dict[str, Triangles] = field(default_factory=dict)


def with_meshes(
    model: Model, files: dict[str, tuple[str, bytes]], conversions: Conversions
) -> Model:
    """Replace each mesh's URI by the sha256 of what was made of it, which is in `conversions`.

    Raises:
        ModelError: A collision's mesh cannot be read.
    """
    if not mesh_uris(model):
        return model
    solid = sum(shape.kind == "mesh" for link in model.links for shape in link.collisions)
    most = min(MAX_SOUP, MAX_SOUP_OF_ALL // max(1, solid))
    made = _Made(files, "soup" if model.is_static else "hull", most, conversions)
    links = tuple(_with_meshes(link, made) for link in model.links)
    return msgspec.structs.replace(model, links=links, report=(*model.report, *made.notes))


def mesh_uris(model: Model) -> tuple[str, ...]:
    """List the files that a model names, each once."""
    shapes = (shape for link in model.links for shape in (*link.collisions, *link.visuals))
    return tuple(dict.fromkeys(shape.mesh for shape in shapes if shape.kind == "mesh"))


def _with_meshes(link: Link, made: _Made) -> Link:
    collisions = (_collisions(shape, made) for shape in link.collisions)
    visuals = (_visual(link.name, shape, made) for shape in link.visuals)
    return msgspec.structs.replace(
        link,
        collisions=tuple(chain.from_iterable(collisions)),
        visuals=tuple(visual for visual in visuals if visual is not None),
    )


def _collisions(shape: Shape, made: _Made) -> tuple[Shape, ...]:
    return (shape,) if shape.kind != "mesh" else _converted(shape, made.purpose, made)


def _visual(link: str, shape: Shape, made: _Made) -> Shape | None:
    if shape.kind != "mesh":
        return shape
    try:
        return _converted(shape, "drawn", made)[0]
    except ModelError as error:
        made.notes.append(
            ReportEntry("suspicious", f"link {shown(link)}", f"{error.message}; not drawn")
        )
        return None


def _converted(shape: Shape, purpose: str, made: _Made) -> tuple[Shape, ...]:
    source, data = made.files[shape.mesh]
    key = (source, purpose, made.most if purpose == "soup" else 0)
    if (names := made.conversions.known.get(key)) is None:
        if source not in made.read:
            made.read[source] = read_mesh(shape.mesh, data)
        if purpose == "soup":
            _note_merging(shape.mesh, len(made.read[source].faces), made)
        parts = CONVERSIONS[purpose](made.read[source], made.most)
        stls = {sha256(stl).hexdigest(): stl for stl in map(write_stl, parts)}
        made.conversions.meshes.update(stls)
        names = made.conversions.known[key] = tuple(stls)
    return tuple(msgspec.structs.replace(shape, mesh=name) for name in names)


def _note_merging(uri: str, count: int, made: _Made) -> None:
    if count > made.most:
        fault = f"has {count} triangles, of which {made.most} at most collide; corners are merged"
        made.notes.append(ReportEntry("suspicious", f"mesh {shown(uri)}", fault))


def convex_hull(triangles: Triangles) -> Triangles:
    """Wrap the corners; of many, those that stand out most in directions spread over a sphere."""
    is_used = np.zeros(len(triangles.vertices), dtype=bool)
    is_used[triangles.faces] = True
    points = triangles.vertices[is_used]
    if len(points) > MANY_POINTS:
        points = _outstanding(points, MANY_POINTS)
    hull = _hull(_thickened(points))
    if len(hull.vertices) > MAX_HULL_CORNERS:
        hull = _hull(_outstanding(hull.vertices, MAX_HULL_CORNERS))
    return hull


def _thickened(points: Points) -> Points:
    """Give a flat or thin mesh, which has no hull, a thousandth of its reach on all sides."""
    spread = points - points.mean(axis=0)
    thinnest, _, widest = np.sqrt(np.maximum(np.linalg.eigvalsh(spread.T @ spread), 0.0)).tolist()
    if thinnest > FLAT * widest:
        return points
    reach = max(float(np.abs(spread).max()), 1e-6) * 1e-3
    corners = np.array(np.meshgrid(*[[-reach, reach]] * 3)).T.reshape(-1, 3)
    thick: Points = (points[:, None, :] + corners[None, :, :]).reshape(-1, 3)
    return thick


def _hull(points: Points) -> Triangles:
    try:
        hull = ConvexHull(points)
    except QhullError:
        hull = ConvexHull(points, qhull_options="QJ")
    used, places = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = points[used], places.reshape(-1, 3)
    # Qhull leaves the winding open: turn outwards what looks inwards.
    first, second, third = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    inwards = ((first - vertices.mean(axis=0)) * normals).sum(axis=1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return Triangles(vertices, faces)


def _outstanding(points: Points, count: int) -> Points:
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    ring = np.sqrt(1.0 - z * z)
    directions = np.stack([ring * np.cos(turns), ring * np.sin(turns), z], axis=1)
    even = (points / np.maximum(np.ptp(points, axis=0), 1e-9)).astype(np.float32).T.copy()
    chosen = _farthest(even, directions.astype(np.float32))
    found: Points = points[np.unique(chosen)]
    return found


def _farthest(points: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.int64]:
    """Find which of points (3, n) reaches farthest in each direction (m, 3), some at a time."""
    rows = np.arange(len(directions))
    most = np.full(len(directions), -np.inf, np.float32)
    chosen = np.zeros(len(directions), np.int64)
    for start in range(0, points.shape[1], AT_ONCE):
        reaches = directions @ points[:, start : start + AT_ONCE]
        best = np.argmax(reaches, axis=1)
        reach = reaches[rows, best]
        chosen = np.where(reach > most, best + start, chosen)
        most = np.maximum(reach, most)
    return chosen


def pieces(triangles: Triangles, most: int) -> list[Triangles]:
    """Cut a mesh in two, across where it is longest, until each piece has few enough triangles."""
    if len(triangles.faces) <= most:
        return [triangles]
    centres = triangles.vertices[triangles.faces].mean(axis=1)
    order = np.argsort(centres[:, np.ptp(centres, axis=0).argmax()], kind="stable")
    halves = np.array_split(triangles.faces[order], 2)
    return [piece for half in halves for piece in pieces(Triangles(triangles.vertices, half), most)]


CONVERSIONS: dict[str, Callable[[Triangles, int], list[Triangles]]] = {
    "hull": lambda triangles, _: [convex_hull(triangles)],
    "soup": lambda triangles, most: pieces(fewer(triangles, most), MAX_PIECE),
    "drawn": lambda triangles, _: [fewer(triangles, MAX_DRAWN)],
}
