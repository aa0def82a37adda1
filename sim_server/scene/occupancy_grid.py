"""Occupancy of the floor: the cells that fixed collisions cover within a band of heights."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import FloatArray, conjugate, rotate
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges
from zensim.sim_server.scene.level_sections import (
    ROUND_KINDS,
    SectionEdges,
    ShapeBounds,
    bound_shapes,
    find_sections,
)
from zensim.sim_server.scene.ray_casting import PlacedShapes

FREE, OCCUPIED = 0, 100
MAX_CELLS = 1 << 24
MARGIN_M = 1.0
"""Free floor around what is occupied."""
POINTS_PER_CELL = 8
"""Points of an edge per cell; a cell cut by less than this part of its side may be left out."""
SHAPES_PER_TURN = 32
MAX_LAYERS = 16
"""Heights at which leaning faces are drawn, at most."""


class GridTooLarge(Exception):
    """The grid would have too many cells; the message says its size."""


@dataclass(frozen=True)
class GridFrame:
    """Place of a grid.

    Attributes:
        corner: (2,) lower corner of cell (0, 0) [m].
        resolution_m: Side of a cell.
        width: Cells along x.
        height: Cells along y.
    """

    corner: FloatArray
    resolution_m: float
    width: int
    height: int


@dataclass
class OccupancyDrawing:
    """A grid that is drawn shape by shape.

    Attributes:
        cells: (height, width), int8.
    """

    frame: GridFrame
    cells: npt.NDArray[np.int8]
    _shapes: PlacedShapes
    _bounds: ShapeBounds
    _band: tuple[float, float]

    def draw(self) -> Iterator[None]:
        """Draw some shapes in each step."""
        for start in range(0, len(self._bounds.shape), SHAPES_PER_TURN):
            rows = np.arange(start, min(start + SHAPES_PER_TURN, len(self._bounds.shape)))
            self._mark(
                _list_outline_points(self._shapes, self._bounds.shape[rows], self._band, self.frame)
            )
            for row in rows.tolist():
                self._fill(row)
            yield

    def _mark(self, points: FloatArray) -> None:
        """Occupy the cells of points (p, 2)."""
        column, row = np.floor((points - self.frame.corner) / self.frame.resolution_m).astype(int).T
        is_in = (column >= 0) & (row >= 0) & (column < self.frame.width) & (row < self.frame.height)
        self.cells[row[is_in], column[is_in]] = OCCUPIED

    def _fill(self, row: int) -> None:
        """Occupy the cells whose centres are in a box or a round shape, at any height of a few."""
        if self._bounds.kind[row] not in ("box", *ROUND_KINDS):
            return
        centre, extent = self._bounds.centres[row], self._bounds.extents[row]
        low = max(self._band[0], centre[2] - extent[2])
        high = min(self._band[1], centre[2] + extent[2])
        frame = self.frame
        first = np.floor((centre[:2] - extent[:2] - frame.corner) / frame.resolution_m).astype(int)
        last = np.ceil((centre[:2] + extent[:2] - frame.corner) / frame.resolution_m).astype(int)
        columns, rows = (np.arange(a, b) for a, b in zip(first, last, strict=True))
        x, y = np.meshgrid(columns, rows)
        flat = frame.corner + (np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5) * frame.resolution_m
        for height in np.unique([low, (low + high) / 2.0, high]).tolist():
            points = np.column_stack([flat, np.full(len(flat), height)])
            self._mark(flat[_are_inside(self._shapes, int(self._bounds.shape[row]), points)])


def plan_grid(
    shapes: PlacedShapes,
    numbers: IntArray,
    band: tuple[float, float],
    resolution_m: float,
    max_cells: int = MAX_CELLS,
) -> OccupancyDrawing:
    """Plan the grid of some shapes.

    Args:
        shapes: In the world.
        numbers: Indices of those to draw; planes are left out.
        band: Lowest and highest height [m].
        resolution_m: Side of a cell.
        max_cells: Of the grid.

    Raises:
        GridTooLarge: It would have too many cells.
    """
    bounds = bound_shapes(shapes, numbers)
    low, high = bounds.centres - bounds.extents, bounds.centres + bounds.extents
    is_drawn = (bounds.kind != "plane") & (low[:, 2] <= band[1]) & (high[:, 2] >= band[0])
    chosen = np.flatnonzero(is_drawn)
    bounds, low, high = bounds.take(chosen), low[chosen], high[chosen]
    corner = (
        np.floor((low[:, :2].min(axis=0, initial=0.0) - MARGIN_M) / resolution_m) * resolution_m
    )
    extent = high[:, :2].max(axis=0, initial=0.0) + MARGIN_M - corner
    width, height = np.ceil(extent / resolution_m).tolist()
    if width * height > max_cells:
        raise GridTooLarge(
            f"{width:.0f} x {height:.0f} cells of {resolution_m:g} m; at most {max_cells}"
        )
    frame = GridFrame(corner, resolution_m, int(width), int(height))
    cells = np.full((frame.height, frame.width), FREE, np.int8)
    return OccupancyDrawing(frame, cells, shapes, bounds, band)


def _list_outline_points(
    shapes: PlacedShapes, numbers: IntArray, band: tuple[float, float], frame: GridFrame
) -> FloatArray:
    """List points (p, 2) on the edges of sections, closer than the cells are wide."""
    edges = find_sections(shapes, numbers, band)
    low, high = np.maximum(edges.low, band[0]), np.minimum(edges.high, band[1])
    points = [np.zeros((0, 2))]
    for share in np.linspace(0.0, 1.0, _count_layers(edges, high - low, frame)).tolist():
        ends = edges.cut_at(low + share * (high - low))
        along = ends[:, 1] - ends[:, 0]
        lengths = np.hypot(along[:, 0], along[:, 1])
        counts = np.ceil(lengths * POINTS_PER_CELL / frame.resolution_m).astype(np.intp) + 1
        edge, number = expand_ranges(np.zeros(len(counts), np.intp), counts)
        at = number / np.maximum(counts - 1, 1)[edge]
        points.append(ends[edge, 0] + at[:, None] * along[edge])
    return np.concatenate(points)


def _count_layers(edges: SectionEdges, heights: FloatArray, frame: GridFrame) -> int:
    """Find how many heights to draw: one for upright walls, more for faces that lean."""
    shifts = np.abs(edges.slopes).max(axis=(1, 2), initial=0.0) * heights
    return 1 + min(int(np.ceil(shifts.max(initial=0.0) / frame.resolution_m)), MAX_LAYERS)


def _are_inside(shapes: PlacedShapes, number: int, points: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether points (p, 3) are inside a box or a round shape."""
    pose = shapes.poses[number]
    local = rotate(conjugate(pose[3:]), points - pose[:3])
    shape = shapes.geometries[shapes.geometry[number]].shape
    if shape.kind == "box":
        return np.asarray((np.abs(local) <= np.array(shape.size) / 2.0).all(axis=1))
    radius, length, _ = shape.size
    across = np.hypot(local[:, 0], local[:, 1])
    if shape.kind == "cylinder":
        return np.asarray((across <= radius) & (np.abs(local[:, 2]) <= length / 2.0))
    half = length / 2.0 if shape.kind == "capsule" else 0.0
    beyond = np.maximum(np.abs(local[:, 2]) - half, 0.0)
    return np.asarray(np.hypot(across, beyond) <= radius)
