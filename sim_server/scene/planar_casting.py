"""Ray casting of level 2-D lidars: exact, on arrays over the whole fleet.

At the height of a lidar, boxes and meshes are edges. Along an edge the reciprocal of the range is
linear in the direction of the ray, so each ray takes the greatest of the linear forms of the edges
that it crosses. Round shapes are cast by the closed forms of `ray_casting`, at the rays that may
hit them. Nothing is sampled, and the result of a ray does not depend on which other lidars are cast
with it, nor in which order.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.sensor_messages import ScanAxis
from zensim.proto.se3 import FloatArray, conjugate, rotate, to_matrix, to_yaw
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges
from zensim.sim_server.scene.level_sections import (
    ROUND_KINDS,
    SectionEdges,
    ShapeBounds,
    bound_shapes,
    find_sections,
)
from zensim.sim_server.scene.ray_casting import NO_ENTITY, PlacedShapes, find_solid_ranges

BoolArray = npt.NDArray[np.bool_]

TURN = 2.0 * math.pi
ANGLE_TOLERANCE = 1e-9
"""Rays that pass an end of an edge by less than this [rad] hit it: none slips between two edges."""
LIDARS_PER_BLOCK = 64
"""Lidars that are cast at once, so that arrays stay in the cache."""
CELL_M = 2.0
"""Side of the cells of the floor for which the edges in range are kept."""
BAND_M = 0.125
"""Height of the bands for which the edges of what is fixed are kept."""
MAX_BANDS = 64
"""Bands that are kept."""
MAX_KEPT = 1 << 23
"""Edges and shapes in the lists of all cells of a band."""
LEVEL_PLANE = 1e-9
"""Planes that are inclined by less than this [rad] are not seen by level rays."""
TINY = 1e-300
"""Divisor in place of those that are 0."""
HALF_PI = math.pi / 2.0
SOLID_KINDS = ("box", "capsule", "cylinder", "mesh", "plane", "sphere")
"""Kinds in alphabetical order."""
UNKNOWN = np.iinfo(np.intp).max
"""Index above that of any entity."""


@dataclass(frozen=True)
class LevelScan:
    """Evenly spaced directions of the rays of a level scan in the sensor, and their limits.

    Attributes:
        count: Rays; > 0.
        first_rad: Azimuth of the first ray; 0 is x, positive to y.
        increment_rad: >= 0.
        range_max_m: Hits beyond it do not count.
        start_m: Distance from the sensor at which rays begin.
    """

    count: int
    first_rad: float
    increment_rad: float
    range_max_m: float
    start_m: float = 0.0

    @cached_property
    def angles(self) -> FloatArray:
        """Azimuths (n,) [rad]."""
        return np.asarray(self.first_rad + np.arange(self.count) * self.increment_rad)

    @cached_property
    def directions(self) -> FloatArray:
        """Cosines and sines (2, n) of the azimuths."""
        return np.stack([np.cos(self.angles), np.sin(self.angles)])

    @property
    def span_rad(self) -> float:
        """Angle from the first to the last ray."""
        return (self.count - 1) * self.increment_rad

    def mirrored(self) -> "LevelScan":
        """Make the scan of an inverted sensor: azimuths change sign, rays their order."""
        first = -(self.first_rad + self.span_rad)
        return LevelScan(self.count, first, self.increment_rad, self.range_max_m, self.start_m)


def make_level_scan(axis: ScanAxis, range_max_m: float, start_m: float = 0.0) -> LevelScan:
    """Make the scan of a lidar with one row."""
    increment = (axis.high_rad - axis.low_rad) / (axis.count - 1) if axis.count > 1 else 0.0
    return LevelScan(axis.count, axis.low_rad, increment, range_max_m, start_m)


@dataclass(frozen=True)
class _Lidars:
    """Level lidars (l,), each with its world, and an entity that its rays pass through."""

    origins: FloatArray  # (l, 3)
    yaws: FloatArray
    ignored: IntArray
    worlds: IntArray

    def take(self, chosen: IntArray | slice) -> "_Lidars":
        return _Lidars(
            self.origins[chosen], self.yaws[chosen], self.ignored[chosen], self.worlds[chosen]
        )


@dataclass(frozen=True)
class _Pairs:
    """Pairs (p,) of a lidar and an edge or an outline."""

    lidar: IntArray
    other: IntArray

    def take(self, chosen: IntArray | BoolArray) -> "_Pairs":
        return _Pairs(self.lidar[chosen], self.other[chosen])


class _NearestHits:
    """The greatest reciprocal range of each ray of a block, and what gave it.

    Attributes:
        reciprocals: (l * n,) ray after ray of each lidar; 0 where nothing is hit.
    """

    def __init__(self, reciprocals: FloatArray) -> None:
        self.reciprocals = reciprocals
        self._found: list[tuple[IntArray, FloatArray, IntArray]] = []

    def add(self, ray: IntArray, reciprocal: FloatArray, entity: IntArray) -> None:
        np.maximum.at(self.reciprocals, ray, reciprocal)
        self._found.append((ray, reciprocal, entity))

    def find_entities(self) -> IntArray:
        """Find what each ray hits; of equally near entities the one of the lowest index."""
        entities = np.full(len(self.reciprocals), UNKNOWN)
        for ray, reciprocal, entity in self._found:
            is_first = reciprocal == self.reciprocals[ray]
            np.minimum.at(entities, ray[is_first], entity[is_first])
        return np.where(entities == UNKNOWN, NO_ENTITY, entities)


class _Section:
    """Shapes, with the edges of boxes and meshes among them, in a band of heights."""

    def __init__(
        self, shapes: PlacedShapes, bounds: ShapeBounds, band: tuple[float, float]
    ) -> None:
        middle, half = (band[0] + band[1]) / 2.0, (band[1] - band[0]) / 2.0
        away = np.abs(bounds.centres[:, 2] - middle)
        self.shapes = shapes
        self.bounds = bounds.take(np.flatnonzero(away <= bounds.extents[:, 2] + half))
        self.entity = shapes.entity[self.bounds.shape]
        self.edges = find_sections(shapes, self.bounds.shape, band)
        self.edge_entity = shapes.entity[self.edges.shape]
        self.is_round = np.isin(self.bounds.kind, ROUND_KINDS)
        self.is_plane = (self.bounds.kind == "plane") & _are_inclined(shapes, self.bounds.shape)
        self.is_box = self.bounds.kind == "box"
        self.kind_number = np.searchsorted(SOLID_KINDS, self.bounds.kind)

    def cast(
        self, lidars: _Lidars, scan: LevelScan, pairs: tuple[_Pairs, _Pairs], hits: _NearestHits
    ) -> None:
        """Cast rays at edges and at solids: pairs of a lidar with either."""
        edges, solids = pairs
        is_cut = _are_cut(lidars, edges, self.edges, self.edge_entity)
        _cast_edges(lidars, scan, self, edges.take(is_cut), hits)
        away = np.abs(lidars.origins[solids.lidar] - self.bounds.centres[solids.other])
        gap = away - self.bounds.extents[solids.other]
        is_wanted = self.entity[solids.other] != lidars.ignored[solids.lidar]
        is_wanted &= gap[:, 2] <= 0.0
        is_wanted &= ~self.is_box[solids.other] | (gap[:, :2] <= scan.start_m).all(axis=1)
        solids = solids.take(is_wanted)
        _cast_solids(lidars, scan, self, solids.take(self._are_about(lidars, scan, solids)), hits)

    def _are_about(self, lidars: _Lidars, scan: LevelScan, pairs: _Pairs) -> BoolArray:
        """Whether solids may be hit otherwise than at an edge: not boxes that rays begin beyond."""
        boxes = np.flatnonzero(self.is_box[pairs.other])
        number = self.bounds.shape[pairs.other[boxes]]
        poses = self.shapes.poses[number]
        origins = lidars.origins[pairs.lidar[boxes]] - poses[:, :3]
        sizes = self.shapes.sizes[self.shapes.geometry[number]]
        gaps = np.abs(rotate(conjugate(poses[:, 3:]), origins)) - sizes / 2.0
        are_about = np.ones(len(pairs.other), np.bool_)
        are_about[boxes] = (gaps <= scan.start_m).all(axis=1)
        return are_about


class _MovingSection(_Section):
    """What is placed anew at each tick; of many worlds, each lidar sees what is in its own."""

    def __init__(
        self,
        shapes: PlacedShapes,
        bounds: ShapeBounds,
        band: tuple[float, float],
        worlds: IntArray | None,
    ) -> None:
        super().__init__(shapes, bounds, band)
        self._worlds = worlds
        if worlds is not None:
            own = worlds[self.bounds.shape]
            self._order = np.argsort(own, kind="stable")
            self._first = np.searchsorted(own[self._order], np.arange(int(worlds.max()) + 2))

    def _find_near(self, lidars: _Lidars, reach: FloatArray) -> _Pairs:
        """Pair lidars with the shapes at a distance of at most their reach (s,)."""
        x, y = self.bounds.centres[:, :2].T
        if self._worlds is None:
            ahead, aside = x - lidars.origins[:, :1], y - lidars.origins[:, 1:2]
            return _Pairs(*np.nonzero(ahead * ahead + aside * aside <= reach * reach))
        first = self._first[lidars.worlds]
        lidar, place = expand_ranges(first, self._first[lidars.worlds + 1] - first)
        shape = self._order[place]
        ahead, aside = x[shape] - lidars.origins[lidar, 0], y[shape] - lidars.origins[lidar, 1]
        is_near = ahead * ahead + aside * aside <= (reach * reach)[shape]
        return _Pairs(lidar, shape).take(is_near)

    def find_pairs(self, lidars: _Lidars, scan: LevelScan) -> tuple[_Pairs, _Pairs]:
        """Pair lidars with the edges and the solids in range."""
        bounds = self.bounds
        near = self._find_near(lidars, bounds.radii + scan.range_max_m)
        near = near.take(self.entity[near.other] != lidars.ignored[near.lidar])
        starts = np.searchsorted(self.edges.shape, bounds.shape, side="left")
        counts = np.searchsorted(self.edges.shape, bounds.shape, side="right") - starts
        owner, edge = expand_ranges(starts[near.other], counts[near.other])
        is_solid = (self.is_round | self.is_plane | self.is_box)[near.other]
        return _Pairs(near.lidar[owner], edge), near.take(is_solid)


class _FixedSection(_Section):
    """What does not move: lists of what is in range of each cell of the floor are kept."""

    def __init__(
        self, shapes: PlacedShapes, bounds: ShapeBounds, band: tuple[float, float]
    ) -> None:
        super().__init__(shapes, bounds, band)
        ends = np.concatenate(
            [self.edges.cut_at(np.clip(z, self.edges.low, self.edges.high)) for z in band], axis=1
        )
        self._low, self._high = ends.min(axis=1), ends.max(axis=1)
        self._cells: dict[tuple[float, ...], tuple[IntArray, IntArray]] = {}
        self._kept = 0

    def find_pairs(self, lidars: _Lidars, scan: LevelScan) -> tuple[_Pairs, _Pairs]:
        """Pair lidars with the edges and the solids that may be in range."""
        cells = np.floor(lidars.origins[:, :2] / CELL_M).tolist()
        found = [self._find_in_cell(scan, x, y) for x, y in cells]
        return _join_pairs([edge for edge, _ in found]), _join_pairs([solid for _, solid in found])

    def _find_in_cell(self, scan: LevelScan, x: float, y: float) -> tuple[IntArray, IntArray]:
        key = (scan.range_max_m, scan.start_m, x, y)
        if key not in self._cells:
            if self._kept > MAX_KEPT:
                self._cells, self._kept = {}, 0
            self._cells[key] = found = self._search_cell(scan, np.array([x, y]) * CELL_M)
            self._kept += len(found[0]) + len(found[1])
        return self._cells[key]

    def _search_cell(self, scan: LevelScan, corner: FloatArray) -> tuple[IntArray, IntArray]:
        edges = _measure_gaps(corner, self._low, self._high)
        centres, extents = self.bounds.centres[:, :2], self.bounds.extents[:, :2]
        gaps = _measure_gaps(corner, centres - extents, centres + extents)
        is_solid = self.is_plane | (self.is_round & (gaps <= scan.range_max_m))
        is_solid |= self.is_box & (gaps <= scan.start_m)
        return np.flatnonzero(edges <= scan.range_max_m), np.flatnonzero(is_solid)


def _measure_gaps(corner: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Measure the distances (r,) [m] of rectangles (r, 2) from a cell with this low corner."""
    gaps = np.maximum(np.maximum(low - (corner + CELL_M), corner - high), 0.0)
    return np.asarray(np.hypot(gaps[:, 0], gaps[:, 1]))


