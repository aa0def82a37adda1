"""Meshes of a model for engine and viewer: hulls, split static meshes, decimated visuals.

A moving body collides by the convex hull of each mesh, a static one by the triangles themselves.
The result is binary STL in the file's own scale, named by its sha256.
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
from zensim.sim_server.description.meshes.mesh_formats import Triangles, read_mesh, write_stl
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.proto.messages.model_messages import Link, Model, Shape

GRID_CELLS = 512
"""On a side of the finest grid; each coarser one has half as many."""
FIRST_HALVINGS = 2
"""Halvings of the grid that is tried first: most large meshes need it or a coarser one."""
MAX_HALVINGS = 5
MAX_TABLE_CELLS = 1 << 25
"""Cells of a grid whose corners are looked up; those of a finer one are sorted."""

Faces = NDArray[np.int64]
CellIndices = NDArray[np.int32]


def decimate(triangles: Triangles, most: int) -> Triangles:
    """Merge corners until few enough triangles are left; where nothing else helps, cut some off."""
    if len(triangles.faces) <= most:
        return triangles
    places = _find_cells(triangles.vertices)
    halvings, faces = FIRST_HALVINGS, _merge_corners(places, triangles.faces, FIRST_HALVINGS)
    while len(faces) > most and halvings < MAX_HALVINGS:
        halvings += 1
        faces = _merge_corners(places, faces, halvings)
    if halvings == FIRST_HALVINGS:
        faces = _try_finer_grids(places, triangles.faces, faces, most)
    return _compact(triangles.vertices, faces[:most])


def _try_finer_grids(places: CellIndices, faces: Faces, found: Faces, most: int) -> Faces:
    """Go on to finer grids while few enough triangles are left."""
    for halvings in range(FIRST_HALVINGS - 1, -1, -1):
        if len(found) > most:
            break
        finer = _merge_corners(places, faces, halvings)
        if len(finer) > most:
            break
        found = finer
    return found


def _find_cells(vertices: NDArray[np.float64]) -> CellIndices:
    """Find the cell of each corner in the finest grid."""
    low = vertices.min(axis=0)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9) / GRID_CELLS
    places: CellIndices = np.floor((vertices - low) / size).astype(np.int32)
    return places


def _merge_corners(places: CellIndices, faces: Faces, halvings: int) -> Faces:
    """Name the first corner of its cell for each; leave out what is no triangle then."""
    side = (GRID_CELLS >> halvings) + 1
    used = _find_used_corners(faces, len(places))
    x, y, z = (places[used] >> halvings).T.astype(np.int64)
    cell = (x * side + y) * side + z
    first = np.zeros(len(places), np.int64)
    first[used] = _first_in_cell(cell, used, side**3)
    a, b, c = new = first[faces].T
    kept: Faces = new.T[(a != b) & (b != c) & (a != c)]
    return kept


def _first_in_cell(cells: NDArray[np.int64], corners: NDArray[np.int64], count: int) -> Faces:
    """Find for each corner the first that is in its cell."""
    if count > MAX_TABLE_CELLS:
        _, firsts, which = np.unique(cells, return_index=True, return_inverse=True)
        sorted_out: Faces = corners[firsts][which]
        return sorted_out
    table = np.empty(count, np.int32)
    table[cells[::-1]] = corners[::-1]  # the last that is written stays
    return table[cells].astype(np.int64)


def _find_used_corners(faces: Faces, count: int) -> NDArray[np.int64]:
    is_used = np.zeros(count, dtype=bool)
    is_used[faces.reshape(-1)] = True
    return np.flatnonzero(is_used)


def _compact(vertices: NDArray[np.float64], faces: Faces) -> Triangles:
    used = _find_used_corners(faces, len(vertices))
    number = np.zeros(len(vertices), np.int64)
    number[used] = np.arange(len(used))
    return Triangles(vertices[used], number[faces])


Points = NDArray[np.float64]
MeshFiles = dict[str, tuple[str, bytes | None]]
"""By mesh URI: sha256 and bytes."""

MAX_HULL_CORNERS = 96
MAX_STATIC_TRIANGLES = 20_000
"""Triangles of a static collision."""
MAX_STATIC_TRIANGLES_OF_MODEL = 300_000
"""Triangles of all static collisions of a model."""
MAX_PIECE_TRIANGLES = 2_500
"""Triangles that the engine takes in a few milliseconds: a static mesh is cut into such pieces."""
MAX_VISUAL_TRIANGLES = 20_000
"""Triangles of a visual: 1 MB, which is sent in one piece."""
MAX_EXACT_HULL_POINTS = 128
"""Above, a hull is made of the outstanding ones only."""
POINTS_PER_CHUNK = 1 << 11
"""Points whose reach in all directions is found at once: what fits near the core."""
FLAT_RATIO = 1e-4
"""Thickness over width."""


@dataclass
class MeshConversions:
    """What was made of files so far; models that share files share it.

    Attributes:
        meshes: Bytes by sha256.
        known: Names of what was made, by the file's sha256, the purpose, and the most triangles.
    """

    meshes: dict[str, bytes] = field(default_factory=dict)
    known: dict[tuple[str, str, int], tuple[str, ...]] = field(default_factory=dict)


@dataclass
class _ModelConversion:
    files: dict[str, tuple[str, bytes]]
    purpose: str
    """Of collisions."""
    most: int
    """Triangles of a static collision."""
    conversions: MeshConversions
    notes: list[ReportEntry] = field(default_factory=list)
    read: dict[str, Triangles] = field(default_factory=dict)


def convert_meshes(
    model: Model, files: dict[str, tuple[str, bytes]], conversions: MeshConversions
) -> Model:
    """Replace each mesh's URI by the sha256 of what was made of it, which is in `conversions`.

    Raises:
        ModelError: A collision's mesh cannot be read.
    """
    if not list_mesh_uris(model):
        return model
    solid = sum(shape.kind == "mesh" for link in model.links for shape in link.collisions)
    most = min(MAX_STATIC_TRIANGLES, MAX_STATIC_TRIANGLES_OF_MODEL // max(1, solid))
    made = _ModelConversion(files, "soup" if model.is_static else "hull", most, conversions)
    links = tuple(_convert_link(link, made) for link in model.links)
    return msgspec.structs.replace(model, links=links, report=(*model.report, *made.notes))


def list_mesh_uris(model: Model) -> tuple[str, ...]:
    """List the files that a model names, each once."""
    shapes = (shape for link in model.links for shape in (*link.collisions, *link.visuals))
    return tuple(dict.fromkeys(shape.mesh for shape in shapes if shape.kind == "mesh"))


def _convert_link(link: Link, made: _ModelConversion) -> Link:
    collisions = (_convert_collision(shape, made) for shape in link.collisions)
    visuals = (_convert_visual(link.name, shape, made) for shape in link.visuals)
    return msgspec.structs.replace(
        link,
        collisions=tuple(chain.from_iterable(collisions)),
        visuals=tuple(visual for visual in visuals if visual is not None),
    )


def _convert_collision(shape: Shape, made: _ModelConversion) -> tuple[Shape, ...]:
    return (shape,) if shape.kind != "mesh" else _convert_shape(shape, made.purpose, made)


def _convert_visual(link: str, shape: Shape, made: _ModelConversion) -> Shape | None:
    if shape.kind != "mesh":
        return shape
    try:
        return _convert_shape(shape, "drawn", made)[0]
    except ModelError as error:
        made.notes.append(
            ReportEntry("suspicious", f"link {quote(link)}", f"{error.message}; not drawn")
        )
        return None


def _convert_shape(shape: Shape, purpose: str, made: _ModelConversion) -> tuple[Shape, ...]:
    source, data = made.files[shape.mesh]
    key = (source, purpose, made.most if purpose == "soup" else 0)
    if (names := made.conversions.known.get(key)) is None:
        if source not in made.read:
            made.read[source] = read_mesh(shape.mesh, data)
        if purpose == "soup":
            _report_decimation(shape.mesh, len(made.read[source].faces), made)
        parts = CONVERSIONS[purpose](made.read[source], made.most)
        stls = {sha256(stl).hexdigest(): stl for stl in map(write_stl, parts)}
        made.conversions.meshes.update(stls)
        names = made.conversions.known[key] = tuple(stls)
    return tuple(msgspec.structs.replace(shape, mesh=name) for name in names)


def _report_decimation(uri: str, count: int, made: _ModelConversion) -> None:
    if count > made.most:
        fault = f"has {count} triangles, of which {made.most} at most collide; corners are merged"
        made.notes.append(ReportEntry("suspicious", f"mesh {quote(uri)}", fault))


def convex_hull(triangles: Triangles) -> Triangles:
    """Wrap the corners; of many, those that stand out most in directions spread over a sphere."""
    is_used = np.zeros(len(triangles.vertices), dtype=bool)
    is_used[triangles.faces] = True
    points = triangles.vertices[is_used]
    if len(points) > MAX_EXACT_HULL_POINTS:
        points = _select_extreme_points(points, MAX_EXACT_HULL_POINTS)
    hull = _make_hull(_thicken(points))
    if len(hull.vertices) > MAX_HULL_CORNERS:
        hull = _make_hull(_select_extreme_points(hull.vertices, MAX_HULL_CORNERS))
    return hull


def _thicken(points: Points) -> Points:
    """Give a flat or thin mesh, which has no hull, a thousandth of its reach on all sides."""
    spread = points - points.mean(axis=0)
    thinnest, _, widest = np.sqrt(np.maximum(np.linalg.eigvalsh(spread.T @ spread), 0.0)).tolist()
    if thinnest > FLAT_RATIO * widest:
        return points
    reach = max(float(np.abs(spread).max()), 1e-6) * 1e-3
    corners = np.array(np.meshgrid(*[[-reach, reach]] * 3)).T.reshape(-1, 3)
    thick: Points = (points[:, None, :] + corners[None, :, :]).reshape(-1, 3)
    return thick


def _make_hull(points: Points) -> Triangles:
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


def _select_extreme_points(points: Points, count: int) -> Points:
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    ring = np.sqrt(1.0 - z * z)
    directions = np.stack([ring * np.cos(turns), ring * np.sin(turns), z], axis=1)
    even = (points / np.maximum(np.ptp(points, axis=0), 1e-9)).astype(np.float32).T.copy()
    chosen = _find_farthest(even, directions.astype(np.float32))
    found: Points = points[np.unique(chosen)]
    return found


def _find_farthest(
    points: NDArray[np.float32], directions: NDArray[np.float32]
) -> NDArray[np.int64]:
    """Find which of points (3, n) reaches farthest in each direction (m, 3), some at a time."""
    rows = np.arange(len(directions))
    most = np.full(len(directions), -np.inf, np.float32)
    chosen = np.zeros(len(directions), np.int64)
    for start in range(0, points.shape[1], POINTS_PER_CHUNK):
        reaches = directions @ points[:, start : start + POINTS_PER_CHUNK]
        best = np.argmax(reaches, axis=1)
        reach = reaches[rows, best]
        chosen = np.where(reach > most, best + start, chosen)
        most = np.maximum(reach, most)
    return chosen


def split_mesh(triangles: Triangles, most: int) -> list[Triangles]:
    """Cut a mesh in two, across where it is longest, until each piece has few enough triangles."""
    if len(triangles.faces) <= most:
        return [triangles]
    centres = triangles.vertices[triangles.faces].mean(axis=1)
    order = np.argsort(centres[:, np.ptp(centres, axis=0).argmax()], kind="stable")
    halves = np.array_split(triangles.faces[order], 2)
    return [
        piece for half in halves for piece in split_mesh(Triangles(triangles.vertices, half), most)
    ]


CONVERSIONS: dict[str, Callable[[Triangles, int], list[Triangles]]] = {
    "hull": lambda triangles, _: [convex_hull(triangles)],
    "soup": lambda triangles, most: split_mesh(decimate(triangles, most), MAX_PIECE_TRIANGLES),
    "drawn": lambda triangles, _: [decimate(triangles, MAX_VISUAL_TRIANGLES)],
}
