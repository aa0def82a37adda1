"""Meshes of a model for engine and viewer: hulls, split static meshes, decimated visuals.

A moving body collides by the convex hulls of its meshes, a static one by their triangles. The
results are binary STL in the scale of the file, named by their sha256.
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
"""Cells per side of the finest grid; each coarser grid has half as many."""
FIRST_HALVINGS = 2
"""Halvings of the first grid: most large meshes need it or a coarser one."""
MAX_HALVINGS = 5
MAX_TABLE_CELLS = 1 << 25
"""Maximum size of a lookup table by cell; in finer grids, corners are sorted."""

Faces = NDArray[np.int64]
CellIndices = NDArray[np.int32]


def decimate(triangles: Triangles, max_count: int) -> Triangles:
    """Merge corners until few enough triangles are left; after the coarsest grid, drop the rest."""
    if len(triangles.faces) <= max_count:
        return triangles
    cells = _find_cells(triangles.vertices)
    halvings, faces = FIRST_HALVINGS, _merge_corners(cells, triangles.faces, FIRST_HALVINGS)
    while len(faces) > max_count and halvings < MAX_HALVINGS:
        halvings += 1
        faces = _merge_corners(cells, faces, halvings)
    if halvings == FIRST_HALVINGS:
        faces = _try_finer_grids(cells, triangles.faces, faces, max_count)
    return _compact(triangles.vertices, faces[:max_count])


def _try_finer_grids(cells: CellIndices, faces: Faces, found: Faces, max_count: int) -> Faces:
    for halvings in range(FIRST_HALVINGS - 1, -1, -1):
        if len(found) > max_count:
            break
        finer = _merge_corners(cells, faces, halvings)
        if len(finer) > max_count:
            break
        found = finer
    return found


def _find_cells(vertices: NDArray[np.float64]) -> CellIndices:
    """Find the cell of each corner in the finest grid."""
    low = vertices.min(axis=0)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9) / GRID_CELLS
    cells: CellIndices = np.floor((vertices - low) / size).astype(np.int32)
    return cells


def _merge_corners(cells: CellIndices, faces: Faces, halvings: int) -> Faces:
    """Replace each corner by the first of its cell; drop degenerate triangles."""
    side = (GRID_CELLS >> halvings) + 1
    used = _find_used_corners(faces, len(cells))
    x, y, z = (cells[used] >> halvings).T.astype(np.int64)
    cell = (x * side + y) * side + z
    first = np.zeros(len(cells), np.int64)
    first[used] = _first_in_cell(cell, used, side**3)
    a, b, c = new = first[faces].T
    kept: Faces = new.T[(a != b) & (b != c) & (a != c)]
    return kept


def _first_in_cell(cells: NDArray[np.int64], corners: NDArray[np.int64], count: int) -> Faces:
    """Find for each corner the first corner in its cell."""
    if count > MAX_TABLE_CELLS:
        _, firsts, cell_of = np.unique(cells, return_index=True, return_inverse=True)
        found: Faces = corners[firsts][cell_of]
        return found
    table = np.empty(count, np.int32)
    table[cells[::-1]] = corners[::-1]  # the last value written stays
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
"""Of a static collision."""
MAX_STATIC_TRIANGLES_OF_MODEL = 300_000
"""Of all static collisions of a model."""
MAX_PIECE_TRIANGLES = 2_500
"""The engine loads such a piece of a static mesh in a few milliseconds."""
MAX_VISUAL_TRIANGLES = 20_000
"""1 MB, which is sent in one message."""
MAX_EXACT_HULL_POINTS = 128
"""With more points, the hull is that of extreme points."""
POINTS_PER_CHUNK = 1 << 11
"""Points whose products fit into the processor's cache."""
FLAT_RATIO = 1e-4
"""Thickness over width."""


@dataclass
class MeshConversions:
    """Converted meshes, shared by models that share files.

    Attributes:
        meshes: Bytes by sha256.
        known: sha256 of the results by the file's sha256, the purpose and the maximum count.
    """

    meshes: dict[str, bytes] = field(default_factory=dict)
    known: dict[tuple[str, str, int], tuple[str, ...]] = field(default_factory=dict)


@dataclass
class _ModelConversion:
    files: dict[str, tuple[str, bytes]]
    purpose: str
    """Of collisions."""
    max_count: int
    """Triangles of a static collision."""
    conversions: MeshConversions
    report: list[ReportEntry] = field(default_factory=list)
    read: dict[str, Triangles] = field(default_factory=dict)


