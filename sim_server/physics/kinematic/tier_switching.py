"""Bodies of both tiers, and when `auto` robots switch between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.kinematic.kinematic_robots import KinematicRobots
from zensim.sim_server.physics.kinematic.proximity import (
    MOVING_M_S,
    ProximityIndex,
    ProximityResult,
)
from zensim.sim_server.physics.kinematic.tier_body_table import (
    IntColumn,
    Tier,
    TierBodyTable,
    TierIndexMapCache,
    rotate_by_heading,
)
from zensim.sim_server.scene.broad_phase import expand_ranges
from zensim.sim_server.scene.convex_shapes import find_bounding_radius
from zensim.sim_server.scene.footprints import MeshTriangles, find_outline

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray
    from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlan, PlanarVehicle

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