def _join_pairs(found: list[IntArray]) -> _Pairs:
    counts = [len(one) for one in found]
    return _Pairs(np.repeat(np.arange(len(found)), counts), np.concatenate(found))


def _are_inclined(shapes: PlacedShapes, numbers: IntArray) -> BoolArray:
    """Whether level rays can hit shapes (s,) if they are planes."""
    upward = to_matrix(shapes.poses[numbers, 3:])[:, :, 2]
    return np.asarray(np.hypot(upward[:, 0], upward[:, 1]) > LEVEL_PLANE)


def _are_cut(lidars: _Lidars, pairs: _Pairs, edges: SectionEdges, entity: IntArray) -> BoolArray:
    heights = lidars.origins[pairs.lidar, 2]
    is_cut = (edges.low[pairs.other] <= heights) & (heights <= edges.high[pairs.other])
    return np.asarray(is_cut & (entity[pairs.other] != lidars.ignored[pairs.lidar]))


def _cast_edges(
    lidars: _Lidars, scan: LevelScan, section: _Section, pairs: _Pairs, hits: _NearestHits
) -> None:
    origins = lidars.origins[pairs.lidar]
    ends = section.edges.take(pairs.other).cut_at(origins[:, 2]) - origins[:, None, :2]
    ax, ay, bx, by = np.ascontiguousarray(ends.reshape(-1, 4).T)
    moment = bx * ay - by * ax  # > 0: seen from outside
    dx, dy = bx - ax, by - ay
    at = np.clip(-(ax * dx + ay * dy) / np.maximum(dx * dx + dy * dy, TINY), 0.0, 1.0)
    nearest = np.hypot(ax + at * dx, ay + at * dy)
    seen = np.flatnonzero((moment > 0.0) & (nearest <= scan.range_max_m))
    pairs, ax, ay, bx, by = pairs.take(seen), ax[seen], ay[seen], bx[seen], by[seen]
    dx, dy, moment = dx[seen] / -moment[seen], dy[seen] / -moment[seen], moment[seen]
    yaws = lidars.yaws[pairs.lidar]
    # Seen from outside, an edge runs clockwise: its second end comes first.
    runs = _find_runs(scan, np.arctan2(by, bx) - yaws, np.arctan2(moment, ax * bx + ay * by))
    cos, sin = np.cos(yaws), np.sin(yaws)
    u, v = dy * cos - dx * sin, -dx * cos - dy * sin
    pair, ray = runs
    value = u[pair] * scan.directions[0, ray] + v[pair] * scan.directions[1, ray]
    # A ray that passes an end within the tolerance crosses the line beyond it.
    np.minimum(value, 1.0 / np.maximum(nearest[seen], TINY)[pair], out=value)
    _add_hits(scan, pairs.take(pair), ray, value, section.edge_entity, hits)


