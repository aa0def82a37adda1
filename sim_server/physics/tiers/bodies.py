"""The bodies of two tiers: what is known of each, and how it goes from one to the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.rotation import to_yaw
from zensim.sim_server.physics.tiers.footprint import Corners, reach_of
from zensim.sim_server.physics.tiers.kinematic import Kinematic
from zensim.sim_server.physics.tiers.mapping import Mappings
from zensim.sim_server.physics.tiers.outline import outline_of
from zensim.sim_server.physics.tiers.rows import IntColumn, Rows, Tier, turned
from zensim.sim_server.physics.tiers.surroundings import Surroundings

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray
    from zensim.sim_server.physics.tiers.planning import FlatPlan

HARDLY = 1e-9
"""An engine makes a body that moves anew [rad/s]."""
LEAST_M = 1e-3
"""Radius of what collides with nothing."""


class Bodies:
    """Rows, who drives flat among them, and the full engine that has all others.

    Attributes:
        numbers: The row of each body of the full engine.
        movers: Those of them that can move, and `moving_rows` theirs.
        told: Rows of robots that were commanded since they rested.
        held: How many may be in the kinematic tier.
    """

    def __init__(self, full: Engine, corners: Corners, dt_s: float, period_s: float) -> None:
        self.rows = Rows()
        self.kinematic = Kinematic(self.rows, dt_s)
        self.surroundings = Surroundings(self.rows, self.kinematic, period_s)
        self.mappings = Mappings(self.rows)
        self.models: dict[int, Model] = {}
        self.numbers: dict[int, int] = {}
        self.told: set[int] = set()
        self.held = 0
        self.movers: tuple[int, ...] = ()
        self.moving_rows: IntColumn = np.zeros(0, np.intp)
        self._full = full
        self._corners = corners
        self._unlined: dict[int, FloatArray] = {}
        self._is_gathered = True
        self._last: tuple[tuple[int, ...], BodyStates] | None = None

    def take(self, model: Model, plan: FlatPlan | None, *, is_auto: bool) -> int:
        """Make a row of a body that is in no engine yet."""
        rows, row = self.rows, self.rows.take()
        self.models[row] = model
        rows.tier[row] = Tier.KINEMATIC
        rows.joint_count[row], rows.width[row] = len(model.joints), model.target_count
        rows.is_static[row] = model.is_static
        if plan is not None:
            vehicle, footprint = plan
            rows.is_held[row], rows.is_auto[row] = True, is_auto
            rows.radius[row], rows.centre[:, row] = footprint.radius_m, footprint.centre
            rows.heights[:, row] = footprint.low, footprint.high
            self.kinematic.admit(row, vehicle)
            self.held += 1
        self._changed()
        return row

    def give_back(self, row: int) -> None:
        """Forget a body, in whatever tier it is."""
        if self.rows.full[row] >= 0:
            self.leave_full(row)
        if self.rows.is_held[row]:
            self.kinematic.dismiss(row)
            self.held -= 1
        self.surroundings.clear(row)
        self._unlined.pop(row, None)
        self.told.discard(row)
        del self.models[row]
        self.rows.give_back(row)
        self._changed()

    def belong(self, row: int, number: int) -> None:
        """Note that a body is one of the full engine."""
        rows = self.rows
        rows.full[row], rows.tier[row] = number, Tier.FULL
        self.numbers[number] = row
        self._changed()

    def in_full(self, row: int, *, at_once: bool = False) -> int:
        """Find the number of a body in the full engine; put it there if it is not.

        Args:
            row: Its row.
            at_once: Whether it must move in the next step: what slept in an engine stands for one.
        """
        rows = self.rows
        if rows.full[row] < 0:
            number = self.visit(row, HARDLY if at_once else 0.0)
            positions, velocities = self.kinematic.joints(row)
            state = rows.states(np.array([row]))[0]
            self._full.put(number, state, positions, velocities)
            if row in self.told:
                self._full.command([number], self.kinematic.told(row))
            rows.full[row], rows.tier[row] = number, Tier.FULL
            self.numbers[number] = row
            self._changed()
        return int(rows.full[row])

    def visit(self, row: int, turning: float = 0.0) -> int:
        """Make a body in the full engine where a kinematic one is, turning so fast [rad/s]."""
        state = self.rows.states(np.array([row]))[0]
        state[7:12], state[12] = 0.0, turning
        return self._full.add(self.models[row], state)

    def leave_full(self, row: int) -> None:
        """Take a body out of the full engine."""
        number = int(self.rows.full[row])
        self._full.remove(number)
        del self.numbers[number]
        self.rows.full[row], self.rows.tier[row] = -1, Tier.KINEMATIC
        self._changed()

    def set_state(self, row: int, base: FloatArray) -> None:
        """Note where a body was put (13,)."""
        if self.rows.is_static[row]:
            self._unlined[row] = base.copy()
        elif self.held:
            self.see(np.array([row]), base[None])
        self.surroundings.moved()
        self._last = None
        self._is_gathered = False

    def see(self, rows: IntColumn, base: FloatArray) -> None:
        """Note where bodies are (n, 13)."""
        known, yaw = self.rows, to_yaw(base[:, 3:7])
        known.place[:, rows] = base[:, :3].T
        known.turn_to(rows, yaw)
        sin, cos = known.half[:, rows]
        x, y, z, w = base[:, 3:7].T
        known.tilt[:, rows] = (
            *(cos * x + sin * y, cos * y - sin * x),
            *(cos * z - sin * w, cos * w + sin * z),
        )
        cos, sin = known.headings(rows)
        known.twist[:2, rows] = turned(base[:, 7], base[:, 8], (cos, -sin))
        known.twist[2, rows] = base[:, 12]

    def stand_still(self, row: int, positions: FloatArray | None) -> None:
        """Let a robot stand, its joints at `positions` or zero, and told nothing."""
        count = int(self.rows.joint_count[row])
        angles = np.zeros(count) if positions is None else positions
        self.told.discard(row)
        self.kinematic.set_targets(row, np.zeros(int(self.rows.width[row])))
        self.kinematic.set_joints(row, angles, np.zeros(count))

    def read_full(self, numbers: tuple[int, ...]) -> BodyStates:
        """Read bodies of the full engine, those that were asked for last not again in a step."""
        if self._last is None or self._last[0] != numbers:
            self._last = (numbers, self._full.read(numbers))
        return self._last[1]

    def forget_reading(self) -> None:
        """Note that bodies of the full engine are elsewhere."""
        self._last = None

    def gather(self) -> None:
        """Find who is where, if that has changed."""
        if self._is_gathered:
            return
        known = self.rows
        for row, base in self._unlined.items():
            self.surroundings.stand(row, outline_of(self.models[row], base, self._corners))
        self._unlined.clear()
        self.kinematic.gather()
        self.surroundings.gather()
        self.moving_rows = np.flatnonzero((known.tier == Tier.FULL) & ~known.is_static)
        self.movers = tuple(known.full[self.moving_rows].tolist())
        for row in self.moving_rows[known.radius[self.moving_rows] <= 0.0].tolist():
            known.radius[row] = max(reach_of(self.models[row], self._corners), LEAST_M)
        self._is_gathered = True

    def _changed(self) -> None:
        self._last = None
        self._is_gathered = False
        self.mappings.forget()
