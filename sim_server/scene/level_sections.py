"""Cross-sections of boxes and meshes by level planes: edges that move linearly with the height.

Between the heights of two vertices a level plane cuts the same sides of a face, so that both ends
of the cut move linearly with the height. One table of such edges serves every height exactly.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import FloatArray, to_matrix, transform_points
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.ray_casting import PlacedShapes

MIN_SLICE_M = 1e-7
"""Lower slices of a face are left out: their ends would move faster than rounding allows."""
BAND_MARGIN_M = 1e-6
"""Margin within which triangles beyond a band of heights are kept, against rounding."""
MAX_CORNERS = 1 << 20
"""Corners of meshes that are placed at once: bounds the memory."""


ROUND_KINDS = ("sphere", "cylinder", "capsule")
"""Kinds of shapes that have no edges."""


@dataclass(frozen=True)
class ShapeBounds:
    """Bounds of shapes (s,) in the world.

    Attributes:
        shape: (s,) index in `PlacedShapes`.
        kind: (s,) of `Shape`.
        centres: (s, 3).
        extents: (s, 3) half sides [m] of boxes along the world's axes; infinite for planes.
        radii: (s,) of discs in the plane [m].
    """

    shape: IntArray
    kind: npt.NDArray[np.str_]
    centres: FloatArray
    extents: FloatArray
    radii: FloatArray

    def take(self, chosen: IntArray) -> "ShapeBounds":
        """Choose shapes."""
        return ShapeBounds(
            self.shape[chosen],
            self.kind[chosen],
            self.centres[chosen],
            self.extents[chosen],
            self.radii[chosen],
        )


def bound_shapes(shapes: PlacedShapes, numbers: IntArray) -> ShapeBounds:
    """Bound some of the shapes."""
    geometry = shapes.geometry[numbers]
    kind = shapes.kinds[geometry]
    sizes = shapes.sizes[geometry]
    centres, spheres = shapes.bounding_spheres()
    turns = np.abs(to_matrix(shapes.poses[numbers, 3:]))
    extents = np.repeat(spheres[numbers, None], 3, axis=1)
    is_box, is_round = kind == "box", np.isin(kind, ROUND_KINDS)
    extents[is_box] = (turns[is_box] * sizes[is_box, None]).sum(axis=2) / 2.0
    along = turns[:, :, 2]
    half = np.where(kind == "sphere", 0.0, sizes[:, 1:2].T / 2.0)[0]
    across = np.sqrt(np.maximum(1.0 - along * along, 0.0))
    across[kind != "cylinder"] = 1.0
    extents[is_round] = (along * half[:, None] + across * sizes[:, :1])[is_round]
    lean = np.hypot(along[:, 0], along[:, 1])
    radii = np.where(is_round, lean * half + sizes[:, 0], np.hypot(*extents[:, :2].T))
    return ShapeBounds(numbers, kind, centres[numbers], extents, radii)


@dataclass(frozen=True)
class SectionEdges:
    """Edges (e,) of cross-sections with the outside on their right, each for a range of heights.

    A face of a mesh has an edge for each of its two sides.

    Attributes:
        ends: (e, 2, 2) x and y [m] of both ends at the height `low`.
        slopes: (e, 2, 2) change of `ends` per metre of height.
        low: (e,) [m].
        high: (e,) [m].
        shape: (e,) index of the shape in `PlacedShapes`; ascending.
    """

    ends: FloatArray
    slopes: FloatArray
    low: FloatArray
    high: FloatArray
    shape: IntArray

    def __len__(self) -> int:
        return len(self.low)

    def take(self, chosen: IntArray) -> "SectionEdges":
        """Choose edges, which may be repeated."""
        return SectionEdges(
            self.ends[chosen],
            self.slopes[chosen],
            self.low[chosen],
            self.high[chosen],
            self.shape[chosen],
        )

    def cut_at(self, heights: FloatArray) -> FloatArray:
        """Find the ends (e, 2, 2) at heights (e,) or () within the range of each edge."""
        return np.asarray(self.ends + (heights - self.low)[:, None, None] * self.slopes)


def find_sections(
    shapes: PlacedShapes, numbers: IntArray, band: tuple[float, float]
) -> SectionEdges:
    """Find the edges of boxes and meshes that a level plane cuts.

    Args:
        shapes: In the world.
        numbers: Indices of the shapes; those of other kinds are left out.
        band: Lowest and highest height [m]; edges wholly beyond are left out.
    """
    kind = shapes.kinds[shapes.geometry[numbers]]
    parts = [_slice_boxes(shapes, numbers[kind == "box"], band)]
    meshes = numbers[kind == "mesh"]
    for geometry in np.unique(shapes.geometry[meshes]).tolist():
        found = meshes[shapes.geometry[meshes] == geometry]
        parts.append(_slice_mesh(shapes, geometry, found, band))
    edges = _concatenate(parts)
    return edges.take(np.argsort(edges.shape, kind="stable"))


def _slice_boxes(
    shapes: PlacedShapes, numbers: IntArray, band: tuple[float, float]
) -> SectionEdges:
    poses = shapes.poses[numbers]
    axes = np.swapaxes(to_matrix(poses[:, 3:]), 1, 2)
    halves = axes * (shapes.sizes[shapes.geometry[numbers]][:, :, None] / 2.0)
    outward = np.concatenate([halves, -halves], axis=1)
    centres = (poses[:, None, :3] + outward).reshape(-1, 3)
    one, other = (np.tile(np.roll(halves, -i, axis=1), (1, 2, 1)).reshape(-1, 3) for i in (1, 2))
    edges = _slice_parallelograms(centres, one, other, np.repeat(numbers, 6))
    is_kept = _find_in_band(edges, band)
    normals = np.tile(outward.reshape(-1, 3), (3, 1))[is_kept]
    return _turn_outward(edges.take(is_kept), normals)


def _slice_parallelograms(
    centres: FloatArray, one: FloatArray, other: FloatArray, shape: IntArray
) -> SectionEdges:
    """Slice parallelograms (f,) with sides of twice `one` and `other` (f, 3) at their vertices.

    Returns:
        3 f edges: of all lower, all middle and all upper slices.
    """
    one, other = (side * np.where(side[:, 2:] < 0.0, -1.0, 1.0) for side in (one, other))
    is_lower = one[:, 2:] < other[:, 2:]
    steep, flat = np.where(is_lower, other, one), np.where(is_lower, one, other)
    along, aside = _find_slopes(steep), _find_slopes(flat)
    lowest = centres - one - other
    first, second = lowest + 2.0 * flat, lowest + 2.0 * steep
    highest = second + 2.0 * flat
    heights = np.stack([lowest, first, second, highest])[:, :, 2]
    near = lowest[:, :2] + (heights[1] - heights[0])[:, None] * along
    far = first[:, :2] + (heights[2] - heights[1])[:, None] * along
    ends = [(lowest[:, :2], lowest[:, :2]), (near, first[:, :2]), (second[:, :2], far)]
    slopes = [(along, aside), (along, along), (aside, along)]
    return SectionEdges(
        np.concatenate([np.stack(pair, axis=1) for pair in ends]),
        np.concatenate([np.stack(pair, axis=1) for pair in slopes]),
        heights[:3].reshape(-1),
        heights[1:].reshape(-1),
        np.tile(shape, 3),
    )


def _slice_mesh(
    shapes: PlacedShapes, geometry: int, numbers: IntArray, band: tuple[float, float]
) -> SectionEdges:
    corners = shapes.geometries[geometry].triangles
    batch = max(1, MAX_CORNERS // max(3 * len(corners), 1))
    parts = [NO_EDGES]
    for start in range(0, len(numbers), batch):
        part = numbers[start : start + batch]
        poses = shapes.poses[part]
        upward = to_matrix(poses[:, 3:])[:, 2]
        # A fast product finds what is near the band; heights that count are computed after it.
        heights = (upward @ corners.reshape(-1, 3).T + poses[:, 2:3]).reshape(len(part), -1, 3)
        is_near = (heights.max(axis=2) >= band[0] - BAND_MARGIN_M) & (
            heights.min(axis=2) <= band[1] + BAND_MARGIN_M
        )
        copy, face = np.nonzero(is_near)
        placed = transform_points(poses[copy, None], corners[face])
        parts.append(_slice_triangles(placed, part[copy], band))
    return _concatenate(parts)


def _slice_triangles(
    triangles: FloatArray, shape: IntArray, band: tuple[float, float]
) -> SectionEdges:
    """Slice triangles (f, 3, 3) at their vertices; both sides of a triangle are outside."""
    order = np.argsort(triangles[:, :, 2], axis=1, kind="stable")
    low, middle, high = np.moveaxis(np.take_along_axis(triangles, order[:, :, None], axis=1), 1, 0)
    below, above, along = (_find_slopes(side) for side in (middle - low, high - middle, high - low))
    far = low[:, :2] + (middle - low)[:, 2:] * along
    edges = SectionEdges(
        np.stack([np.stack([low, low], 1)[:, :, :2], np.stack([middle[:, :2], far], 1)]).reshape(
            -1, 2, 2
        ),
        np.stack([np.stack([below, along], 1), np.stack([above, along], 1)]).reshape(-1, 2, 2),
        np.concatenate([low[:, 2], middle[:, 2]]),
        np.concatenate([middle[:, 2], high[:, 2]]),
        np.tile(shape, 2),
    )
    edges = edges.take(_find_in_band(edges, band))
    return _concatenate([edges, _reverse(edges, np.ones(len(edges), np.bool_))])


def _find_slopes(sides: FloatArray) -> FloatArray:
    """Find the change (n, 2) of x and y per metre of height along vectors (n, 3); 0 if level."""
    rise = sides[:, 2:]
    is_level = np.abs(rise) < MIN_SLICE_M / 2.0
    return np.asarray(np.where(is_level, 0.0, sides[:, :2] / np.where(is_level, 1.0, rise)))


def _find_in_band(edges: SectionEdges, band: tuple[float, float]) -> IntArray:
    return np.flatnonzero(
        (edges.high - edges.low >= MIN_SLICE_M) & (edges.low <= band[1]) & (edges.high >= band[0])
    )


def _turn_outward(edges: SectionEdges, normals: FloatArray) -> SectionEdges:
    """Turn edges so that the normals (e, 3) of their faces are on their right."""
    middle = edges.cut_at((edges.low + edges.high) / 2.0)
    along = middle[:, 1] - middle[:, 0]
    rightward = along[:, 1] * normals[:, 0] - along[:, 0] * normals[:, 1]
    return _reverse(edges, rightward < 0.0)


def _reverse(edges: SectionEdges, is_reversed: npt.NDArray[np.bool_]) -> SectionEdges:
    where = is_reversed[:, None, None]
    return replace(
        edges,
        ends=np.where(where, edges.ends[:, ::-1], edges.ends),
        slopes=np.where(where, edges.slopes[:, ::-1], edges.slopes),
    )


def _concatenate(parts: list[SectionEdges]) -> SectionEdges:
    return SectionEdges(
        np.concatenate([part.ends for part in parts]),
        np.concatenate([part.slopes for part in parts]),
        np.concatenate([part.low for part in parts]),
        np.concatenate([part.high for part in parts]),
        np.concatenate([part.shape for part in parts]),
    )


NO_EDGES = SectionEdges(
    np.zeros((0, 2, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0), np.zeros(0, np.intp)
)
