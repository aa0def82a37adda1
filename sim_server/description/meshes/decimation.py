"""Meshes with fewer triangles: corners merged on a grid, or a mesh split into pieces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zensim.sim_server.description.meshes.mesh_triangles import Appearance, Triangles

Faces = NDArray[np.int64]
IntArray = NDArray[np.int64]

GRID_CELLS = 512
"""Cells per side of the finest grid; each coarser grid has half as many."""
FIRST_HALVINGS = 2
"""Halvings of the first grid: most large meshes need it or a coarser one."""
MAX_HALVINGS = 5
MAX_TABLE_CELLS = 1 << 25
"""Maximum size of a lookup table by cell; in finer grids, corners are sorted."""

CellIndices = NDArray[np.int32]


class _MergedFaces(NamedTuple):
    """Triangles (f, 3) after corners were merged, and their numbers before (f,)."""

    faces: Faces
    numbers: IntArray


def decimate(triangles: Triangles, max_count: int) -> Triangles:
    """Merge corners until few enough triangles are left; after the coarsest grid, drop the rest.

    Triangles keep their texture coordinates.
    """
    if len(triangles.faces) <= max_count:
        return triangles
    cells = _find_cells(triangles.vertices)
    halvings, merged = FIRST_HALVINGS, _merge_corners(cells, triangles.faces, FIRST_HALVINGS)
    while len(merged.faces) > max_count and halvings < MAX_HALVINGS:
        halvings += 1
        further = _merge_corners(cells, merged.faces, halvings)
        merged = _MergedFaces(further.faces, merged.numbers[further.numbers])
    if halvings == FIRST_HALVINGS:
        merged = _try_finer_grids(cells, triangles.faces, merged, max_count)
    looks = triangles.appearance
    return _compact(
        triangles.vertices,
        merged.faces[:max_count],
        looks.select(merged.numbers[:max_count]) if looks else None,
    )


def _try_finer_grids(
    cells: CellIndices, faces: Faces, found: _MergedFaces, max_count: int
) -> _MergedFaces:
    for halvings in range(FIRST_HALVINGS - 1, -1, -1):
        if len(found.faces) > max_count:
            break
        finer = _merge_corners(cells, faces, halvings)
        if len(finer.faces) > max_count:
            break
        found = finer
    return found


def _find_cells(vertices: NDArray[np.float64]) -> CellIndices:
    """Find the cell of each corner in the finest grid."""
    low = vertices.min(axis=0)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9) / GRID_CELLS
    cells: CellIndices = np.floor((vertices - low) / size).astype(np.int32)
    return cells


def _merge_corners(cells: CellIndices, faces: Faces, halvings: int) -> _MergedFaces:
    """Replace each corner by the first of its cell; drop degenerate triangles."""
    side = (GRID_CELLS >> halvings) + 1
    used = _find_used_corners(faces, len(cells))
    x, y, z = (cells[used] >> halvings).T.astype(np.int64)
    cell = (x * side + y) * side + z
    first = np.zeros(len(cells), np.int64)
    first[used] = _first_in_cell(cell, used, side**3)
    a, b, c = new = first[faces].T
    numbers = np.flatnonzero((a != b) & (b != c) & (a != c))
    return _MergedFaces(new.T[numbers], numbers)


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


def _compact(
    vertices: NDArray[np.float64], faces: Faces, appearance: Appearance | None
) -> Triangles:
    used = _find_used_corners(faces, len(vertices))
    number = np.zeros(len(vertices), np.int64)
    number[used] = np.arange(len(used))
    return Triangles(vertices[used], number[faces], appearance)


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
