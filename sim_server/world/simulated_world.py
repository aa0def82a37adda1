"""The simulated world: entities with bodies and claims, stepped by an engine."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState, OnRelease
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Joint, Link, Model
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.proto.messages.telemetry_messages import Snapshot
from zensim.sim_server.description.model_geometry import find_child_pose, find_start_positions
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import IncorrectState
from zensim.sim_server.physics.actuation import make_stop_targets
from zensim.sim_server.physics.engine import (
    BodyStates,
    Engine,
    EngineLost,
    EngineRefused,
    FloatArray,
    Place,
    can_move,
    refuse_faults,
)
from zensim.sim_server.scene.convex_shapes import MeshVertices
from zensim.sim_server.scene.scene import CollisionScene, FindTriangles, SceneLayout
from zensim.sim_server.world.applied_forces import AppliedForces
from zensim.sim_server.world.body_models import BodyModels
from zensim.sim_server.world.claim_registry import (
    ClaimedEntities,
    ClaimRegistry,
    EffortPlan,
    make_effort_plan,
)
from zensim.sim_server.world.commanded_twists import CommandedTwists
from zensim.sim_server.world.entity import Entity, EntityIndex, default_info
from zensim.sim_server.world.entity_store import EntityStore
from zensim.sim_server.world.fall_watch import CHECK_PERIOD_NS, FallWatch
from zensim.sim_server.world.injected_faults import BodyFault, InjectedFaults
from zensim.sim_server.world.simulation_clock import SimulationClock
from zensim.sim_server.world.spawn_request import ValidatedSpawn

MAX_COORDINATE_M = 1e6
"""Largest valid coordinate: ten times the limit of requested poses."""
PROBATION_NS = 1_000_000_000
"""An entity that diverges again within this simulation time is frozen."""
FROZEN_MESSAGE = (
    "frozen at its last valid state: its state was not finite or out of range; "
    "set its state, reset the world, or delete it"
)
FROZEN_BY_FAULT = (
    "frozen at its last valid state: the engine failed for it; "
    "set its state, reset the world, or delete it"
)
SILENT_MESSAGE = "stopped: its agent has sent no command for 0.4 s"
RESET_TO_REST_MESSAGE = (
    "put at rest at its last valid state: it diverged together with another entity"
)


@dataclass(frozen=True)
class RestState:
    """State of an entity at rest.

    Attributes:
        base: State row (13,), velocities 0.
        positions: Joint positions in the order of `Model.joints`.
    """

    base: FloatArray
    positions: FloatArray


class DivergenceGuard:
    """The last valid states, and the frozen entities."""

    def __init__(self) -> None:
        self._frozen: dict[str, RestState] = {}
        self._diverged_ns: dict[str, int] = {}
        self._new_names: set[str] = set()
        self._index: EntityIndex | None = None
        self._states: BodyStates | None = None

    @property
    def frozen(self) -> tuple[str, ...]:
        """Names of the frozen entities."""
        return tuple(self._frozen)

    def is_frozen(self, name: str) -> bool:
        """Whether an entity is frozen."""
        return name in self._frozen

    def require_not_frozen(self, name: str) -> None:
        """Check that an entity is not frozen.

        Raises:
            IncorrectState: The entity is frozen.
        """
        if self.is_frozen(name):
            raise IncorrectState(f"entity '{name}' is {FROZEN_MESSAGE}")

    def find_diverged(self, index: EntityIndex, states: BodyStates) -> list[str]:
        """Name the entities whose state is not valid, except frozen ones."""
        if is_valid_state(states):
            return []
        base = states.base
        is_diverged = ~np.isfinite(base).all(axis=1) | (np.abs(base[:, :3]) > MAX_COORDINATE_M).any(
            axis=1
        )
        owner = np.repeat(np.arange(len(index.names)), index.joint_count)
        rows = set(np.flatnonzero(is_diverged).tolist())
        for numbers in (states.joint_positions, states.joint_velocities):
            rows.update(owner[~np.isfinite(numbers)].tolist())
        names = [index.names[row] for row in sorted(rows)]
        return [name for name in names if name not in self._frozen]

    def find_culprits(self, diverged: Sequence[Entity], time_ns: int) -> set[str]:
        """Choose which of the entities that diverged in the same step are frozen.

        Those that diverge again within `PROBATION_NS`, or else the fastest. Entities that cannot
        move are never the cause.
        """
        names = [entity.name for entity in diverged if can_move(entity.model)]
        repeated = {
            name
            for name in names
            if time_ns - self._diverged_ns.get(name, -PROBATION_NS) < PROBATION_NS
        }
        self._diverged_ns.update(dict.fromkeys(names, time_ns))
        return repeated or set(sorted(names, key=self._speed_of)[-1:])

    def last_valid_state(self, entity: Entity) -> RestState:
        """Find the last valid state of an entity, at rest; its initial state if there is none."""
        base, positions = entity.initial, list_start_positions(entity.model)
        if (found := self._last(entity.name)) is not None:
            base, positions, _ = found
        row = base.copy()
        row[7:] = 0.0
        return RestState(row, positions.copy())

    def freeze(self, entity: Entity) -> RestState:
        """Mark an entity as frozen."""
        return self._frozen.setdefault(entity.name, self.last_valid_state(entity))

    def find_frozen(self, name: str) -> RestState | None:
        """Find the state of a frozen entity; None if it is not frozen."""
        return self._frozen.get(name)

    def unfreeze(self, name: str) -> None:
        """Mark an entity as not frozen."""
        self._diverged_ns.pop(name, None)
        self._frozen.pop(name, None)

    def forget(self, name: str) -> None:
        """Forget a deleted entity: a new one of the same name does not get its states."""
        self.unfreeze(name)
        self._new_names.add(name)

    def forget_all(self) -> None:
        """Forget all valid states, after a reset; frozen entities stay frozen."""
        self._diverged_ns.clear()
        self._index = self._states = None

    def complete(self, index: EntityIndex, states: BodyStates) -> BodyStates:
        """Fill in the joint positions of frozen entities."""
        for name, rest in self._frozen.items():
            states.joint_positions[index.joints_of(name)] = rest.positions
        return states

    def remember(self, index: EntityIndex, states: BodyStates) -> None:
        """Store states as the last valid ones."""
        self._index, self._states = index, states
        self._new_names.clear()

    def _last(self, name: str) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        index, states = self._index, self._states
        if index is None or states is None or name in self._new_names:
            return None
        if (row := index.row.get(name)) is None:
            return None
        joints = index.joints_of(name)
        return states.base[row], states.joint_positions[joints], states.joint_velocities[joints]

    def _speed_of(self, name: str) -> float:
        if (found := self._last(name)) is None:
            return np.inf
        base, _, velocities = found
        return float(np.abs(np.concatenate([base[7:], velocities])).max())


def is_valid_state(states: BodyStates) -> bool:
    """Test quickly whether all states are valid; False may be wrong for very large values."""
    # A sum is finite only if all its terms are: one pass over each array.
    sums = states.base.sum() + states.joint_positions.sum() + states.joint_velocities.sum()
    return bool(np.isfinite(sums)) and bool(
        np.abs(states.base[:, :3]).max(initial=0.0) <= MAX_COORDINATE_M
    )


def make_frozen_model(model: Model, positions: FloatArray) -> Model:
    """Make a static copy of a model with its joints fixed at these positions."""
    joints = tuple(
        _fix_joint(joint, position)
        for joint, position in zip(model.joints, positions.tolist(), strict=True)
    )
    return msgspec.structs.replace(
        model, joints=joints, drive=None, joint_controllers=(), is_static=True, dynamics=""
    )


def make_bare_model(model: Model) -> Model:
    """Make a copy of a frozen model without collisions, which any engine can simulate."""
    return msgspec.structs.replace(model, links=tuple(Link(link.name) for link in model.links))


def _fix_joint(joint: Joint, position: float) -> Joint:
    return msgspec.structs.replace(
        joint, kind="fixed", origin=find_child_pose(joint, position), mimic=None
    )


MAX_STATE_AGE_NS = 25_000_000
"""Simulation time for which the states of the last control step are reported again."""


class SavedWorld:
    """State of a `SimulatedWorld`: its attributes."""

    def __init__(self, attributes: Mapping[str, Any]) -> None:
        self.__dict__.update(attributes)


def list_start_positions(model: Model) -> FloatArray:
    """List the positions [rad or m] of joints at the start, in the order of `Model.joints`."""
    found = find_start_positions(model)
    return np.array([found[joint.name] for joint in model.joints])


class SimulatedWorld:
    """One engine, one clock, the entities, and the claims of agents on them.

    Every entity, staged ones included, has exactly one body in the engine.
    """

    def __init__(self, engine: Engine, *, name: str, step_ns: int, control_steps: int) -> None:
        self.name = name
        self.control_steps = control_steps
        self.engine = engine
        """Engine for queries; only the world adds, removes and changes bodies."""
        self.clock = SimulationClock(step_ns=step_ns)
        self.entities = EntityStore()
        self.claims = ClaimRegistry()
        self.applied_forces = AppliedForces()
        self.injected_faults = InjectedFaults()
        self.divergence_guard = DivergenceGuard()
        self.commanded_twists = CommandedTwists()
        self.placement_count = 0
        """Counts poses that were set."""
        self.ready_s: dict[str, float] = {}
        """Time from spawn to the first command of its agent, by name of entity."""
        self._body_models = BodyModels()
        self._recorded_changes: dict[str, int] = {}
        self.fall_watch = FallWatch()
        self._initial_z: tuple[EntityIndex, FloatArray] | None = None
        self._joint_targets: dict[str, FloatArray] = {}
        """Newest targets of entities with controlled joints."""
        self._effort_plan: EffortPlan | None = None
        self._scene_layouts: tuple[EntityIndex, dict[bool, SceneLayout]] | None = None
        self._support_layout: tuple[tuple[tuple[str, int], ...], SceneLayout] | None = None
        self._states: BodyStates | None = None
        self._states_step = 0
        """The step that the states are of."""
        self._has_invalid_body = False
        """Whether the last step reported one, which is not necessarily read."""

    @property
    def is_control_step(self) -> bool:
        """Whether agents get the states of this step."""
        return self.clock.steps % self.control_steps == 0

    @property
    def is_idle(self) -> bool:
        """Whether the engine has finished all calls; polled in each iteration of the loop."""
        return self.engine.is_idle()

    def prepare(self, model: Model) -> bool:
        """Make a part of what `spawn` needs for a model; return whether nothing is left."""
        try:
            with refuse_faults(f"model '{model.name}'"):
                return self.engine.prepare(self._body_models.find(model))
        except EngineRefused:
            return True  # as `spawn` will raise it

    def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:
        """Announce the models of bodies that are spawned next; see `Engine.expect`."""
        self.engine.expect(list(map(self._body_models.find, models)), places)

    def resolve_names_for(self, spawn: ValidatedSpawn) -> tuple[str, str]:
        """Find the name and namespace that an entity would get; raises as `spawn` does."""
        return spawn.resolve_names(self.entities)

    def spawn(self, spawn: ValidatedSpawn) -> Entity:
        """Add an entity.

        Raises:
            NameNotUnique: The name is taken and renaming is not allowed.
            NameRefused: The name is not valid.
            NamespaceRefused: The namespace is not valid, or another entity has it.
            EngineRefused: The engine cannot simulate the model.
        """
        entity = self._add_staged(spawn)
        self._commit(entity)
        return entity

    def spawn_and_find_overlaps(self, spawn: ValidatedSpawn) -> tuple[Entity, list[str]]:
        """Add an entity, and name the entities that it overlaps; raises as `spawn` does."""
        entity = self._add_staged(spawn)
        with self._rollback_on_refusal(entity):
            overlapped = self.find_overlaps(entity)
        self._commit(entity)
        return entity, overlapped

    def stage_spawn(self, spawn: ValidatedSpawn) -> tuple[Entity, Callable[[], list[str]]]:
        """Reserve names and make a body that is hidden until `commit_staged`; raises as `spawn`.

        Returns:
            The entity, and a function that names the entities that it overlaps. The function waits
            for the engine unless `is_idle`, and must be called before any entity is removed.
        """
        entity = self._add_staged(spawn)
        with self._rollback_on_refusal(entity):
            wait = self.engine.find_overlaps_async(entity.body)
            self.engine.hide(entity.body)

        def find_overlapped() -> list[str]:
            with refuse_faults(f"overlaps of '{entity.name}'"):
                return self.entities.find_owners(wait())

        return entity, find_overlapped

    def commit_staged(self, entities: Sequence[Entity]) -> None:
        """Add staged entities to the world, all at once."""
        self.engine.show([entity.body for entity in entities])
        for entity in entities:
            self._commit(entity)

    def rollback_staged(self, entities: Iterable[Entity]) -> None:
        """Remove those of the entities that are still staged."""
        for entity in [one for one in entities if self.entities.is_staged(one)]:
            self.entities.rollback(entity)
            self.engine.remove(entity.body)

    def _add_staged(self, spawn: ValidatedSpawn) -> Entity:
        name, namespace = self.resolve_names_for(spawn)
        start = spawn.base if spawn.start is None else spawn.start
        body = self._add_body(spawn.model, start)
        entity = Entity(
            *(name, namespace, spawn.model, body, spawn.base.copy(), spawn.description),
            born_ns=spawn.born_ns,
            belongs_to_world=spawn.belongs_to_world,
            info=spawn.info or default_info(spawn.model),
        )
        self.entities.stage(entity)
        return entity

    def _add_body(self, model: Model, base: FloatArray) -> int:
        """Add a body, joints as at the start; raises EngineRefused, whatever the engine raises."""
        with refuse_faults(f"model '{model.name}'"):
            body = self.engine.add(self._body_models.find(model), base)
            if (start := list_start_positions(model)).any():
                self.engine.set_at_rest(body, base, start)
            return body

    @contextmanager
    def _rollback_on_refusal(self, entity: Entity) -> Iterator[None]:
        """Remove a staged entity if the engine fails; raises EngineRefused then."""
        try:
            with refuse_faults(f"entity '{entity.name}'"):
                yield
        except EngineRefused:
            self.rollback_staged([entity])
            raise

    def _commit(self, entity: Entity) -> None:
        # Its row is the last one: what is known about the rows of others stays valid.
        self.entities.commit(entity)
        self._states = None
        self.clock.add_event("spawned", entity=entity.name)

    def set_info(self, name: str, info: EntityInfo) -> None:
        """Replace the info of an entity; raises EntityNotFound."""
        self.entities.replace(replace(self.entities.find(name), info=info))

    def check_overlaps(self, spawn: ValidatedSpawn) -> list[str]:
        """Name the entities that a spawn would overlap; raises as `spawn` does."""
        self.resolve_names_for(spawn)
        body = self._add_body(spawn.model, spawn.base)
        try:
            with refuse_faults(f"overlaps of model '{spawn.model.name}'"):
                return self.entities.find_owners(self.engine.find_overlaps(body))
        finally:
            self.engine.remove(body)

    def find_overlaps(self, entity: Entity) -> list[str]:
        """Name the entities that an entity overlaps."""
        return self.entities.find_owners(self.engine.find_overlaps(entity.body))

    def delete(self, name: str) -> None:
        """Remove an entity; its claim ends.

        Raises:
            EntityNotFound: There is none of this name.
        """
        entity = self.entities.find(name)
        self.claims.drop(name)
        self.divergence_guard.forget(name)
        self.applied_forces.forget(name)
        self.injected_faults.forget(name)
        self.commanded_twists.forget(name)
        self._joint_targets.pop(name, None)
        self.engine.remove(entity.body)
        self.entities.remove(name)
        self.ready_s.pop(name, None)
        self._drop_cached_states()
        self.clock.add_event("deleted", entity=name)

    def state_of(self, name: str) -> FloatArray:
        """Read the state row (13,) of one entity; the others are read only if it is not valid."""
        body = self.entities.find(name).body
        if not self._is_read and is_valid_state(state := self.engine.read((body,))):
            return np.asarray(state.base[0])
        return np.asarray(self.states().base[self.entities.index.row[name]])

    def reported_state(self, name: str) -> tuple[FloatArray, int]:
        """Find the state row (13,) of an entity to report, and its simulation time [ns].

        While the simulation plays it is that of the last control step, which costs no engine call,
        unless a pose was set since or `MAX_STATE_AGE_NS` have passed.

        Raises:
            EntityNotFound: There is none of this name.
        """
        self.entities.find(name)
        clock, age = self.clock, self.clock.steps - self._states_step
        is_recent = age < self.control_steps and age * clock.step_ns < MAX_STATE_AGE_NS
        if self._states is None or not (is_recent and clock.state == State.PLAYING):
            return self.state_of(name), clock.time_ns
        row = self.entities.index.row[name]
        return self._states.base[row], self._states_step * clock.step_ns

    def place(self, name: str, base: FloatArray, positions: FloatArray | None = None) -> None:
        """Set the state row (13,) of an entity's root link, and unfreeze the entity.

        Joints stay as they are, or are at rest at `positions`. Raises EntityNotFound.
        """
        self._unfreeze(self.entities.find(name))
        body = self.entities.find(name).body
        if positions is None:
            self.engine.set_base_state(body, base)
        else:
            self.engine.set_at_rest(body, base, positions)
        self.placement_count += 1
        self._states = None

    def set_state(
        self, name: str, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """Set the state row (13,) of an entity and its joints, and unfreeze it; targets stay.

        Raises:
            EntityNotFound: It does not exist.
        """
        self._unfreeze(self.entities.find(name))
        body = self.entities.find(name).body
        self.engine.set_state(body, base, positions, velocities)
        self.placement_count += 1
        self._states = None

    def replace_model(self, name: str, model: Model) -> None:
        """Replace the model of an entity by one with the same links and joints.

        The state of the root link and the joint positions stay; the joints are at rest.

        Raises:
            EntityNotFound: There is none of this name.
            IncorrectState: It is frozen.
            EngineRefused: The engine cannot simulate the model.
        """
        entity = self.entities.find(name)
        self.divergence_guard.require_not_frozen(name)
        positions = self.states().joint_positions[self.entities.index.joints_of(name)]
        rest = RestState(self.state_of(name), positions.copy())
        # If the engine refuses the model, it must do so before the former body is removed.
        self.engine.remove(self._add_body(model, rest.base))
        self._restore_at_rest(replace(entity, model=model), rest)

    def add_body_fault(self, fault: BodyFault) -> None:
        """Let a part of an entity fail; its motion goes on.

        Raises:
            EntityNotFound: There is no such entity.
            IncorrectState: It is frozen.
            RequestRefused: There are too many faults.
            EngineRefused: The engine cannot simulate it.
        """
        model = self.entities.find(fault.entity).model
        self.injected_faults.add_body_fault(fault, model, self._replace_moving)

    def _replace_moving(self, name: str, model: Model) -> None:
        """Replace the model of an entity that keeps the velocities of its joints."""
        if self.divergence_guard.is_frozen(name):
            return
        joints = self.entities.index.joints_of(name)
        positions = self.states().joint_positions[joints].copy()
        velocities = self.states().joint_velocities[joints].copy()
        base = self.state_of(name).copy()
        self.replace_model(name, model)
        self.engine.set_state(self.entities.find(name).body, base, positions, velocities)
        self._states = None

    def claim(
        self,
        agent: str,
        names: tuple[str, ...],
        on_release: OnRelease,
        *,
        yielding: AbstractSet[str] = frozenset(),
    ) -> tuple[Claim, ...]:
        """Make an agent the only driver of some entities, all or none.

        Those of a silent or yielding agent are taken from it.

        Args:
            agent: Name.
            names: Of the entities.
            on_release: Fate of the entities when the agent ends.
            yielding: Agents that keep only what no other agent names.

        Raises:
            EntityNotFound: One does not exist.
            IncorrectState: One is frozen.
            RequestRefused: Another agent drives one.
        """
        wanted = [self.entities.find(name) for name in dict.fromkeys(names)]
        for entity in wanted:
            self.divergence_guard.require_not_frozen(entity.name)
            if self.claims.agent_of(entity.name) not in yielding:
                self.claims.require_free(entity.name, agent)
        for entity in wanted:
            if (holder := self.claims.agent_of(entity.name)) not in ("", agent):
                self.claims.drop(entity.name)
                self.clock.add_event("released", entity=entity.name, agent=holder)
        return tuple(self._grant(agent, entity, on_release) for entity in wanted)

    def release(self, agent: str) -> None:
        """End all claims of an agent, each according to its `on_release`."""
        claims = self.claims.list_claims(agent)
        for name, _ in claims:
            self.claims.drop(name)
            self.clock.add_event("released", entity=name, agent=agent)
        self._stop([self.entities.find(name) for name, one in claims if one.on_release == "stop"])
        for name, claim in claims:
            if claim.on_release == "delete":
                self.delete(name)
        self.claims.forget_agent(agent)
        self._recorded_changes.pop(agent, None)

    def stop_silent(self, agent: str) -> None:
        """Stop the entities of an agent that sends no commands, but those with `keep`.

        Its claims stay, and its next command drives them again.
        """
        self.claims.note_silent(agent)
        stopped = [name for name, one in self.claims.list_claims(agent) if one.on_release != "keep"]
        self._stop([self.entities.find(name) for name in stopped])
        for name in stopped:
            self.clock.add_event("timed_out", entity=name, agent=agent, message=SILENT_MESSAGE)

    def _stop(self, entities: Sequence[Entity]) -> None:
        """Command entities to stop, all in one call: a pool may have driven thousands."""
        if not entities:
            return
        groups: dict[tuple[int, str], list[Entity]] = {}
        for entity in entities:
            # Joints of one entity that hold a position go on.
            own_name = entity.name if entity.name in self._joint_targets else ""
            groups.setdefault((id(entity.model), own_name), []).append(entity)
        bodies = [entity.body for group in groups.values() for entity in group]
        positions, targets = self.engine.read(bodies).joint_positions, []
        for (_, own_name), group in groups.items():
            model = group[0].model
            own, positions = np.split(positions, [len(group) * len(model.joints)])
            if own_name:
                last = self._joint_targets[own_name]
                targets.append(make_stop_targets(model, own, last))
                self._joint_targets[own_name] = targets[-1]
            else:
                rows = own.reshape(len(group), len(model.joints))
                targets.append(make_stop_targets(model, rows).ravel())
        self.engine.command(bodies, np.concatenate(targets))

    def command(self, agent: str, command: DriveCommand) -> bool:
        """Accept the targets of an agent for the next step, or drop and count them.

        Returns:
            Whether they match the epoch and the claims of the agent.
        """
        is_current = command.epoch == self.clock.epoch
        claimed = self.claimed_by_agent().get(agent) if is_current else None
        return self.claims.command(agent, claimed, command)

    def record_ready_time(self, agent: str, now_ns: int) -> None:
        """Record how long each entity of an agent took from spawn to its first command."""
        if self._recorded_changes.get(agent) == self.claims.changes:
            return
        self._recorded_changes[agent] = self.claims.changes
        for name, _ in self.claims.list_claims(agent):
            if name not in self.ready_s:
                self.ready_s[name] = (now_ns - self.entities.find(name).born_ns) * 1e-9

    def step(self) -> None:
        """Advance by one step: faults that are over, commands, then physics."""
        if len(self.injected_faults) and self.is_control_step:
            self.injected_faults.end_due(self.clock.time_ns, self._replace_moving)
        for agent, targets in self.claims.take_targets().items():
            if (claimed := self.claimed_by_agent().get(agent)) is not None:
                self.engine.command(claimed.bodies, targets)
                for name, own in claimed.joint_targets:
                    self._joint_targets[name] = targets[own]
        if len(self.applied_forces):
            self.applied_forces.apply(
                self.engine, self.entities.by_name, self.clock.time_ns, self.clock.step_ns
            )
        is_valid = self.engine.step()
        self.clock.steps += 1
        if not is_valid:
            self._has_invalid_body = True
            self._states = None
            self.states()
        if self.is_control_step and self.clock.steps % self._fall_check_steps == 0:
            self._watch_falls()

    @property
    def _fall_check_steps(self) -> int:
        """Steps between two checks, all of them control steps, whose states are read anyway."""
        control_ns = self.control_steps * self.clock.step_ns
        return self.control_steps * max(1, round(CHECK_PERIOD_NS / control_ns))

    def _watch_falls(self) -> None:
        """Warn of the entities that have left the world since the last check."""
        index, states = self.entities.index, self.states()
        if self._initial_z is None or self._initial_z[0] is not index:
            heights = [entity.initial[2] for entity in self.entities]
            self._initial_z = index, np.array(heights, dtype=np.float64)
        for name in self.fall_watch.update(index.names, states.base, self._initial_z[1]):
            height = states.base[index.row[name], 2]
            self.clock.warn(
                name,
                f"has left the world: it falls at z = {height:.0f} m with nothing below; "
                "set its state, or delete it",
            )

    def support_scene(self, vertices: MeshVertices, triangles: FindTriangles) -> CollisionScene:
        """Make the scene of the entities that never move, on which others stand."""
        fixed = [entity for entity in self.entities if not can_move(entity.model)]
        key = tuple((entity.name, entity.body) for entity in fixed)
        if self._support_layout is None or self._support_layout[0] != key:
            models = [entity.model for entity in fixed]
            layout = SceneLayout(models, vertices, triangles, has_ground=False)
            self._support_layout = key, layout
        states = self.engine.read([entity.body for entity in fixed])
        return CollisionScene(self._support_layout[1], states.base, states.joint_positions)

    def reset(self, scope: int) -> None:
        """Reset time, states and spawned entities, as the bits of `ResetScope` select."""
        bits = scope or ResetScope.ALL
        self.injected_faults.end_all(self._replace_moving)
        if bits & ResetScope.SPAWNED:
            self.rollback_staged(self.entities.staged)
            for name in [entity.name for entity in self.entities if not entity.belongs_to_world]:
                self.delete(name)
            self.engine.forget_removed()
        if bits & ResetScope.STATE:
            self.states()  # recovers what has diverged
            for entity in self.entities:
                self._try_unfreeze(entity)
                body, start = self.entities.find(entity.name).body, entity.initial
                self.engine.set_at_rest(body, start, list_start_positions(entity.model))
            self.divergence_guard.forget_all()
        if bits & ResetScope.TIME:
            self.clock.steps = 0
        self.clock.epoch += 1
        self.claims.forget_targets()
        self._joint_targets.clear()
        self.applied_forces.forget_all()
        self.commanded_twists.clear()
        self._states = None
        self.clock.add_event("reset", message=f"scope={scope}")

    def states(self) -> BodyStates:
        """Read the states of all entities, at most once a step; those that diverged recover.

        Only states of control steps are kept as the last valid ones: when others are read may
        depend on wall time.
        """
        if self._states is not None and self._is_read:
            return self._states
        states = self._keep(self._read_valid_states())
        if self.is_control_step:
            self.divergence_guard.remember(self.entities.index, states)
        return states

    def read_if_valid(self) -> bool:
        """Read the states of all entities for `states`, if none has diverged; recover none.

        For what is paced by wall time: an entity recovers at the same step in each run.

        Returns:
            Whether `states` returns them without a change of the world.
        """
        if self._is_read:
            return True
        states = self.engine.read(self.entities.index.bodies)
        if self._has_invalid_body or not is_valid_state(states):
            return False
        self._keep(states)
        return True

    def _keep(self, states: BodyStates) -> BodyStates:
        """Keep states until the next step or change; return them."""
        found = self._states = self.divergence_guard.complete(self.entities.index, states)
        self._states_step = self.clock.steps
        return found

    def _read_valid_states(self) -> BodyStates:
        """Read the states of all entities until those that diverged or failed are set aside."""
        while True:
            index = self.entities.index
            states = self.engine.read(index.bodies)
            if is_valid_state(states) and not self._has_invalid_body:
                return states
            self._has_invalid_body = False
            diverged = self.divergence_guard.find_diverged(index, states)
            faults = self._take_faults()
            if not diverged and not faults:
                return states
            self._recover(list(dict.fromkeys([*diverged, *faults])), faults)

    def _take_faults(self) -> dict[str, str]:
        """Find the entities for which the engine failed, each with the reason."""
        faults = self.engine.take_faults()
        owners = {body: name for body in faults for name in self.entities.find_owners([body])}
        return {name: faults[body] for body, name in owners.items() if name in self.entities}

    def scene(
        self, vertices: MeshVertices, triangles: FindTriangles, *, has_ground: bool = False
    ) -> CollisionScene:
        """Make the scene of this step.

        Args:
            vertices: Finds the vertices of meshes.
            triangles: Finds the triangles of meshes.
            has_ground: Whether rays hit the ground plane.
        """
        index, states = self.entities.index, self.states()
        if self._scene_layouts is None or self._scene_layouts[0] is not index:
            self._scene_layouts = index, {}
        layouts = self._scene_layouts[1]
        if has_ground not in layouts:
            models = [entity.model for entity in self.entities]
            layouts[has_ground] = SceneLayout(models, vertices, triangles, has_ground=has_ground)
        return CollisionScene(layouts[has_ground], states.base, states.joint_positions)

    @property
    def _is_read(self) -> bool:
        return self._states is not None and self._states_step == self.clock.steps

    def claimed_by_agent(self) -> dict[str, ClaimedEntities]:
        """Find what each agent drives."""
        return self.claims.claimed_by_agent(self.entities.index, self.entities.by_name)

    def drive_states(
        self, except_agents: AbstractSet[str] = frozenset()
    ) -> Iterator[tuple[str, DriveState]]:
        """Make the state message of each agent; an empty one after its last claim has ended."""
        clock = self.clock
        now = (clock.epoch, clock.steps, clock.time_ns)
        if self.claimed_by_agent().keys() - except_agents:
            states, efforts_of = self.states(), self._read_wanted_efforts(except_agents)
            for agent, claimed in self.claimed_by_agent().items():
                if agent not in except_agents:
                    twists = self.commanded_twists.select(self.entities.index, claimed.rows)
                    state = claimed.to_drive_state(now, states, efforts_of.get(agent))
                    if faults := self.injected_faults.topic_faults:
                        state = msgspec.structs.replace(state, topic_faults=faults)
                    if twists:
                        order = self.commanded_twists.changes
                        state = msgspec.structs.replace(state, twists=twists, order=order)
                    yield agent, state
        for agent in self.claims.take_agents_without_claims():
            yield agent, DriveState(*now, b"", b"", b"", b"")

    def _read_wanted_efforts(self, except_agents: AbstractSet[str]) -> Mapping[str, FloatArray]:
        """Read the efforts of the joints of all agents that want them, in one call."""
        claimed = self.claimed_by_agent()
        wanting = tuple(agent for agent in claimed if self.claims.wants_efforts(agent))
        if except_agents >= set(wanting):
            return {}
        plan = self._effort_plan
        if plan is None or plan.claimed is not claimed or plan.agents != wanting:
            plan = self._effort_plan = make_effort_plan(claimed, wanting)
        efforts = np.split(self.engine.read_joint_efforts(plan.bodies), plan.ends)
        return dict(zip(wanting, efforts, strict=False))

    def snapshot(self, real_time_factor: float) -> Snapshot:
        """Make a message with the states of all entities."""
        states, clock = self.states(), self.clock
        return Snapshot(
            clock.epoch,
            clock.steps,
            clock.time_ns,
            self.entities.roster_number,
            self.entities.index.names,
            states.base.tobytes(),
            states.joint_positions.tobytes(),
            real_time_factor,
            clock.state_name,
        )

    def replace_with(self, other: "SimulatedWorld", state: State) -> None:
        """Take over another world's engine, entities and step, at time 0 of a new epoch.

        The former entities are deleted; the other world must not be used any more.
        """
        for name in self.entities.by_name:
            self.claims.drop(name)
            self.clock.add_event("deleted", entity=name)
        self.engine.close()
        self.claims.forget_targets()
        self._joint_targets.clear()
        self.applied_forces.forget_all()
        self.injected_faults.forget_all()
        self.commanded_twists.clear()
        self.ready_s.clear()
        self.engine, self.control_steps = other.engine, other.control_steps
        self.entities.replace_all(other.entities)
        self.divergence_guard = DivergenceGuard()
        self.fall_watch = FallWatch()
        self.clock.start_epoch(state, step_ns=other.clock.step_ns)
        for name in self.entities.by_name:
            self.clock.add_event("spawned", entity=name)
        self._drop_cached_states()

    def save(self) -> SavedWorld:
        """Take the state: what `load` needs to go on with the same bits.

        The objects are those in use: copy them before the next call.
        """
        left_out = {"_scene_layouts": None, "_support_layout": None}
        return SavedWorld({**self.__dict__, **left_out})

    def load(self, saved: SavedWorld) -> None:
        """Replace the state by one that was taken of this world or another; it must be a copy.

        The caller resumes its engine, and closes the former one.
        """
        self.__dict__.update(vars(saved))

    def close(self) -> None:
        """Free the engine."""
        self.engine.close()

    def _recover(self, names: list[str], faults: Mapping[str, str]) -> None:
        """Freeze the entities that the engine failed for, or else the cause of the divergence."""
        entities = [self.entities.find(name) for name in names]
        culprits = self.divergence_guard.find_culprits(entities, self.clock.time_ns)
        for entity in entities:
            if entity.name in (faults or culprits):
                self._freeze(entity, faults.get(entity.name, ""))
            else:
                self._restore_at_rest(entity, self.divergence_guard.last_valid_state(entity))
                self.clock.warn(entity.name, RESET_TO_REST_MESSAGE)

    def _freeze(self, entity: Entity, fault: str) -> None:
        self.engine.remove(entity.body)
        self._add_frozen_body(entity, fault)

    def _add_frozen_body(self, entity: Entity, fault: str) -> None:
        """Freeze an entity that has no body.

        Raises:
            EngineLost: The engine does not even accept a body without collisions.
        """
        was_frozen = self.divergence_guard.is_frozen(entity.name)
        rest = self.divergence_guard.freeze(entity)
        self.applied_forces.forget(entity.name)
        model = make_frozen_model(entity.model, rest.positions)
        try:
            body = self._add_body(make_bare_model(model) if was_frozen else model, rest.base)
        except EngineRefused as refused:
            if was_frozen:
                raise EngineLost(f"entity '{entity.name}' cannot be frozen: {refused}") from refused
            self._add_frozen_body(entity, fault or str(refused))
            return
        self._set_body(entity, body)
        if agent := self.claims.agent_of(entity.name):
            self.claims.drop(entity.name)
            self.clock.add_event("released", entity=entity.name, agent=agent)
        self.clock.warn(entity.name, f"{FROZEN_BY_FAULT}: {fault}" if fault else FROZEN_MESSAGE)

    def _unfreeze(self, entity: Entity) -> None:
        """Give an entity its own model again; raises EngineRefused if it must stay frozen."""
        if (rest := self.divergence_guard.find_frozen(entity.name)) is not None:
            # If the engine refuses the model, it must do so before the former body is removed.
            body = self._add_body(entity.model, rest.base)
            self.engine.remove(entity.body)
            self._set_body(entity, body)
            self.engine.set_at_rest(body, rest.base, rest.positions)
        self.divergence_guard.unfreeze(entity.name)

    def _try_unfreeze(self, entity: Entity) -> None:
        """Unfreeze an entity; if the engine refuses its model, it stays frozen."""
        try:
            self._unfreeze(entity)
        except EngineRefused as refused:
            self.clock.warn(entity.name, f"{FROZEN_BY_FAULT}: {refused}")

    def _restore_at_rest(self, entity: Entity, rest: RestState) -> None:
        """Replace the body of an entity: an engine may keep numbers that are not finite."""
        self.engine.remove(entity.body)
        try:
            body = self._add_body(entity.model, rest.base)
        except EngineRefused as refused:
            self._add_frozen_body(entity, str(refused))
            return
        self._set_body(entity, body)
        self.engine.set_at_rest(body, rest.base, rest.positions)

    def _set_body(self, entity: Entity, body: int) -> None:
        self.entities.replace(replace(entity, body=body))
        self._drop_cached_states()

    def _grant(self, agent: str, entity: Entity, on_release: OnRelease) -> Claim:
        record = self.claims.grant(agent, entity.name, on_release)
        self.clock.add_event("claimed", entity=entity.name, agent=agent)
        return Claim(
            record.claim,
            entity.name,
            entity.namespace,
            entity.model,
            entity.description,
            tuple(entity.initial.tolist()),
            joint_targets=self._list_joint_targets(entity),
        )

    def _list_joint_targets(self, entity: Entity) -> tuple[float, ...]:
        """List the newest targets of its controlled joints, the last ones of its actuators."""
        targets = self._joint_targets.get(entity.name)
        if targets is None:
            return ()
        driven = sum(actuator.width for actuator in entity.model.drive_actuators)
        return tuple(targets[driven:].tolist())

    def _drop_cached_states(self) -> None:
        """Note that entities or bodies have changed."""
        self.claims.invalidate_rows()
        self._states = None


@dataclass(frozen=True)
class BuiltWorld:
    """A world that is ready to replace the current one, and its real-time factor."""

    world: SimulatedWorld
    real_time_factor: float


WorldFactory = Callable[[WorldModel], Iterator[BuiltWorld | None]]
"""Builds a world in steps; the last item is the world. Raises SimError.

Close the iterator if the world is not needed any more.
"""
