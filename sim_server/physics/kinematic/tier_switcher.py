"""Moves robots between the planar tier and the physics engine, when that is exact."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.engine import EngineRefused, FloatArray
from zensim.sim_server.physics.kinematic.proximity_index import MOVING_M_S, ProximityResult
from zensim.sim_server.physics.kinematic.tier_body_table import Tier
from zensim.sim_server.scene.broad_phase import expand_ranges

if TYPE_CHECKING:
    from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarVehicle
    from zensim.sim_server.physics.kinematic.tiered_bodies import TieredBodies


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
FALL_MARGIN_M_S2 = 20.0
"""Bound of the acceleration of bodies in the full engine."""


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