def _find_runs(scan: LevelScan, first: FloatArray, turn: FloatArray) -> tuple[IntArray, IntArray]:
    """Find the rays between azimuths `first` and `first + turn` (p,): pair and ray of each."""
    first = np.mod(first - scan.first_rad, TURN) - TURN
    inverse = 1.0 / (scan.increment_rad or 1.0)
    starts, stops = [], []
    for _ in range(2 + int((scan.span_rad + ANGLE_TOLERANCE) / TURN)):
        starts.append(np.ceil((first - ANGLE_TOLERANCE) * inverse))
        stops.append(np.floor((first + turn + ANGLE_TOLERANCE) * inverse))
        first = first + TURN
    start = np.maximum(np.concatenate(starts), 0.0).astype(np.intp)
    stop = np.minimum(np.concatenate(stops), scan.count - 1.0).astype(np.intp)
    some = np.flatnonzero(stop >= start)
    owner, ray = expand_ranges(start[some], (stop - start)[some] + 1)
    return (some % len(turn))[owner] if len(some) else some, ray


def _add_hits(
    scan: LevelScan,
    pairs: _Pairs,
    ray: IntArray,
    reciprocal: FloatArray,
    entity: IntArray,
    hits: _NearestHits,
) -> None:
    """Add hits (h,) whose entities are those of the edges or solids of pairs."""
    is_hit = reciprocal >= 1.0 / scan.range_max_m
    if scan.start_m > 0.0:
        is_hit &= reciprocal <= 1.0 / scan.start_m
    pairs, ray = pairs.take(is_hit), ray[is_hit]
    hits.add(pairs.lidar * scan.count + ray, reciprocal[is_hit], entity[pairs.other])


