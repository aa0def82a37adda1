"""The Engine of two tiers: kinematic robots beside a full engine for what may touch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zensim.sim_server.physics.engine import BodyStates, FloatArray
from zensim.sim_server.physics.engine_layer import EngineLayer
from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlanCache
from zensim.sim_server.physics.kinematic.tier_body_table import Tier
from zensim.sim_server.physics.kinematic.tier_switching import (
    TieredBodies,
    TierSwitcher,
    is_level_on_ground,
    matches_planar_twist,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.proto.messages.model_messages import Dynamics, Model, TierName
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.physics.engine_config import EngineConfig
    from zensim.sim_server.physics.kinematic.tier_body_table import TierIndexMap

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

    def tier_of(self, body: int) -> TierName:
        """See `Engine.tier_of`."""
        return "kinematic" if self._bodies.rows.tier[body] == Tier.KINEMATIC else "full"

    @property
    def kinematic_count(self) -> int:
        """See `Engine.kinematic_count`."""
        return int((self._bodies.rows.tier == Tier.KINEMATIC).sum())

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
        bodies.set_state(row, base)
        return row

    def remove(self, body: int) -> None:
        """See `Engine.remove`."""
        self._bodies.remove(body)
        self._switcher.forget(body)

    def hide(self, body: int) -> None:
        """See `Engine.hide`; kinematic bodies are not hidden."""
        if (number := int(self._bodies.rows.full[body])) >= 0:
            self._inner.hide(number)

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        numbers = self._bodies.rows.full[list(bodies)]
        self._inner.show(numbers[numbers >= 0].tolist())

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`; kinematic bodies whose discs overlap join the engine."""
        bodies = self._bodies
        full = bodies.rows.full
        guests, is_by_edge = (
            self._switcher.find_overlapping(body) if bodies.held_count else ([], False)
        )
        if full[body] < 0 and not guests and not is_by_edge:
            return []
        guests = [row for row in (body, *guests) if full[row] < 0]
        guest_numbers = {row: bodies.add_guest(row) for row in guests}
        rows = {**bodies.numbers, **{number: row for row, number in guest_numbers.items()}}
        mine = guest_numbers.get(body, int(full[body]))
        found = sorted(rows[other] for other in self._inner.find_overlaps(mine))
        for number in guest_numbers.values():
            self._inner.remove(number)
        return found

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`; synchronous if there are kinematic bodies."""
        number = int(self._bodies.rows.full[body])
        if number < 0 or self._bodies.held_count:
            found = self.find_overlaps(body)
            return lambda: found
        wait, rows = self._inner.find_overlaps_async(number), self._bodies.numbers
        return lambda: sorted(rows[other] for other in wait() if other in rows)

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
        return self._inner.step() if bodies.movers else True

    def _move_kinematic(self) -> None:
        kinematic = self._bodies.kinematic
        twists, way = kinematic.propose_motions()
        if way.shape[1]:
            kinematic.commit(twists, way, self._bodies.surroundings.find_free_fractions(way))

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
