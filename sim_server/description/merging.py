"""Fewer triangles: corners in one cell of a grid become one, on the finest grid that will do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zensim.sim_server.description.mesh_formats import Triangles

CELLS = 512
"""On a side of the finest grid; each coarser one has half as many."""
FIRST = 2
"""Halvings of the grid that is tried first: most large meshes need it or a coarser one."""
COARSEST = 5
MAX_TABLE = 1 << 25
"""Cells of a grid whose corners are looked up; those of a finer one are sorted."""

Faces = NDArray[np.int64]
Places = NDArray[np.int32]


def fewer(triangles: Triangles, most: int) -> Triangles:
    """Merge corners until few enough triangles are left; where nothing else helps, cut some off."""
    if len(triangles.faces) <= most:
        return triangles
    places = _places(triangles.vertices)
    halvings, faces = FIRST, _merged(places, triangles.faces, FIRST)
    while len(faces) > most and halvings < COARSEST:
        halvings += 1
        faces = _merged(places, faces, halvings)
    if halvings == FIRST:
        faces = _finest(places, triangles.faces, faces, most)
    return _compact(triangles.vertices, faces[:most])


def _finest(places: Places, faces: Faces, found: Faces, most: int) -> Faces:
    """Go on to finer grids while few enough triangles are left."""
    for halvings in range(FIRST - 1, -1, -1):
        if len(found) > most:
            break
        finer = _merged(places, faces, halvings)
        if len(finer) > most:
            break
        found = finer
    return found


def _places(vertices: NDArray[np.float64]) -> Places:
    """Find the cell of each corner in the finest grid."""
    low = vertices.min(axis=0)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9) / CELLS
    places: Places = np.floor((vertices - low) / size).astype(np.int32)
    return places


def _merged(places: Places, faces: Faces, halvings: int) -> Faces:
    """Name the first corner of its cell for each; leave out what is no triangle then."""
    side = (CELLS >> halvings) + 1
    used = _used(faces, len(places))
    x, y, z = (places[used] >> halvings).T.astype(np.int64)
    cell = (x * side + y) * side + z
    first = np.zeros(len(places), np.int64)
    first[used] = _first_of_each(cell, used, side**3)
    a, b, c = new = first[faces].T
    kept: Faces = new.T[(a != b) & (b != c) & (a != c)]
    return kept


def _first_of_each(cells: NDArray[np.int64], corners: NDArray[np.int64], count: int) -> Faces:
    """Find for each corner the first that is in its cell."""
    if count > MAX_TABLE:
        _, firsts, which = np.unique(cells, return_index=True, return_inverse=True)
        sorted_out: Faces = corners[firsts][which]
        return sorted_out
    table = np.empty(count, np.int32)
    table[cells[::-1]] = corners[::-1]  # the last that is written stays
    return table[cells].astype(np.int64)


def _used(faces: Faces, count: int) -> NDArray[np.int64]:
    is_used = np.zeros(count, dtype=bool)
    is_used[faces.reshape(-1)] = True
    return np.flatnonzero(is_used)


def _compact(vertices: NDArray[np.float64], faces: Faces) -> Triangles:
    used = _used(faces, len(vertices))
    number = np.zeros(len(vertices), np.int64)
    number[used] = np.arange(len(used))
    return Triangles(vertices[used], number[faces])