def _cast_solids(
    lidars: _Lidars, scan: LevelScan, section: _Section, pairs: _Pairs, hits: _NearestHits
) -> None:
    """Cast rays at round shapes, at planes, and at boxes about the sensor."""
    numbers = section.kind_number[pairs.other]
    for kind in range(len(SOLID_KINDS)):
        chosen = pairs.take(np.flatnonzero(numbers == kind))
        if not len(chosen.lidar):
            continue
        pair, ray = _find_runs(scan, *_bound_azimuths(lidars, section, chosen))
        ranges = _find_ranges(lidars, scan, section, chosen, (pair, ray))
        reciprocal = 1.0 / np.maximum(ranges, TINY)
        _add_hits(scan, chosen.take(pair), ray, reciprocal, section.entity, hits)


def _bound_azimuths(
    lidars: _Lidars, section: _Section, pairs: _Pairs
) -> tuple[FloatArray, FloatArray]:
    """Find the azimuths in the sensor at which the discs of shapes begin, and their widths."""
    bounds = section.bounds
    away = bounds.centres[pairs.other, :2] - lidars.origins[pairs.lidar, :2]
    distances = np.maximum(np.hypot(away[:, 0], away[:, 1]), TINY)
    half = np.arcsin(np.minimum(bounds.radii[pairs.other] / distances, 1.0))
    is_about = (half >= HALF_PI) | ~section.is_round[pairs.other]
    half[is_about] = math.pi
    return np.arctan2(away[:, 1], away[:, 0]) - half - lidars.yaws[pairs.lidar], 2.0 * half