def convert_meshes(
    model: Model, files: dict[str, tuple[str, bytes]], conversions: MeshConversions
) -> Model:
    """Convert the meshes of a model; URIs become sha256 of meshes in `conversions`.

    Raises:
        ModelError: A collision's mesh cannot be read.
    """
    if not list_mesh_uris(model):
        return model
    count = sum(shape.kind == "mesh" for link in model.links for shape in link.collisions)
    max_count = min(MAX_STATIC_TRIANGLES, MAX_STATIC_TRIANGLES_OF_MODEL // max(1, count))
    job = _ModelConversion(files, "static" if model.is_static else "hull", max_count, conversions)
    links = tuple(_convert_link(link, job) for link in model.links)
    return msgspec.structs.replace(model, links=links, report=(*model.report, *job.report))


def list_mesh_uris(model: Model) -> tuple[str, ...]:
    """List the mesh URIs of a model, each once."""
    shapes = (shape for link in model.links for shape in (*link.collisions, *link.visuals))
    return tuple(dict.fromkeys(shape.mesh for shape in shapes if shape.kind == "mesh"))


def _convert_link(link: Link, job: _ModelConversion) -> Link:
    collisions = (_convert_collision(shape, job) for shape in link.collisions)
    visuals = (_convert_visual(link.name, shape, job) for shape in link.visuals)
    return msgspec.structs.replace(
        link,
        collisions=tuple(chain.from_iterable(collisions)),
        visuals=tuple(visual for visual in visuals if visual is not None),
    )


def _convert_collision(shape: Shape, job: _ModelConversion) -> tuple[Shape, ...]:
    return (shape,) if shape.kind != "mesh" else _convert_shape(shape, job.purpose, job)


def _convert_visual(link: str, shape: Shape, job: _ModelConversion) -> Shape | None:
    if shape.kind != "mesh":
        return shape
    try:
        return _convert_shape(shape, "visual", job)[0]
    except ModelError as error:
        job.report.append(
            ReportEntry("suspicious", f"link {quote(link)}", f"{error.message}; not drawn")
        )
        return None


def _convert_shape(shape: Shape, purpose: str, job: _ModelConversion) -> tuple[Shape, ...]:
    source, data = job.files[shape.mesh]
    key = (source, purpose, job.max_count if purpose == "static" else 0)
    if (names := job.conversions.known.get(key)) is None:
        if source not in job.read:
            job.read[source] = read_mesh(shape.mesh, data)
        if purpose == "static":
            _report_decimation(shape.mesh, len(job.read[source].faces), job)
        parts = CONVERSIONS[purpose](job.read[source], job.max_count)
        stls = {sha256(stl).hexdigest(): stl for stl in map(write_stl, parts)}
        job.conversions.meshes.update(stls)
        names = job.conversions.known[key] = tuple(stls)
    return tuple(msgspec.structs.replace(shape, mesh=name) for name in names)


def _report_decimation(uri: str, count: int, job: _ModelConversion) -> None:
    if count > job.max_count:
        fault = f"{count} triangles are reduced to {job.max_count} for collisions"
        job.report.append(ReportEntry("suspicious", f"mesh {quote(uri)}", fault))


def convex_hull(triangles: Triangles) -> Triangles:
    """Make the convex hull of the corners; of extreme ones only when there are many."""
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
    """Extend a flat mesh, which has no hull, by a thousandth of its size on all sides."""
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
    # Qhull does not define the winding: flip triangles whose normal points inwards.
    first, second, third = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    inwards = ((first - vertices.mean(axis=0)) * normals).sum(axis=1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return Triangles(vertices, faces)


def _select_extreme_points(points: Points, count: int) -> Points:
    """Select the farthest points in directions on a Fibonacci sphere."""
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
    """Find the index of the farthest of points (3, n) in each direction (m, 3)."""
    rows = np.arange(len(directions))
    farthest = np.full(len(directions), -np.inf, np.float32)
    chosen = np.zeros(len(directions), np.int64)
    for start in range(0, points.shape[1], POINTS_PER_CHUNK):
        products = directions @ points[:, start : start + POINTS_PER_CHUNK]
        best = np.argmax(products, axis=1)
        distances = products[rows, best]
        chosen = np.where(distances > farthest, best + start, chosen)
        farthest = np.maximum(distances, farthest)
    return chosen


def split_mesh(triangles: Triangles, max_count: int) -> list[Triangles]:
    """Split a mesh across its longest side until each piece has few enough triangles."""
    if len(triangles.faces) <= max_count:
        return [triangles]
    centres = triangles.vertices[triangles.faces].mean(axis=1)
    order = np.argsort(centres[:, np.ptp(centres, axis=0).argmax()], kind="stable")
    halves = np.array_split(triangles.faces[order], 2)
    return [
        piece
        for half in halves
        for piece in split_mesh(Triangles(triangles.vertices, half), max_count)
    ]


CONVERSIONS: dict[str, Callable[[Triangles, int], list[Triangles]]] = {
    "hull": lambda triangles, _: [convex_hull(triangles)],
    "static": lambda triangles, count: split_mesh(decimate(triangles, count), MAX_PIECE_TRIANGLES),
    "visual": lambda triangles, _: [decimate(triangles, MAX_VISUAL_TRIANGLES)],
}
