"""The Engine of two tiers: kinematic robots beside a full engine for what may touch."""

from __future__ import annotations

import logging
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
from zensim.sim_server.physics.kinematic.kinematic_replicas import KinematicReplicas
from zensim.sim_server.physics.kinematic.kinematic_robots import KinematicRobots
from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlanCache
from zensim.sim_server.physics.kinematic.proximity_index import (
    MOVING_M_S,
    ProximityIndex,
    ProximityResult,
    step_robots,
)
from zensim.sim_server.physics.kinematic.tier_body_table import (
    IntColumn,
    RowSelection,
    Tier,
    TierBodyTable,
    TierIndexMapCache,
    rotate_by_heading,
)
from zensim.sim_server.scene.broad_phase import expand_ranges
from zensim.sim_server.scene.convex_shapes import find_bounding_radius
from zensim.sim_server.scene.footprints import MeshTriangles, find_outline

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.proto.messages.model_messages import Dynamics, Model, TierName
    from zensim.sim_server.physics.engine import Engine, EngineReplicas, Place
    from zensim.sim_server.physics.engine_config import EngineConfig
    from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlan, PlanarVehicle
    from zensim.sim_server.physics.kinematic.tier_body_table import TierIndexMap

LOG = logging.getLogger(__name__)
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
    """All bodies: kinematic robots, and the others, which are in the full engine.

    Attributes:
        movers: Those in the full engine that can move.
        moving_rows: The same, as an array.
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

    def add(self, row: int, model: Model, plan: PlanarPlan | None, *, is_auto: bool) -> None:
        """Add a body that is not in the full engine."""
        rows = self.rows
        rows.add(row)
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
        if self.is_full(row):
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
        self.rows.tier[row] = Tier.NONE
        self._invalidate()

    def is_full(self, row: int) -> bool:
        """Whether a body is in the full engine."""
        return bool(self.rows.tier[row] == Tier.FULL)

    def register_full(self, row: int) -> None:
        """Record that a body is in the full engine."""
        self.rows.tier[row] = Tier.FULL
        self._has_movers, self._last = False, None

    def move_to_full(self, row: int, *, at_once: bool = False) -> None:
        """Add a body to the full engine if it is not there.

        Args:
            row: Its row.
            at_once: Whether it must move in the next step; a sleeping body wakes a step later.
        """
        if not self.is_full(row):
            self.add_guest(row, WAKING_TURN_RAD_S if at_once else 0.0)
            positions, velocities = self.kinematic.joints(row)
            state = self.rows.states(np.array([row]))[0]
            self._full.set_state(row, state, positions, velocities)
            if row in self.commanded:
                self._full.command([row], self.kinematic.targets_of(row))
            self.rows.tier[row] = Tier.FULL
            self._invalidate(has_movers=False)

    def add_guest(self, row: int, turning: float = 0.0) -> None:
        """Add a copy of a kinematic body to the full engine, with a yaw rate [rad/s]."""
        state = self.rows.states(np.array([row]))[0]
        state[7:12], state[12] = 0.0, turning
        self._full.insert(row, self.models[row], state)

    def move_to_kinematic(self, row: int) -> None:
        """Remove a body from the full engine."""
        self._full.discard(row)
        self.rows.tier[row] = Tier.KINEMATIC
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
        self.movers = tuple(self.moving_rows.tolist())
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
        is_flat = rows.is_auto[discs] & (rows.tier[discs] != Tier.FULL)
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
        is_full = rows.is_auto[discs] & (rows.tier[discs] == Tier.FULL)
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

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """See `Engine.insert`; refuses a model that needs the kinematic tier and cannot use it."""
        bodies, plan = self._bodies, self._plans.plan(model)
        is_auto = self._plans.dynamics(model) == "auto"
        is_full = plan is None or (is_auto and not self._starts_kinematic(base, plan[1].low))
        if is_full:
            self._inner.insert(body, model, base)
        else:
            self._verify_model(body, model, base)
        bodies.add(body, model, plan, is_auto=is_auto)
        if is_full:
            bodies.register_full(body)
        bodies.place(body, base)

    def discard(self, body: int) -> None:
        """See `Engine.discard`."""
        self._bodies.remove(body)
        self._switcher.forget(body)

    def hide(self, body: int) -> None:
        """See `Engine.hide`."""
        if self._bodies.is_full(body):
            self._inner.hide(body)
        else:
            self._bodies.hide(body)

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        self._inner.show(list(filter(self._bodies.is_full, bodies)))
        self._bodies.show(bodies)

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`; kinematic bodies whose discs overlap join the engine."""
        bodies = self._bodies
        near, is_by_edge = (
            self._switcher.find_overlapping(body) if bodies.held_count else ([], False)
        )
        if not bodies.is_full(body) and not near and not is_by_edge:
            return []
        guests: list[int] = []
        try:
            for row in (body, *near):
                if not bodies.is_full(row):
                    bodies.add_guest(row)
                    guests.append(row)
            return sorted(self._inner.find_overlaps(body))
        finally:
            for row in guests:
                self._inner.discard(row)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`; synchronous if there are kinematic bodies."""
        if not self._bodies.is_full(body) or self._bodies.held_count:
            found = self.find_overlaps(body)
            return lambda: found
        return self._inner.find_overlaps_async(body)

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        """See `Engine.read_contacts`; kinematic robots that are stopped feel no force."""
        full = self._bodies.mappings.get(bodies).bodies
        found = self._inner.read_contacts(full) if full else NO_CONTACTS
        return concatenate_contacts([found, self._list_stops(bodies)])

    def _list_stops(self, bodies: Sequence[int]) -> ContactPoints:
        """List where kinematic robots were stopped in the last step."""
        if not self._stopped:
            return NO_CONTACTS
        pairs, points = [], []
        for body in bodies:
            way = self._stopped.get(body)
            if way is None or self._bodies.is_full(body):
                continue
            if (found := self._bodies.surroundings.find_obstacle(body, way)) is not None:
                pairs.append((body, 0, found.row, 0))
                points.append((*found.point, *found.normal.tolist(), *(0.0,) * 5))
        return make_contact_points(pairs, points)

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
            self._bodies.move_to_full(body)
            self._inner.set_base_state(body, base)
        self._bodies.set_state(body, base)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        bodies = self._bodies
        if not bodies.is_full(body):
            bodies.kinematic.set_joints(body, positions, velocities)
        if not self._stays_kinematic(body, base):
            bodies.move_to_full(body)
            self._inner.set_state(body, base, positions, velocities)
        bodies.set_state(body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`; a robot that may be kinematic there becomes so."""
        bodies, rows = self._bodies, self._bodies.rows
        if rows.is_held[body]:
            self._switcher.forget(body)
            bodies.stand_still(body, positions)
            if bodies.is_full(body) and self._starts_kinematic(base, float(rows.heights[0, body])):
                bodies.move_to_kinematic(body)
            if not self._stays_kinematic(body, base):
                bodies.move_to_full(body)
                self._inner.set_at_rest(body, base, positions)
        else:
            self._inner.set_at_rest(body, base, positions)
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
            self._bodies.move_to_full(body, at_once=True)
            self._inner.apply_link_wrench(body, link, wrench)

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`; no effect on robots that are always kinematic."""
        if self._can_be_pushed(body):
            self._bodies.move_to_full(body, at_once=True)
            self._inner.apply_joint_effort(body, joint, effort)

    def replicate(self, bodies: Sequence[int], count: int) -> EngineReplicas:
        """See `Engine.replicate`; all that moves is in one tier, and stays there."""
        own = self._bodies
        if not own.held_count:
            return self._inner.replicate(bodies, count)
        own.gather()
        rows = own.rows
        moves = (rows.tier != Tier.NONE) & ~rows.is_static
        if own.jointed or (rows.is_auto | (rows.tier != Tier.KINEMATIC))[moves].any():
            raise EngineRefused(
                "kinematic robots beside others, or such that change to full dynamics, cannot be "
                "copied; use kinematic or full dynamics for all that moves"
            )
        return KinematicReplicas(own.rows, own.kinematic, own.surroundings, bodies, count)

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
        rows, ways = step_robots(self._bodies.kinematic, self._bodies.surroundings)
        self._stopped = dict(zip(rows.tolist(), ways, strict=True))

    def _verify_model(self, body: int, model: Model, base: FloatArray) -> None:
        """Check that the full engine accepts a model, before a robot switches to it."""
        if id(model) in self._verified:
            return
        self._inner.insert(body, model, base)
        self._inner.discard(body)
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
        if self._bodies.is_full(body):
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