def _find_ranges(
    lidars: _Lidars,
    scan: LevelScan,
    section: _Section,
    pairs: _Pairs,
    rays: tuple[IntArray, IntArray],
) -> FloatArray:
    """Find ranges (h,) [m] of rays, each of a pair, by closed forms in the frame of the shape."""
    shapes, number = section.shapes, section.bounds.shape[pairs.other]
    back = conjugate(shapes.poses[number, 3:])
    origins = rotate(back, lidars.origins[pairs.lidar] - shapes.poses[number, :3])
    yaws = lidars.yaws[pairs.lidar]
    cos, sin, level = np.cos(yaws), np.sin(yaws), np.zeros(len(yaws))
    forward = rotate(back, np.stack([cos, sin, level], axis=1))
    left = rotate(back, np.stack([-sin, cos, level], axis=1))
    pair, ray = rays
    x, y = scan.directions[:, ray, None]
    directions = x * forward[pair] + y * left[pair]
    sizes = shapes.sizes[shapes.geometry[number]]
    starts = origins[pair] + scan.start_m * directions
    kind = section.bounds.kind[pairs.other[0]]
    return scan.start_m + find_solid_ranges(str(kind), sizes[pair], starts, directions)


def find_tilts(poses: FloatArray) -> FloatArray:
    """Find the angles (n,) [rad] between the xy plane of sensors at poses (n, 7) and the level.

    They are at most half pi: an inverted sensor is level, too.
    """
    upward = 1.0 - 2.0 * (poses[:, 3] ** 2 + poses[:, 4] ** 2)
    return np.arccos(np.minimum(np.abs(upward), 1.0))


