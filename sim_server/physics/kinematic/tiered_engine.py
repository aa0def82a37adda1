"""The Engine of two tiers: kinematic robots beside a full engine for what may touch."""

from __future__ import annotations

from itertools import compress
from typing import TYPE_CHECKING

import numpy as np

from zensim.sim_server.physics.engine import (
    NO_CONTACTS,
    BodyStates,
    ContactPoints,
    EngineRefused,
    FloatArray,
    concatenate_contacts,
    make_contact_points,
    make_unknown_efforts,
)
from zensim.sim_server.physics.engine_layer import EngineLayer
from zensim.sim_server.physics.kinematic.kinematic_replicas import KinematicReplicas
from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarPlanCache
from zensim.sim_server.physics.kinematic.proximity_index import step_robots
from zensim.sim_server.physics.kinematic.tier_body_table import Tier
from zensim.sim_server.physics.kinematic.tier_switcher import (
    TierSwitcher,
    is_level_on_ground,
    matches_planar_twist,
)
from zensim.sim_server.physics.kinematic.tiered_bodies import TieredBodies

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.proto.messages.model_messages import Dynamics, Model, TierName
    from zensim.sim_server.physics.engine import Engine, EngineReplicas, Place
    from zensim.sim_server.physics.engine_config import EngineConfig
    from zensim.sim_server.physics.kinematic.tier_body_table import TierIndexMap

PROXIMITY_PERIOD_S = 0.02
"""Period of proximity checks; at least one step."""
MAX_VERIFIED_MODELS = 256


class TieredEngine(EngineLayer):
    """Robots in the kinematic tier, all else in a full engine; `auto` robots switch."""

    def __init__(
        self, full: Engine, config: EngineConfig, default: Dynamics, period_steps: int = 1
    ) -> None:
        """Make it without bodies; `period_steps` are those between two control steps."""
        super().__init__(full)
        self._plans = PlanarPlanCache(config, default)
        gx, gy, gz = config.gravity
        self._has_flat_ground = config.has_ground and gx == gy == 0.0 and gz < 0.0
        dt_s = config.step_ns * 1e-9
        self._every = max(1, round(PROXIMITY_PERIOD_S / dt_s))
        self._steps_to_check = 0
        period_s = self._every * dt_s
        self._bodies = TieredBodies(full, self._plans.corners, dt_s, period_s, period_steps)
        self._switcher = TierSwitcher(self._bodies, period_s)
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
