"""The Engine of two tiers: kinematic robots beside a full engine for what may touch."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from itertools import compress
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.engine import (
    NO_CONTACTS,
    BodyStates,
    ContactPoints,
    EngineRefused,
    FloatArray,
    can_move,
    concatenate_contacts,
    make_contact_points,
    make_unknown_efforts,
)
from zensim.sim_server.physics.engine_layer import EngineLayer
from zensim.sim_server.physics.kinematic.collision_limits import (
    DiscMotions,
    find_distances_to_edges,
    limit_by_edges,
    limit_by_other_discs,
)
from zensim.sim_server.physics.kinematic.kinematic_robots import CLEARABLE_HEIGHT_M, KinematicRobots
from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlanCache
from zensim.sim_server.physics.kinematic.tier_body_table import (
    BoolColumn,
    IntColumn,
    RowSelection,
    Tier,
    TierBodyTable,
    TierIndexMapCache,
    rotate_by_heading,
    select_rows,
)
from zensim.sim_server.scene.broad_phase import (
    IntArray,
    PointGrid,
    expand_ranges,
    find_near_points,
    find_touching_discs,
    make_point_grid,
)
from zensim.sim_server.scene.convex_shapes import find_bounding_radius
from zensim.sim_server.scene.footprints import (
    NO_EDGES,
    MeshTriangles,
    StaticEdges,
    concatenate_edges,
    find_outline,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from zensim.proto.messages.model_messages import Dynamics, Model, TierName
    from zensim.sim_server.physics.engine import Engine, EngineReplicas, Place
    from zensim.sim_server.physics.engine_config import EngineConfig
    from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlan, PlanarVehicle
    from zensim.sim_server.physics.kinematic.tier_body_table import TierIndexMap

LOG = logging.getLogger(__name__)
NEAR_M = 0.02
"""Discs with a smaller gap are near each other, if one of them moves."""
CLEAR_M = 0.06
"""Discs with a larger gap to all others are clear."""
NEIGHBOUR_MARGIN_M = 2.0 * CLEAR_M
MOVING_M_S = 1e-3
MIN_APART_M = 1e-9


@dataclass(frozen=True)
class MovingDiscs:
    """Discs of n bodies at one check.

    Attributes:
        centres: (n, 2).
        radius: (n,).
        pace: (n,) bounds of their speeds [m/s] until the next check.
        is_free_moving: (n,) whether only the full engine moves it.
    """

    centres: FloatArray
    radius: FloatArray
    pace: FloatArray
    is_free_moving: BoolColumn


@dataclass(frozen=True)
class ProximityResult:
    """Result of a check for n discs.

    Attributes:
        is_near: (n,) whether it can_stop touch something before the next check.
        is_clear: (n,) whether nothing is near.
    """

    is_near: BoolColumn
    is_clear: BoolColumn


def find_discs_near_discs(
    discs: MovingDiscs, pairs: tuple[IntArray, IntArray], period_s: float
) -> ProximityResult:
    """Check discs against discs; pairs of which neither moves do not count."""
    one, other = pairs
    apart = np.hypot(*(discs.centres[one] - discs.centres[other]).T)
    gap = apart - discs.radius[one] - discs.radius[other]
    gap -= (discs.pace[one] + discs.pace[other]) * period_s
    is_moving = (discs.pace > MOVING_M_S) | discs.is_free_moving
    counts = is_moving[one] | is_moving[other]
    near, close = counts & (gap < NEAR_M), counts & (gap < CLEAR_M)
    is_near, is_clear = _all_false(discs), ~_all_false(discs)
    for side in (one, other):
        is_near[side[near]] = True
        is_clear[side[close]] = False
    return ProximityResult(is_near, is_clear)


def find_discs_near_edges(
    discs: MovingDiscs, edges: StaticEdges, pairs: tuple[IntArray, IntArray], period_s: float
) -> ProximityResult:
    """Check moving discs against edges.

    Args:
        discs: All n.
        edges: All edges.
        pairs: Indices of discs and of edges at overlapping heights.
        period_s: Time until the next check.
    """
    disc, edge = pairs
    _, gap = find_distances_to_edges(discs.centres[disc], edges.ends[edge])
    gap -= discs.radius[disc] + edges.thick[edge] + discs.pace[disc] * period_s
    counts = discs.pace[disc] > MOVING_M_S
    is_near, is_clear = _all_false(discs), ~_all_false(discs)
    is_near[disc[counts & (gap < NEAR_M)]] = True
    is_clear[disc[counts & (gap < CLEAR_M)]] = False
    return ProximityResult(is_near, is_clear)


def combine_results(one: ProximityResult, other: ProximityResult) -> ProximityResult:
    """Combine two results."""
    return ProximityResult(one.is_near | other.is_near, one.is_clear & other.is_clear)


def _all_false(discs: MovingDiscs) -> BoolColumn:
    return np.zeros(len(discs.radius), np.bool_)


MIN_TRAVEL_M = 0.05
"""Least distance that a disc can_stop move before the lists are rebuilt."""
LOOKAHEAD_CHECKS = 4.0
"""Checks for which the lists hold, by the speed of each disc."""
SAMPLES_PER_CELL = 4
"""Sample points on an edge per cell of the grid."""
MAX_APPENDED_DISCS = 64
"""Discs that are compared with all others; with more, all lists are rebuilt."""


class NeighbourLists:
    """Pairs of discs, and of discs and edges, that can_stop meet (a Verlet list).

    Attributes:
        one, other: (k,) indices of the discs of each pair.
        disc, edge: (m,) indices of a disc and of an edge.
    """

    def __init__(self, margin_m: float) -> None:
        self.one: IntArray = np.zeros(0, np.intp)
        self.other: IntArray = np.zeros(0, np.intp)
        self.disc: IntArray = np.zeros(0, np.intp)
        self.edge: IntArray = np.zeros(0, np.intp)
        self._margin_m = margin_m
        self._centres: FloatArray = np.zeros((0, 2))
        self._allowed: FloatArray = np.zeros(0)
        self._edges = NO_EDGES
        self._cells: PointGrid | None = None
        self._samples: FloatArray = np.zeros((0, 2))
        self._owners: IntArray = np.zeros(0, np.intp)
        self._is_valid = False
        self._travelled_m = 0.0

    def set_edges(self, edges: StaticEdges) -> None:
        """Replace the edges."""
        self._edges, self._cells = edges, None
        self._is_valid = False

    def invalidate(self) -> None:
        """Rebuild the lists at the next refresh."""
        self._is_valid = False

    def refresh(self, centres: FloatArray, radius: FloatArray, way: FloatArray) -> None:
        """Rebuild the lists if a pair that can_stop meet could be missing.

        Args:
            centres: (n, 2).
            radius: (n,).
            way: (n,) bounds of the distance to the next refresh.
        """
        self._travelled_m += float(way.max()) if len(way) else 0.0
        if 0 < len(centres) - len(self._centres) <= MAX_APPENDED_DISCS and self._is_valid:
            self._append(centres, radius, way)
        if (
            self._is_valid
            and len(centres) == len(self._centres)
            and (self._travelled_m < MIN_TRAVEL_M or not self._is_too_far(centres, way))
        ):
            return
        self._travelled_m = 0.0
        self._centres = centres.copy()
        self._allowed = np.maximum(MIN_TRAVEL_M, LOOKAHEAD_CHECKS * way)
        reach = radius + self._allowed + self._margin_m / 2.0
        self.one, self.other = find_touching_discs(centres, reach)
        self.disc, self.edge = self._near_edges(centres, reach + self._margin_m / 2.0)
        self._is_valid = True

    def _append(self, centres: FloatArray, radius: FloatArray, way: FloatArray) -> None:
        """Add the pairs of discs that follow those of the lists."""
        count = len(self._centres)
        self._centres = np.concatenate([self._centres, centres[count:]])
        more = np.maximum(MIN_TRAVEL_M, LOOKAHEAD_CHECKS * way[count:])
        self._allowed = np.concatenate([self._allowed, more])
        reach = radius + self._allowed + self._margin_m / 2.0
        firsts, seconds = [self.one], [self.other]
        for number in range(count, len(centres)):
            away = self._centres[:number] - self._centres[number]
            total = reach[:number] + reach[number]
            near = np.flatnonzero(np.einsum("ij,ij->i", away, away) <= total * total)
            firsts.append(near)
            seconds.append(np.full(len(near), number))
        self.one, self.other = np.concatenate(firsts), np.concatenate(seconds)
        far = reach[count:] + self._margin_m / 2.0
        disc, edge = self._near_edges(self._centres[count:], far)
        self.disc = np.concatenate([self.disc, disc + count])
        self.edge = np.concatenate([self.edge, edge])

    def _is_too_far(self, centres: FloatArray, way: FloatArray) -> bool:
        moved = centres - self._centres
        left = self._allowed - way
        square = np.einsum("ij,ij->i", moved, moved)
        return bool(((left < 0.0) | (square > left * left)).any())

    def _near_edges(self, centres: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
        if not len(self._edges) or not len(centres):
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        far = float(reach.max()) + float(self._edges.thick.max())
        cells = self._cells
        if cells is None or far > cells.size_m * (1.0 - 1.0 / SAMPLES_PER_CELL):
            cells = self._cells = self._sampled(far * (1.0 + 2.0 / SAMPLES_PER_CELL))
        within = far + cells.size_m / SAMPLES_PER_CELL / 2.0
        disc, sample = find_near_points(cells, self._samples, centres, within)
        pairs = np.unique(np.stack([disc, self._owners[sample]], axis=1), axis=0)
        disc, edge = pairs[:, 0], pairs[:, 1]
        _, apart = find_distances_to_edges(centres[disc], self._edges.ends[edge])
        is_near = apart <= reach[disc] + self._edges.thick[edge]
        return disc[is_near], edge[is_near]

    def _sampled(self, size_m: float) -> PointGrid:
        """Sample all edges so densely that each is found by one of its points."""
        ends = self._edges.ends
        along = ends[:, 2:] - ends[:, :2]
        parts = (
            np.ceil(np.hypot(along[:, 0], along[:, 1]) / size_m * SAMPLES_PER_CELL).astype(np.intp)
            + 1
        )
        self._owners = np.repeat(np.arange(len(ends)), parts)
        at = np.arange(len(self._owners)) - np.repeat(np.cumsum(parts) - parts, parts)
        share = at / np.maximum(parts[self._owners] - 1, 1)
        self._samples = ends[self._owners, :2] + along[self._owners] * share[:, None]
        return make_point_grid(self._samples, size_m)


@dataclass(frozen=True)
class Obstacle:
    """What stops a disc: the row of a body, the point (3,), the direction (2,) from it."""

    row: int
    point: tuple[float, float, float]
    normal: FloatArray


class ProximityIndex:
    """Discs of all bodies that can move, and edges of all that cannot.

    Attributes:
        discs: (d,) rows of bodies that can move.
        own: (n,) indices of the kinematic robots among them.
    """

    def __init__(self, rows: TierBodyTable, kinematic: KinematicRobots, period_s: float) -> None:
        self.discs: IntArray = np.zeros(0, np.intp)
        self.own: RowSelection = np.zeros(0, np.intp)
        self._at: RowSelection = self.own
        self._table = rows
        self._kinematic = kinematic
        self._period_s = period_s
        self._neighbours = NeighbourLists(NEIGHBOUR_MARGIN_M)
        self._outlines: dict[int, StaticEdges] = {}
        self._edges: StaticEdges | None = NO_EDGES

    def set_outline(self, row: int, outline: StaticEdges) -> None:
        """Set the edges of a static body."""
        self._outlines[row] = outline
        self._edges = None

    def remove_outline(self, row: int) -> None:
        """Remove the edges of a static body."""
        if self._outlines.pop(row, None) is not None:
            self._edges = None

    def gather(self) -> None:
        """Update the rows after bodies came, went or changed tiers."""
        table = self._table
        is_disc = (table.tier == Tier.FULL) | (table.tier == Tier.KINEMATIC)
        discs = np.flatnonzero(is_disc & ~table.is_static)
        if not np.array_equal(discs[: len(self.discs)], self.discs):
            self._neighbours.invalidate()
        self.discs = discs
        place = np.zeros(len(table.tier), np.intp)
        place[discs] = np.arange(len(discs))
        self.own = select_rows(place[self._kinematic.rows])
        self._at = select_rows(discs)

    def invalidate(self) -> None:
        """Rebuild the neighbour lists: a body was moved by a request."""
        self._neighbours.invalidate()

    def find_near(self) -> ProximityResult:
        """Check all discs for the time until the next check."""
        table, rows = self._table, self.discs
        is_free_moving = (table.tier[rows] == Tier.FULL) & ~table.is_held[rows]
        discs = MovingDiscs(
            table.discs(self._at), table.radius[rows], table.pace[rows], is_free_moving
        )
        self._refresh(discs.centres, np.zeros(len(rows)))
        neighbours = self._neighbours
        found = find_discs_near_discs(discs, (neighbours.one, neighbours.other), self._period_s)
        if len(self._static_edges()):
            near = find_discs_near_edges(
                discs, self._static_edges(), self._edge_pairs_at_height(), self._period_s
            )
            found = combine_results(found, near)
        return found

    def find_free_fractions(self, way: FloatArray) -> FloatArray:
        """Find the fractions (n,) of displacements (3, n) that are free for kinematic robots."""
        moves = self._kinematic.disc_motions(way, self._at, self.own, self._period_s)
        self._refresh(moves.start, np.hypot(moves.way[:, 0], moves.way[:, 1]))
        neighbours, fractions = self._neighbours, np.ones(len(self.discs))
        if len(neighbours.disc):
            fractions = self._limit_by_edges(moves)
        if len(neighbours.one):
            fractions = limit_by_other_discs(moves, neighbours.one, neighbours.other, fractions)
        return fractions[self.own]

    def find_overlapping(self, row: int) -> tuple[list[int], bool]:
        """Find the rows of discs that a disc overlaps, and whether it overlaps an edge."""
        table = self._table
        centre = table.discs(slice(row, row + 1))
        rows = self._list_near_rows(row, centre)
        apart = np.hypot(*(table.discs(rows) - centre).T)
        found: list[int] = rows[apart < table.radius[rows] + table.radius[row]].tolist()
        edges = self._static_edges()
        if not len(edges):
            return found, False
        _, gap = find_distances_to_edges(np.broadcast_to(centre, (len(edges), 2)), edges.ends)
        return found, bool((gap < edges.thick + table.radius[row]).any())

    def _list_near_rows(self, row: int, centre: FloatArray) -> IntArray:
        """List the rows of other discs that may overlap one; few of many."""
        table = self._table
        far = table.radius[row] + table.reach_m
        rows = np.flatnonzero(np.abs(table.place[0] - centre[0, 0]) <= far)
        rows = rows[np.abs(table.place[1, rows] - centre[0, 1]) <= far]
        rows = rows[(table.tier[rows] != Tier.NONE) & ~table.is_static[rows]]
        return np.asarray(rows[rows != row])

    def find_obstacle(self, row: int, way: FloatArray) -> Obstacle | None:
        """Find what stops the disc of a row that should have moved by `way` (2,)."""
        table = self._table
        (centre,) = table.discs(np.array([row]))
        others = self.discs[self.discs != row]
        between = centre - table.discs(others)
        apart = np.hypot(between[:, 0], between[:, 1])
        away = [between / np.maximum(apart, MIN_APART_M)[:, None]]
        gap, bodies = [apart - table.radius[others]], [others]
        low, high = table.place[2, row] + table.heights[:, row]
        for body, edges in self._outlines.items():
            meets = (edges.heights[:, 0] < high) & (edges.heights[:, 1] > low + CLEARABLE_HEIGHT_M)
            ends = edges.ends[meets]
            from_edges, apart = find_distances_to_edges(np.tile(centre, (len(ends), 1)), ends)
            away.append(from_edges)
            gap.append(apart - edges.thick[meets])
            bodies.append(np.full(len(ends), body))
        directions = np.concatenate(away)
        gaps = np.concatenate(gap) - table.radius[row]
        gaps[directions @ way > 0.0] = np.inf
        if not len(gaps) or gaps.min() > NEAR_M:
            return None
        nearest = int(gaps.argmin())
        normal = directions[nearest]
        point = centre - normal * table.radius[row]
        return Obstacle(int(np.concatenate(bodies)[nearest]), (*point, (low + high) / 2.0), normal)

    def _limit_by_edges(self, moves: DiscMotions) -> FloatArray:
        disc, edge = self._edge_pairs_at_height()
        edges = self._static_edges()
        can_stop = moves.may_stop[disc]
        return limit_by_edges(
            moves, disc[can_stop], edges.ends[edge[can_stop]], edges.thick[edge[can_stop]]
        )

    def _edge_pairs_at_height(self) -> tuple[IntArray, IntArray]:
        """List pairs of a disc and a near edge at overlapping heights."""
        table, disc, edge = self._table, self._neighbours.disc, self._neighbours.edge
        rows, heights = self.discs[disc], self._static_edges().heights[edge]
        low = table.place[2, rows] + table.heights[0, rows] + CLEARABLE_HEIGHT_M
        high = table.place[2, rows] + table.heights[1, rows]
        meets = (heights[:, 0] < high) & (heights[:, 1] > low)
        return disc[meets], edge[meets]

    def _refresh(self, centres: FloatArray, way: FloatArray) -> None:
        table = self._table
        self._static_edges()
        far = np.maximum(way, table.pace[self._at] * self._period_s)
        self._neighbours.refresh(centres, table.radius[self._at], far)

    def _static_edges(self) -> StaticEdges:
        if self._edges is None:
            self._edges = concatenate_edges(list(self._outlines.values()))
            self._neighbours.set_edges(self._edges)
        return self._edges


SETTLED_S = 0.3
"""Time for which a robot is clear and rolls evenly before it leaves full dynamics."""
LEVEL_TOLERANCE = 0.01
"""Maximum x and y of the quaternion of an upright robot."""
GROUND_TOLERANCE_M = 0.01
"""Maximum distance of the lowest point from the ground."""
TWIST_TOLERANCE_M_S, TWIST_TOLERANCE_RAD_S = 0.03, 0.15
"""Maximum difference of a twist from that of the wheels."""
MAX_RISE_M_S, MAX_ROCK_RAD_S = 0.005, 0.05
"""Maximum vertical speed and roll or pitch rate."""
TARGET_TOLERANCE_M_S = 0.05
"""Maximum difference of rim speeds from their targets."""


def is_level_on_ground(base: FloatArray, low: float) -> bool:
    """Whether a root link at `base` stands upright on the ground, its lowest point at `low`."""
    is_level = bool((np.abs(base[3:5]) < LEVEL_TOLERANCE).all())
    return is_level and abs(float(base[2]) + low) < GROUND_TOLERANCE_M


def matches_planar_twist(base: FloatArray, twist: FloatArray) -> bool:
    """Whether a root link moves with a twist (3,) along its heading."""
    ahead, left = _velocity_along_heading(base)
    return bool(
        abs(ahead - twist[0]) < TWIST_TOLERANCE_M_S
        and abs(left - twist[1]) < TWIST_TOLERANCE_M_S
        and abs(float(base[9])) < MAX_RISE_M_S
        and abs(float(base[12]) - twist[2]) < TWIST_TOLERANCE_RAD_S
        and (np.abs(base[10:12]) < MAX_ROCK_RAD_S).all()
    )


def has_reached_targets(
    vehicle: PlanarVehicle, targets: FloatArray, velocities: FloatArray
) -> bool:
    """Whether wheels turn at their targets, and no other joint moves."""
    driven = list(vehicle.driven.joints)
    radii = np.array([wheel.radius_m for wheel in vehicle.wheels[: len(driven)]])
    missing = (targets[list(vehicle.driven.places)] - velocities[driven]) * radii
    wheels = {wheel.joint for wheel in vehicle.wheels}
    others = [joint for joint in range(vehicle.joint_count) if joint not in wheels]
    return bool(
        (np.abs(missing) < TARGET_TOLERANCE_M_S).all()
        and (np.abs(velocities[others]) < TWIST_TOLERANCE_RAD_S).all()
    )


def _velocity_along_heading(base: FloatArray) -> tuple[float, float]:
    yaw = float(to_yaw(base[3:7]))
    vx, vy = base[7:9].tolist()
    return vx * np.cos(yaw) + vy * np.sin(yaw), vy * np.cos(yaw) - vx * np.sin(yaw)


WAKING_TURN_RAD_S = 1e-9
"""Yaw rate [rad/s] at which an engine makes a body awake."""
MIN_RADIUS_M = 1e-3
"""Radius of a body without collisions."""


class TieredBodies:
    """All bodies: rows of kinematic robots, and numbers of the others in the full engine.

    Attributes:
        numbers: Row by number in the full engine.
        movers: Those numbers whose bodies can move.
        moving_rows: Their rows.
        commanded: Rows of robots that were commanded since they were at rest.
        held_count: Number of robots that may be in the kinematic tier.
        jointed: Rows of bodies with a fixed root and joints that move.
    """

    def __init__(self, full: Engine, corners: MeshTriangles, dt_s: float, period_s: float) -> None:
        self.rows = TierBodyTable()
        self.kinematic = KinematicRobots(self.rows, dt_s)
        self.surroundings = ProximityIndex(self.rows, self.kinematic, period_s)
        self.mappings = TierIndexMapCache(self.rows)
        self.models: dict[int, Model] = {}
        self.numbers: dict[int, int] = {}
        self.commanded: set[int] = set()
        self.held_count = 0
        self.jointed: set[int] = set()
        self.movers: tuple[int, ...] = ()
        self.moving_rows: IntColumn = np.zeros(0, np.intp)
        self._full = full
        self._corners = corners
        self._pending_outlines: dict[int, FloatArray] = {}
        self._is_gathered = self._has_movers = True
        self._added: set[int] = set()
        """Rows that were added since the last `gather`."""
        self._last: tuple[tuple[int, ...], BodyStates] | None = None

    def add(self, model: Model, plan: PlanarPlan | None, *, is_auto: bool) -> int:
        """Add a row for a body that is not in the full engine."""
        rows, row = self.rows, self.rows.allocate()
        self.models[row] = model
        rows.tier[row] = Tier.KINEMATIC
        rows.joint_count[row], rows.width[row] = len(model.joints), model.target_count
        rows.is_static[row] = model.is_static
        if model.is_static and can_move(model):
            self.jointed.add(row)
        if plan is not None:
            vehicle, footprint = plan
            rows.is_held[row], rows.is_auto[row] = True, is_auto
            rows.set_disc(row, footprint.radius_m, footprint.centre)
            rows.heights[:, row] = footprint.low, footprint.high
            self.kinematic.add(row, vehicle)
            self.held_count += 1
        self._added.add(row)
        return row

    def hide(self, row: int) -> None:
        """Keep a kinematic body that was just added from moving and from stopping others."""
        self.rows.tier[row] = Tier.HIDDEN
        self._added.discard(row)

    def show(self, rows: Sequence[int]) -> None:
        """Let hidden bodies take part."""
        shown = np.array(rows, np.intp)
        shown = shown[self.rows.tier[shown] == Tier.HIDDEN]
        self.rows.tier[shown] = Tier.KINEMATIC
        self._added.update(shown.tolist())

    def remove(self, row: int) -> None:
        """Remove a body from its tier."""
        if self.rows.full[row] >= 0:
            self.move_to_kinematic(row)
        self.surroundings.invalidate()
        if self.rows.is_held[row]:
            self.kinematic.remove(row)
            self.held_count -= 1
        self.surroundings.remove_outline(row)
        self._pending_outlines.pop(row, None)
        self.commanded.discard(row)
        self.jointed.discard(row)
        self._added.discard(row)
        del self.models[row]
        self.rows.free(row)
        self._invalidate()

    def register_full(self, row: int, number: int) -> None:
        """Record the number of a body in the full engine."""
        rows = self.rows
        rows.full[row], rows.tier[row] = number, Tier.FULL
        self.numbers[number] = row
        self._has_movers, self._last = False, None

    def move_to_full(self, row: int, *, at_once: bool = False) -> int:
        """Add a body to the full engine if it is not there, and return its number.

        Args:
            row: Its row.
            at_once: Whether it must move in the next step; a sleeping body wakes a step later.
        """
        rows = self.rows
        if rows.full[row] < 0:
            number = self.add_guest(row, WAKING_TURN_RAD_S if at_once else 0.0)
            positions, velocities = self.kinematic.joints(row)
            state = rows.states(np.array([row]))[0]
            self._full.set_state(number, state, positions, velocities)
            if row in self.commanded:
                self._full.command([number], self.kinematic.targets_of(row))
            rows.full[row], rows.tier[row] = number, Tier.FULL
            self.numbers[number] = row
            self._invalidate(has_movers=False)
        return int(rows.full[row])

    def add_guest(self, row: int, turning: float = 0.0) -> int:
        """Add a copy of a kinematic body to the full engine, with a yaw rate [rad/s]."""
        state = self.rows.states(np.array([row]))[0]
        state[7:12], state[12] = 0.0, turning
        return self._full.add(self.models[row], state)

    def move_to_kinematic(self, row: int) -> None:
        """Remove a body from the full engine."""
        number = int(self.rows.full[row])
        self._full.remove(number)
        del self.numbers[number]
        self.rows.full[row], self.rows.tier[row] = -1, Tier.KINEMATIC
        self._invalidate(has_movers=False)

    def set_state(self, row: int, base: FloatArray) -> None:
        """Record the state (13,) of a body that a request set."""
        self.place(row, base)
        self._last, self._is_gathered = None, False
        self.surroundings.invalidate()

    def place(self, row: int, base: FloatArray) -> None:
        """Record the state (13,) of a body that is new."""
        if self.rows.is_static[row]:
            self._pending_outlines[row] = base.copy()
        elif self.held_count:
            self.record_states(slice(row, row + 1), base[None])

    def record_states(self, rows: RowSelection, base: FloatArray) -> None:
        """Record the states (n, 13) of bodies."""
        table, yaw = self.rows, to_yaw(base[:, 3:7])
        table.place[:, rows] = base[:, :3].T
        table.turn_to(rows, yaw)
        sin, cos = table.half[:, rows]
        x, y, z, w = base[:, 3:7].T
        table.tilt[:, rows] = (
            *(cos * x + sin * y, cos * y - sin * x),
            *(cos * z - sin * w, cos * w + sin * z),
        )
        cos, sin = table.headings(rows)
        table.twist[:2, rows] = rotate_by_heading(base[:, 7], base[:, 8], (cos, -sin))
        table.twist[2, rows] = base[:, 12]

    def stand_still(self, row: int, positions: FloatArray | None) -> None:
        """Set the joints of a robot to `positions` or zero, and its targets to zero."""
        count = int(self.rows.joint_count[row])
        angles = np.zeros(count) if positions is None else positions
        self.commanded.discard(row)
        self.kinematic.set_targets(row, np.zeros(int(self.rows.width[row])))
        self.kinematic.set_joints(row, angles, np.zeros(count))

    def read_full(self, numbers: tuple[int, ...]) -> BodyStates:
        """Read bodies of the full engine; the last tuple is cached for a step."""
        if self._last is None or self._last[0] != numbers:
            self._last = (numbers, self._full.read(numbers))
        return self._last[1]

    def invalidate_reading(self) -> None:
        """Drop the cached states of the full engine."""
        self._last = None

    def gather(self) -> None:
        """Update rows, outlines and radii after changes."""
        if self._is_gathered and not self._added:
            return
        self.gather_full()
        self.kinematic.gather()
        self.surroundings.gather()
        self._is_gathered = True
        self._added.clear()

    def gather_full(self) -> None:
        """Update outlines, and the rows and radii of the bodies that the full engine moves."""
        for row, base in self._pending_outlines.items():
            self.surroundings.set_outline(row, find_outline(self.models[row], base, self._corners))
        self._pending_outlines.clear()
        if self._has_movers:
            return
        table = self.rows
        self.moving_rows = np.flatnonzero((table.tier == Tier.FULL) & ~table.is_static)
        self.movers = tuple(table.full[self.moving_rows].tolist())
        for row in self.moving_rows[table.radius[self.moving_rows] <= 0.0].tolist():
            radius_m = find_bounding_radius(self.models[row], self._corners, unlimited_m=0.0)
            table.set_disc(row, max(radius_m, MIN_RADIUS_M), (0.0, 0.0))
        self._has_movers = True

    def _invalidate(self, *, has_movers: bool = True) -> None:
        """Note that rows have changed.

        Args:
            has_movers: Whether the bodies that the full engine moves are the same as before.
        """
        self._last = None
        self._is_gathered = False
        self._has_movers &= has_movers
        self.mappings.invalidate()


FALL_MARGIN_M_S2 = 20.0
"""Bound of the acceleration of bodies in the full engine."""


class TierSwitcher:
    """Moves `auto` robots between the tiers, in the order of their rows, for repeatability."""

    def __init__(self, bodies: TieredBodies, period_s: float) -> None:
        self._bodies = bodies
        self._period_s = period_s
        self._settled_s: dict[int, float] = {}
        self._last_states: dict[int, FloatArray] = {}

    def forget(self, row: int) -> None:
        """Reset the settling time of a robot."""
        self._settled_s.pop(row, None)

    def update(self) -> None:
        """Check proximity, and move robots to the tier that they need."""
        bodies, rows = self._bodies, self._bodies.rows
        bodies.gather()
        self._read_full_bodies()
        if not rows.is_auto.any():
            return
        bodies.kinematic.update_speed_bounds()
        proximity = bodies.surroundings.find_near()
        discs = bodies.surroundings.discs
        needs_full = proximity.is_near | rows.exceeds_limits[discs]
        is_flat = rows.is_auto[discs] & (rows.full[discs] < 0)
        for row in discs[is_flat & needs_full].tolist():
            self._try_move_to_full(row)
        self._release_settled(proximity, discs)

    def _try_move_to_full(self, row: int) -> None:
        """Move a robot to the full engine; if that refuses, it stays kinematic from now on."""
        try:
            self._bodies.move_to_full(row)
        except EngineRefused as refused:
            self._bodies.rows.is_auto[row] = False
            LOG.warning("robot stays kinematic body=%d reason=%s", row, refused)

    def find_overlapping(self, row: int) -> tuple[list[int], bool]:
        """Find the rows of discs that a disc overlaps now, and whether it overlaps an edge."""
        self._bodies.gather_full()
        if self._bodies.movers:
            self._read_full_bodies()
        return self._bodies.surroundings.find_overlapping(row)

    def _read_full_bodies(self) -> None:
        bodies, rows = self._bodies, self._bodies.rows
        if not bodies.movers:
            return
        reading, moving = bodies.read_full(bodies.movers), bodies.moving_rows
        base = reading.base
        is_finite = np.isfinite(base).all(axis=1)
        bodies.record_states(moving[is_finite], base[is_finite])
        self._last_states = dict(zip(moving.tolist(), base, strict=True))
        speed = np.linalg.norm(base[:, 7:10], axis=1)
        speed_bound = np.where(speed > MOVING_M_S, speed + FALL_MARGIN_M_S2 * self._period_s, 0.0)
        rows.pace[moving] = np.where(is_finite, speed_bound, 0.0)
        counts = rows.joint_count[moving]
        is_held = rows.is_held[moving]
        at = np.cumsum(counts) - counts
        own = expand_ranges(at[is_held], counts[is_held])[1]
        pooled = expand_ranges(rows.joint_start[moving[is_held]], counts[is_held])[1]
        bodies.kinematic.positions.numbers[pooled] = reading.joint_positions[own]
        bodies.kinematic.velocities[pooled] = reading.joint_velocities[own]

    def _release_settled(
        self, proximity: ProximityResult, discs: np.ndarray[tuple[int], np.dtype[np.intp]]
    ) -> None:
        rows = self._bodies.rows
        is_full = rows.is_auto[discs] & (rows.full[discs] >= 0)
        is_settled = is_full & proximity.is_clear & ~rows.exceeds_limits[discs]
        for row in discs[is_full & ~is_settled].tolist():
            self._settled_s[row] = 0.0
        for row in discs[is_settled].tolist():
            settled_s = self._settled_s.get(row, 0.0) + self._period_s
            if settled_s >= SETTLED_S and self._may_become_kinematic(row):
                self._bodies.move_to_kinematic(row)
                settled_s = 0.0
            self._settled_s[row] = min(settled_s, SETTLED_S)

    def _may_become_kinematic(self, row: int) -> bool:
        bodies, base = self._bodies, self._last_states.get(row)
        if base is None or not is_level_on_ground(base, float(bodies.rows.heights[0, row])):
            return False
        kinematic, vehicle = bodies.kinematic, bodies.kinematic.vehicle(row)
        _, velocities = kinematic.joints(row)
        if not has_reached_targets(vehicle, kinematic.targets_of(row), velocities):
            return False
        return matches_planar_twist(base, kinematic.twist(row))


PROXIMITY_PERIOD_S = 0.02
"""Period of proximity checks; at least one step."""
MAX_VERIFIED_MODELS = 256


class TieredEngine(EngineLayer):
    """Robots in the kinematic tier, all else in a full engine; `auto` robots switch."""

    def __init__(self, full: Engine, config: EngineConfig, default: Dynamics) -> None:
        super().__init__(full)
        self._plans = PlanarPlanCache(config, default)
        gx, gy, gz = config.gravity
        self._has_flat_ground = config.has_ground and gx == gy == 0.0 and gz < 0.0
        dt_s = config.step_ns * 1e-9
        self._every = max(1, round(PROXIMITY_PERIOD_S / dt_s))
        self._steps_to_check = 0
        self._bodies = TieredBodies(full, self._plans.corners, dt_s, self._every * dt_s)
        self._switcher = TierSwitcher(self._bodies, self._every * dt_s)
        self._verified: dict[int, Model] = {}
        self._stopped: dict[int, FloatArray] = {}
        """Displacement (2,) that obstacles shortened in the last step, by body."""

    def __getstate__(self) -> dict[str, object]:
        """Leave out what is cached by the identity of models."""
        return {**self.__dict__, "_verified": {}}

    def tier_of(self, body: int) -> TierName:
        """See `Engine.tier_of`."""
        return "kinematic" if self._bodies.rows.tier[body] >= Tier.KINEMATIC else "full"

    @property
    def kinematic_count(self) -> int:
        """See `Engine.kinematic_count`."""
        return int((self._bodies.rows.tier >= Tier.KINEMATIC).sum())

    def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:
        """See `Engine.expect`; what may be kinematic needs no room in the engine."""
        is_full = [self._plans.dynamics(one) == "full" for one in models]
        self._inner.expect(list(compress(models, is_full)), list(compress(places, is_full)))

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`; refuses a model that needs the kinematic tier and cannot use it."""
        bodies, plan = self._bodies, self._plans.plan(model)
        is_auto = self._plans.dynamics(model) == "auto"
        number = -1
        if plan is None or (is_auto and not self._starts_kinematic(base, plan[1].low)):
            number = self._inner.add(model, base)
        else:
            self._verify_model(model, base)
        row = bodies.add(model, plan, is_auto=is_auto)
        if number >= 0:
            bodies.register_full(row, number)
        bodies.place(row, base)
        return row

    def remove(self, body: int) -> None:
        """See `Engine.remove`."""
        self._bodies.remove(body)
        self._switcher.forget(body)

    def hide(self, body: int) -> None:
        """See `Engine.hide`."""
        if (number := int(self._bodies.rows.full[body])) >= 0:
            self._inner.hide(number)
        else:
            self._bodies.hide(body)

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        numbers = self._bodies.rows.full[list(bodies)]
        self._inner.show(numbers[numbers >= 0].tolist())
        self._bodies.show(bodies)

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`; kinematic bodies whose discs overlap join the engine."""
        bodies = self._bodies
        full = bodies.rows.full
        guests, is_by_edge = (
            self._switcher.find_overlapping(body) if bodies.held_count else ([], False)
        )
        if full[body] < 0 and not guests and not is_by_edge:
            return []
        guest_numbers: dict[int, int] = {}
        try:
            for row in (body, *guests):
                if full[row] < 0:
                    guest_numbers[row] = bodies.add_guest(row)
            mine = guest_numbers.get(body, int(full[body]))
            found = self._inner.find_overlaps(mine)
            rows = {number: row for row, number in guest_numbers.items()}
            return sorted(rows[one] if one in rows else bodies.numbers[one] for one in found)
        finally:
            for number in guest_numbers.values():
                self._inner.remove(number)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`; synchronous if there are kinematic bodies."""
        number = int(self._bodies.rows.full[body])
        if number < 0 or self._bodies.held_count:
            found = self.find_overlaps(body)
            return lambda: found
        wait, rows = self._inner.find_overlaps_async(number), self._bodies.numbers
        return lambda: sorted(rows[other] for other in wait() if other in rows)

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        """See `Engine.read_contacts`; kinematic robots that are stopped feel no force."""
        numbers = self._bodies.rows.full[list(bodies)]
        numbers = numbers[numbers >= 0].tolist()
        found = self._inner.read_contacts(numbers) if numbers else NO_CONTACTS
        found = found.renumber(self._bodies.numbers)
        return concatenate_contacts([found, self._list_stops(bodies)])

    def _list_stops(self, bodies: Sequence[int]) -> ContactPoints:
        """List where kinematic robots were stopped in the last step."""
        if not self._stopped:
            return NO_CONTACTS
        pairs, points = [], []
        for body in bodies:
            way = self._stopped.get(body)
            if way is None or self._bodies.rows.full[body] >= 0:
                continue
            if (found := self._bodies.surroundings.find_obstacle(body, way)) is not None:
                pairs.append((body, 0, found.row, 0))
                points.append((*found.point, *found.normal.tolist(), *(0.0,) * 5))
        return make_contact_points(pairs, points)

    def take_faults(self) -> Mapping[int, str]:
        """See `Engine.take_faults`."""
        rows = self._bodies.numbers
        faults = self._inner.take_faults()
        return {rows[number]: reason for number, reason in faults.items() if number in rows}

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`."""
        mapping = self._bodies.mappings.get(bodies)
        kinematic, full = mapping.kinematic, mapping.full
        if not len(kinematic.rows):
            return self._inner.read(mapping.bodies)
        if not mapping.bodies:
            return self._read_kinematic(mapping)
        base = np.empty((mapping.count, 13))
        positions, velocities = np.empty(mapping.joint_count), np.empty(mapping.joint_count)
        base[kinematic.places] = self._bodies.rows.states(mapping.at)
        robots = self._bodies.kinematic
        positions[kinematic.joints] = robots.positions.numbers[mapping.pooled_joints]
        velocities[kinematic.joints] = robots.velocities[mapping.pooled_joints]
        reading = self._bodies.read_full(mapping.bodies)
        base[full.places] = reading.base
        positions[full.joints] = reading.joint_positions
        velocities[full.joints] = reading.joint_velocities
        return BodyStates(base, positions, velocities)

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """See `Engine.read_joint_efforts`; NaN for kinematic bodies."""
        mapping = self._bodies.mappings.get(bodies)
        efforts = make_unknown_efforts(mapping.joint_count)
        if mapping.bodies:
            efforts[mapping.full.joints] = self._inner.read_joint_efforts(mapping.bodies)
        return efforts

    def _read_kinematic(self, mapping: TierIndexMap) -> BodyStates:
        kinematic = self._bodies.kinematic
        return BodyStates(
            self._bodies.rows.states(mapping.at),
            kinematic.positions.numbers[mapping.pooled_joints],
            kinematic.velocities[mapping.pooled_joints],
        )

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`; an always kinematic robot keeps the twist of its wheels."""
        if not self._stays_kinematic(body, base):
            self._inner.set_base_state(self._bodies.move_to_full(body), base)
        self._bodies.set_state(body, base)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        bodies = self._bodies
        if bodies.rows.full[body] < 0:
            bodies.kinematic.set_joints(body, positions, velocities)
        if not self._stays_kinematic(body, base):
            self._inner.set_state(bodies.move_to_full(body), base, positions, velocities)
        bodies.set_state(body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`; a robot that may be kinematic there becomes so."""
        bodies, rows = self._bodies, self._bodies.rows
        if rows.is_held[body]:
            self._switcher.forget(body)
            bodies.stand_still(body, positions)
            if rows.full[body] >= 0 and self._starts_kinematic(base, float(rows.heights[0, body])):
                bodies.move_to_kinematic(body)
            if not self._stays_kinematic(body, base):
                self._inner.set_at_rest(bodies.move_to_full(body), base, positions)
        else:
            self._inner.set_at_rest(int(rows.full[body]), base, positions)
        bodies.set_state(body, base)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        mapping = self._bodies.mappings.get(bodies)
        if not len(mapping.held):
            self._inner.command(mapping.bodies, targets)
            return
        pool = self._bodies.kinematic.targets.numbers
        pool[mapping.pooled_targets] = targets[mapping.held_targets]
        self._bodies.commanded.update(mapping.held)
        if mapping.bodies:
            self._inner.command(mapping.bodies, targets[mapping.full.targets])

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`; no effect on robots that are always kinematic."""
        if self._can_be_pushed(body):
            self._inner.apply_link_wrench(
                self._bodies.move_to_full(body, at_once=True), link, wrench
            )

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`; no effect on robots that are always kinematic."""
        if self._can_be_pushed(body):
            self._inner.apply_joint_effort(
                self._bodies.move_to_full(body, at_once=True), joint, effort
            )

    def replicate(self, bodies: Sequence[int], count: int) -> EngineReplicas:
        """See `Engine.replicate`; refuses a world with robots that may be kinematic."""
        if self._bodies.held_count:
            raise EngineRefused("kinematic robots cannot be copied; use full dynamics")
        return self._inner.replicate(self._bodies.mappings.get(bodies).bodies, count)

    def step(self) -> bool:
        """See `Engine.step`: check proximity, move kinematic robots, then step the full engine."""
        bodies = self._bodies
        if not bodies.held_count:
            return self._inner.step()
        if self._steps_to_check == 0:
            self._switcher.update()
            self._steps_to_check = self._every
        self._steps_to_check -= 1
        bodies.gather()
        self._move_kinematic()
        bodies.invalidate_reading()
        return self._inner.step() if bodies.movers or bodies.jointed else True

    def _move_kinematic(self) -> None:
        kinematic = self._bodies.kinematic
        twists, way = kinematic.propose_motions()
        if way.shape[1]:
            fractions = self._bodies.surroundings.find_free_fractions(way)
            self._stopped = {}
            if fractions.min() < 1.0:
                held = np.flatnonzero(fractions < 1.0)
                self._stopped = dict(
                    zip(kinematic.rows[held].tolist(), way[:2, held].T.copy(), strict=True)
                )
            kinematic.commit(twists, way, fractions)

    def _verify_model(self, model: Model, base: FloatArray) -> None:
        """Check that the full engine accepts a model, before a robot switches to it."""
        if id(model) in self._verified:
            return
        self._inner.remove(self._inner.add(model, base))
        self._verified[id(model)] = model
        if len(self._verified) > MAX_VERIFIED_MODELS:
            del self._verified[next(iter(self._verified))]

    def _starts_kinematic(self, base: FloatArray, low: float) -> bool:
        return self._is_on_flat_ground(base, low) and not base[7:].any()

    def _is_on_flat_ground(self, base: FloatArray, low: float) -> bool:
        """Whether a robot at `base` stands upright on the ground plane."""
        return self._has_flat_ground and is_level_on_ground(base, low)

    def _stays_kinematic(self, body: int, base: FloatArray) -> bool:
        """Whether a kinematic robot that is moved to `base` remains kinematic."""
        rows = self._bodies.rows
        if rows.full[body] >= 0:
            return False
        if not rows.is_auto[body]:
            return True
        is_rolling = not base[7:].any() or matches_planar_twist(
            base, self._bodies.kinematic.twist(body)
        )
        return is_rolling and self._is_on_flat_ground(base, float(rows.heights[0, body]))

    def _can_be_pushed(self, body: int) -> bool:
        rows = self._bodies.rows
        return bool(rows.tier[body] == Tier.FULL or rows.is_auto[body])
