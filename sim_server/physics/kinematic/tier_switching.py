"""Bodies of both tiers, and when `auto` robots switch between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.kinematic.collision_limits import (
    DiscMotions,
    find_distances_to_edges,
    limit_by_edges,
    limit_by_other_discs,
)
from zensim.sim_server.physics.kinematic.kinematic_robots import CLEARABLE_HEIGHT_M, KinematicRobots
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
    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray
    from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlan, PlanarVehicle

NEAR_M = 0.02
"""Discs with a smaller gap are near each other, if one of them moves."""
CLEAR_M = 0.06
"""Discs with a larger gap to all others are clear."""
NEIGHBOUR_MARGIN_M = 2.0 * CLEAR_M
MOVING_M_S = 1e-3


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
        if self._is_valid and (
            self._travelled_m < MIN_TRAVEL_M or not self._is_too_far(centres, way)
        ):
            return
        self._travelled_m = 0.0
        self._centres = centres.copy()
        self._allowed = np.maximum(MIN_TRAVEL_M, LOOKAHEAD_CHECKS * way)
        reach = radius + self._allowed + self._margin_m / 2.0
        self.one, self.other = find_touching_discs(centres, reach)
        self.disc, self.edge = self._near_edges(centres, reach + self._margin_m / 2.0)
        self._is_valid = True

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
        discs = np.flatnonzero((table.tier != Tier.NONE) & ~table.is_static)
        if not np.array_equal(discs, self.discs):
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
        rows = np.flatnonzero((table.tier != Tier.NONE) & ~table.is_static)
        rows = rows[rows != row]
        centre = table.discs(np.array([row]))
        apart = np.hypot(*(table.discs(rows) - centre).T)
        found: list[int] = rows[apart < table.radius[rows] + table.radius[row]].tolist()
        edges = self._static_edges()
        if not len(edges):
            return found, False
        _, gap = find_distances_to_edges(np.broadcast_to(centre, (len(edges), 2)), edges.ends)
        return found, bool((gap < edges.thick + table.radius[row]).any())

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
        self.movers: tuple[int, ...] = ()
        self.moving_rows: IntColumn = np.zeros(0, np.intp)
        self._full = full
        self._corners = corners
        self._pending_outlines: dict[int, FloatArray] = {}
        self._is_gathered = True
        self._last: tuple[tuple[int, ...], BodyStates] | None = None

    def add(self, model: Model, plan: PlanarPlan | None, *, is_auto: bool) -> int:
        """Add a row for a body that is not in the full engine."""
        rows, row = self.rows, self.rows.allocate()
        self.models[row] = model
        rows.tier[row] = Tier.KINEMATIC
        rows.joint_count[row], rows.width[row] = len(model.joints), model.target_count
        rows.is_static[row] = model.is_static
        if plan is not None:
            vehicle, footprint = plan
            rows.is_held[row], rows.is_auto[row] = True, is_auto
            rows.radius[row], rows.centre[:, row] = footprint.radius_m, footprint.centre
            rows.heights[:, row] = footprint.low, footprint.high
            self.kinematic.add(row, vehicle)
            self.held_count += 1
        self._invalidate()
        return row

    def remove(self, row: int) -> None:
        """Remove a body from its tier."""
        if self.rows.full[row] >= 0:
            self.move_to_kinematic(row)
        if self.rows.is_held[row]:
            self.kinematic.remove(row)
            self.held_count -= 1
        self.surroundings.remove_outline(row)
        self._pending_outlines.pop(row, None)
        self.commanded.discard(row)
        del self.models[row]
        self.rows.free(row)
        self._invalidate()

    def register_full(self, row: int, number: int) -> None:
        """Record the number of a body in the full engine."""
        rows = self.rows
        rows.full[row], rows.tier[row] = number, Tier.FULL
        self.numbers[number] = row
        self._invalidate()

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
            self._invalidate()
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
        self._invalidate()

    def set_state(self, row: int, base: FloatArray) -> None:
        """Record the state (13,) of a body that a request set."""
        if self.rows.is_static[row]:
            self._pending_outlines[row] = base.copy()
        elif self.held_count:
            self.record_states(np.array([row]), base[None])
        self.surroundings.invalidate()
        self._last = None
        self._is_gathered = False

    def record_states(self, rows: IntColumn, base: FloatArray) -> None:
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
        if self._is_gathered:
            return
        table = self.rows
        for row, base in self._pending_outlines.items():
            self.surroundings.set_outline(row, find_outline(self.models[row], base, self._corners))
        self._pending_outlines.clear()
        self.kinematic.gather()
        self.surroundings.gather()
        self.moving_rows = np.flatnonzero((table.tier == Tier.FULL) & ~table.is_static)
        self.movers = tuple(table.full[self.moving_rows].tolist())
        for row in self.moving_rows[table.radius[self.moving_rows] <= 0.0].tolist():
            table.radius[row] = max(
                find_bounding_radius(self.models[row], self._corners, unlimited_m=0.0), MIN_RADIUS_M
            )
        self._is_gathered = True

    def _invalidate(self) -> None:
        self._last = None
        self._is_gathered = False
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
            bodies.move_to_full(row)
        self._release_settled(proximity, discs)

    def find_overlapping(self, row: int) -> tuple[list[int], bool]:
        """Find the rows of discs that a disc overlaps now, and whether it overlaps an edge."""
        self._bodies.gather()
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
