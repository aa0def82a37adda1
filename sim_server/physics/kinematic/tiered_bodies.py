"""Bodies of the tiered engine: which tier each is in, and what is commanded to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.engine import BodyStates, FloatArray, can_move
from zensim.sim_server.physics.kinematic.kinematic_robots import KinematicRobots
from zensim.sim_server.physics.kinematic.proximity_index import ProximityIndex
from zensim.sim_server.physics.kinematic.tier_body_table import (
    IntColumn,
    RowSelection,
    Tier,
    TierBodyTable,
    TierIndexMapCache,
    rotate_by_heading,
)
from zensim.sim_server.scene.convex_shapes import find_bounding_radius
from zensim.sim_server.scene.footprints import MeshTriangles, find_outline

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlan


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

    def __init__(
        self, full: Engine, corners: MeshTriangles, dt_s: float, period_s: float, command_steps: int
    ) -> None:
        self.rows = TierBodyTable()
        self.kinematic = KinematicRobots(self.rows, dt_s, command_steps)
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
