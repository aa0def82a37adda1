"""Robots that look around: who has to be full before it may touch anything, who may be flat."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zensim.sim_server.physics.tiers.lookout import MOVING_M_S, Sight
from zensim.sim_server.physics.tiers.rows import spans
from zensim.sim_server.physics.tiers.switching import SETTLED_S, goes_flat, has_reached, stands_flat

if TYPE_CHECKING:
    from zensim.sim_server.physics.engine import FloatArray
    from zensim.sim_server.physics.tiers.bodies import Bodies

FALL_M_S2 = 20.0
"""What anything loose may gain between two looks."""


class Watching:
    """Moves `auto` robots between the tiers.

    Robots are taken in the order of their rows, so that the same requests give the same bodies.
    """

    def __init__(self, bodies: Bodies, period_s: float) -> None:
        self._bodies = bodies
        self._period_s = period_s
        self._calm_s: dict[int, float] = {}
        self._seen: dict[int, FloatArray] = {}

    def forget(self, row: int) -> None:
        """Note that a robot was taken out, or set to rest."""
        self._calm_s.pop(row, None)

    def look(self) -> None:
        """See where all are, and change the tiers of those that have to or may."""
        bodies, rows = self._bodies, self._bodies.rows
        bodies.gather()
        self._see_full()
        if not rows.is_auto.any():
            return
        bodies.kinematic.note_paces()
        sight = bodies.surroundings.look()
        discs = bodies.surroundings.discs
        needs_full = sight.is_near | rows.is_harsh[discs]
        is_flat = rows.is_auto[discs] & (rows.full[discs] < 0)
        for row in discs[is_flat & needs_full].tolist():
            bodies.in_full(row)
        self._calm_down(sight, discs)

    def within(self, row: int) -> tuple[list[int], bool]:
        """Find whose discs a disc reaches into now, and whether it reaches an edge."""
        self._bodies.gather()
        if self._bodies.movers:
            self._see_full()
        return self._bodies.surroundings.within(row)

    def _see_full(self) -> None:
        bodies, rows = self._bodies, self._bodies.rows
        if not bodies.movers:
            return
        reading, moving = bodies.read_full(bodies.movers), bodies.moving_rows
        base = reading.base
        good = np.isfinite(base).all(axis=1)
        bodies.see(moving[good], base[good])
        self._seen = dict(zip(moving.tolist(), base, strict=True))
        speed = np.linalg.norm(base[:, 7:10], axis=1)
        falling = np.where(speed > MOVING_M_S, speed + FALL_M_S2 * self._period_s, 0.0)
        rows.pace[moving] = np.where(good, falling, 0.0)
        counts = rows.joint_count[moving]
        is_held = rows.is_held[moving]
        at = np.cumsum(counts) - counts
        mine = spans(at[is_held], counts[is_held])
        pooled = spans(rows.joint_start[moving[is_held]], counts[is_held])
        bodies.kinematic.positions.numbers[pooled] = reading.joint_positions[mine]
        bodies.kinematic.velocities[pooled] = reading.joint_velocities[mine]

    def _calm_down(self, sight: Sight, discs: np.ndarray[tuple[int], np.dtype[np.intp]]) -> None:
        rows = self._bodies.rows
        is_full = rows.is_auto[discs] & (rows.full[discs] >= 0)
        is_calm = is_full & sight.is_alone & ~rows.is_harsh[discs]
        for row in discs[is_full & ~is_calm].tolist():
            self._calm_s[row] = 0.0
        for row in discs[is_calm].tolist():
            calm_s = self._calm_s.get(row, 0.0) + self._period_s
            if calm_s >= SETTLED_S and self._may_be_flat(row):
                self._bodies.leave_full(row)
                calm_s = 0.0
            self._calm_s[row] = min(calm_s, SETTLED_S)

    def _may_be_flat(self, row: int) -> bool:
        bodies, base = self._bodies, self._seen.get(row)
        if base is None or not stands_flat(base, float(bodies.rows.heights[0, row])):
            return False
        kinematic, vehicle = bodies.kinematic, bodies.kinematic.vehicle(row)
        _, velocities = kinematic.joints(row)
        if not has_reached(vehicle, kinematic.told(row), velocities):
            return False
        return goes_flat(base, kinematic.twist(row))