class PlanarCaster:
    """Casts the rays of level lidars at all shapes of a scene."""

    def __init__(self) -> None:
        """Cast at nothing yet."""
        nothing = np.zeros(0, np.intp)
        self._bands: dict[int, _FixedSection] = {}
        self._fixed = self._moving = PlacedShapes((), nothing, nothing, np.zeros((0, 7)))
        self._fixed_bounds = self._moving_bounds = bound_shapes(self._fixed, nothing)
        self._moving_worlds: IntArray | None = None

    def place(
        self, fixed: PlacedShapes, moving: PlacedShapes, moving_worlds: IntArray | None = None
    ) -> None:
        """Take the shapes of one step.

        Args:
            fixed: What is kept of them is valid while it is the same object.
            moving: Those that rays may reach.
            moving_worlds: (m,) world of each of these, 0, 1, 2...; None = all are in one.
        """
        if fixed is not self._fixed:
            self._fixed, self._bands = fixed, {}
            self._fixed_bounds = bound_shapes(fixed, np.arange(len(fixed.geometry)))
        self._moving = moving
        self._moving_bounds = bound_shapes(moving, np.arange(len(moving.geometry)))
        self._moving_worlds = moving_worlds

    def cast(
        self,
        scan: LevelScan,
        sensors: FloatArray,
        ignored: IntArray,
        entities: IntArray | None = None,
        worlds: IntArray | None = None,
    ) -> FloatArray:
        """Find the ranges (n, rays) [m] of level lidars; infinite where nothing is in range.

        Args:
            scan: The rays of each lidar.
            sensors: (n, 7) poses in the world; of their orientation only the heading counts, and
                whether they are inverted.
            ignored: (n,) index of the entity that a lidar's rays pass through, or `NO_ENTITY`.
            entities: (n, rays) is filled with what is hit; see `RayHits.entities`.
            worlds: (n,) world of each lidar, if what moves is in several.
        """
        ranges = np.empty((len(sensors), scan.count))
        if worlds is None:
            worlds = np.zeros(len(sensors), np.intp)
        is_inverted = to_matrix(sensors[:, 3:])[:, 2, 2] < 0.0
        for is_chosen, seen, step in ((~is_inverted, scan, 1), (is_inverted, scan.mirrored(), -1)):
            chosen = np.flatnonzero(is_chosen)
            poses = sensors[chosen]
            lidars = _Lidars(poses[:, :3], to_yaw(poses[:, 3:]), ignored[chosen], worlds[chosen])
            for rows, hits in self._cast_blocks(seen, lidars):
                found = hits.reciprocals.reshape(-1, scan.count)[:, ::step]
                is_hit = found > 0.0
                ranges[chosen[rows]] = np.where(is_hit, 1.0 / np.where(is_hit, found, 1.0), np.inf)
                if entities is not None:
                    entities[chosen[rows]] = hits.find_entities().reshape(-1, scan.count)[:, ::step]
        return ranges

    def _cast_blocks(
        self, scan: LevelScan, lidars: _Lidars
    ) -> Iterator[tuple[slice, _NearestHits]]:
        heights = lidars.origins[:, 2]
        if not len(heights):
            return
        span = float(heights.min()), float(heights.max())
        moving = _MovingSection(self._moving, self._moving_bounds, span, self._moving_worlds)
        for start in range(0, len(heights), LIDARS_PER_BLOCK):
            rows = slice(start, start + LIDARS_PER_BLOCK)
            block = lidars.take(rows)
            hits = _NearestHits(np.zeros(len(block.yaws) * scan.count))
            moving.cast(block, scan, moving.find_pairs(block, scan), hits)
            self._cast_at_fixed(block, scan, hits)
            yield rows, hits

    def _cast_at_fixed(self, block: _Lidars, scan: LevelScan, hits: _NearestHits) -> None:
        bands = np.floor(block.origins[:, 2] / BAND_M).astype(np.intp)
        for band in np.unique(bands).tolist():
            chosen = np.flatnonzero(bands == band)
            section = self._find_band(band)
            edges, solids = section.find_pairs(block.take(chosen), scan)
            pairs = (
                _Pairs(chosen[edges.lidar], edges.other),
                _Pairs(chosen[solids.lidar], solids.other),
            )
            section.cast(block, scan, pairs, hits)

    def _find_band(self, band: int) -> _FixedSection:
        if band not in self._bands:
            if len(self._bands) >= MAX_BANDS:
                self._bands = {}
            limits = band * BAND_M, (band + 1) * BAND_M
            self._bands[band] = _FixedSection(self._fixed, self._fixed_bounds, limits)
        return self._bands[band]
