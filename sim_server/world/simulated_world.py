"""The World: entities with their bodies and claims, stepped over an engine."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace

import numpy as np

from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState, OnRelease
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.proto.messages.telemetry_messages import Snapshot
from zensim.sim_server.errors import EntityNotFound
from zensim.sim_server.physics.actuation import make_stop_targets
from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray
from zensim.sim_server.world.applied_forces import AppliedForces
from zensim.sim_server.world.claim_registry import ClaimRegistry
from zensim.sim_server.world.divergence_guard import (
    FROZEN_MESSAGE,
    RESET_TO_REST_MESSAGE,
    DivergenceGuard,
    RestState,
    is_valid_state,
    make_frozen_model,
)
from zensim.sim_server.world.entity import (
    ClaimedEntities,
    Entity,
    EntityIndex,
    default_info,
    make_entity_index,
)
from zensim.sim_server.world.simulation_clock import SimulationClock
from zensim.sim_server.world.spawn_request import NameIndex, ValidatedSpawn


class EntityStore(SimulationClock):
    """An engine and the entities in it."""

    def __init__(self, engine: Engine, *, step_ns: int) -> None:
        super().__init__(step_ns=step_ns)
        self.roster_number = 0
        self._engine = engine
        self._entities: dict[str, Entity] = {}
        self._expected: dict[str, Entity] = {}
        self._names = NameIndex()
        self._roster: EntityIndex | None = None

    @property
    def engine(self) -> Engine:
        """What simulates it: to be asked, and told nothing."""
        return self._engine

    @property
    def entities(self) -> tuple[Entity, ...]:
        """All entities in the order of spawning."""
        return tuple(self._entities.values())

    def entity(self, name: str) -> Entity:
        """Find an entity.

        Raises:
            EntityNotFound: There is none of this name.
        """
        if (found := self._entities.get(name)) is None:
            raise EntityNotFound(name)
        return found

    def prepare(self, model: Model) -> bool:
        """Make a part of what `spawn` needs for a model; say whether nothing is left."""
        return self._engine.prepare(model)

    def spawn(self, birth: ValidatedSpawn) -> Entity:
        """Put an entity into the world.

        Raises:
            NameNotUnique: The name is taken and may not be changed.
            NameRefused: The name is not valid.
            NamespaceRefused: The namespace is not valid, or another entity has it.
            EngineRefused: The engine cannot simulate the model.
        """
        entity = self._make(birth)
        self._add_entity(entity)
        return entity

    def resolve_names_for(self, birth: ValidatedSpawn) -> tuple[str, str]:
        """Find the name and the namespace that a spawn would get; raises as `spawn` does."""
        return birth.resolve_names(self._names)

    def stage_spawn(self, birth: ValidatedSpawn) -> tuple[Entity, Callable[[], list[str]]]:
        """Make an entity that is not there before it is let in; its names are; raises as `spawn`.

        An engine that cannot conceal it lets it stand where it will be.

        Returns:
            The entity, and what says the names of those that it overlaps: it may wait for them
            unless `is_idle`, and is to be asked before anybody goes.
        """
        entity = self._make(birth)
        self._expected[entity.name] = entity
        overlapped = self._find_overlaps_later(entity)
        self._engine.hide(entity.body)
        return entity, overlapped

    @property
    def is_idle(self) -> bool:
        """Whether the engine has done all that it was told; asked at every turn of the loop."""
        return self._engine.is_idle()

    def is_staged(self, entity: Entity) -> bool:
        """Whether an entity is still expected: a reset or another world ends it."""
        return self._expected.get(entity.name) is entity

    def commit_staged(self, entities: Sequence[Entity]) -> None:
        """Let what is expected be there, all at once."""
        self._engine.show([entity.body for entity in entities])
        for entity in entities:
            self._add_entity(self._expected.pop(entity.name))

    def rollback_staged(self, entities: Iterable[Entity]) -> None:
        """Take back what is expected; nobody has been told of it."""
        for entity in [one for one in entities if self.is_staged(one)]:
            del self._expected[entity.name]
            self._names.drop(entity)
            self._engine.remove(entity.body)

    def _make(self, birth: ValidatedSpawn) -> Entity:
        name, namespace = self.resolve_names_for(birth)
        body = self._engine.add(birth.model, birth.base)
        entity = Entity(
            *(name, namespace, birth.model, body, birth.base.copy(), birth.description),
            born_ns=birth.born_ns,
            belongs_to_world=birth.belongs_to_world,
            info=birth.info or default_info(birth.model),
        )
        self._names.add(entity)
        return entity

    def _add_entity(self, entity: Entity) -> None:
        self._entities[entity.name] = entity
        self._changed()
        self._add_event("spawned", entity=entity.name)

    def set_info(self, name: str, info: EntityInfo) -> None:
        """Say what an entity is; raises EntityNotFound."""
        self._entities[name] = replace(self.entity(name), info=info)

    def check_overlaps(self, birth: ValidatedSpawn) -> list[str]:
        """Spawn and take back at once; name the entities that it overlaps; raises as `spawn` does.

        Nobody is told.
        """
        self.resolve_names_for(birth)
        body = self._engine.add(birth.model, birth.base)
        try:
            return self._names.names_of_bodies(self._engine.find_overlaps(body))
        finally:
            self._engine.remove(body)

    def find_overlaps(self, entity: Entity) -> list[str]:
        """Name the entities that an entity overlaps."""
        return self._names.names_of_bodies(self._engine.find_overlaps(entity.body))

    def _find_overlaps_later(self, entity: Entity) -> Callable[[], list[str]]:
        wait = self._engine.find_overlaps_async(entity.body)
        return lambda: self._names.names_of_bodies(wait())

    def roster(self) -> EntityIndex:
        """Where each entity stands in the arrays."""
        if self._roster is None:
            self._roster = make_entity_index(self.entities)
        return self._roster

    def _changed(self) -> None:
        """Note that others are there, or that they have other bodies."""
        self.roster_number += 1
        self._roster = None


MAX_STATE_AGE_NS = 25_000_000
"""Simulation time for which what agents were told will do for an answer."""


class World(EntityStore):
    """One engine, one time, its entities, and who drives them."""

    def __init__(self, engine: Engine, *, name: str, step_ns: int, control_steps: int) -> None:
        super().__init__(engine, step_ns=step_ns)
        self.name = name
        self.control_steps = control_steps
        self.placed = 0
        self.ready_s: dict[str, float] = {}
        self._noted: dict[str, int] = {}
        self.claims = ClaimRegistry()
        self.applied_forces = AppliedForces()
        self._reading: BodyStates | None = None
        self._read_at = 0
        """The step that the reading is of."""
        self.watch = DivergenceGuard()

    @property
    def is_control_step(self) -> bool:
        """Whether agents are told at this step."""
        return self.steps % self.control_steps == 0

    def delete(self, name: str) -> None:
        """Take an entity out; its claim ends.

        Raises:
            EntityNotFound: There is none of this name.
        """
        entity = self.entity(name)
        self.claims.drop(name)
        self.watch.forget(name)
        self.applied_forces.forget(name)
        self._engine.remove(entity.body)
        self._names.drop(self._entities.pop(name))
        self.ready_s.pop(name, None)
        self._changed()
        self._add_event("deleted", entity=name)

    def state_of(self, name: str) -> FloatArray:
        """Read one entity's state row (13,), alone unless all have been read already."""
        body = self.entity(name).body
        if not self._is_read and is_valid_state(alone := self._engine.read((body,))):
            return np.asarray(alone.base[0])
        return np.asarray(self.reading().base[self.roster().row[name]])

    def reported_state(self, name: str) -> tuple[FloatArray, int]:
        """Tell one entity's state row (13,), and the simulation time [ns] that it is of.

        While time runs it is that of the last control step, as agents were told, unless something
        was placed since or `MAX_STATE_AGE_NS` have passed; no engine is asked for it.

        Raises:
            EntityNotFound: There is none of this name.
        """
        self.entity(name)
        age = self.steps - self._read_at
        is_recent = age < self.control_steps and age * self.step_ns < MAX_STATE_AGE_NS
        if self._reading is None or not (is_recent and self.state == State.PLAYING):
            return self.state_of(name), self.time_ns
        return self._reading.base[self.roster().row[name]], self._read_at * self.step_ns

    def place(self, name: str, base: FloatArray, positions: FloatArray | None = None) -> None:
        """Put an entity's root link at a state row (13,), and its joints at rest if told where.

        A frozen one lives again; raises EntityNotFound.
        """
        self._unfreeze(self.entity(name))
        body = self._entities[name].body
        if positions is None:
            self._engine.set_base_state(body, base)
        else:
            self._engine.set_at_rest(body, base, positions)
        self.placed += 1
        self._reading = None

    def replace_model(self, name: str, model: Model) -> None:
        """Make an entity of another model with the same links and joints; it goes on as it was.

        Its joints are at rest for a moment.

        Raises:
            EntityNotFound: There is none of this name.
            IncorrectState: It is frozen.
            EngineRefused: The engine cannot simulate the model.
        """
        entity = self.entity(name)
        self.watch.require_not_frozen(name)
        positions = self.reading().joint_positions[self.roster().joints_of(name)]
        stand = RestState(self.state_of(name), positions.copy())
        self._engine.remove(self._engine.add(model, stand.base))  # else it would be gone if refused
        self._restore_at_rest(replace(entity, model=model), stand)
        self._changed()

    def claim(self, agent: str, names: tuple[str, ...], on_release: OnRelease) -> tuple[Claim, ...]:
        """Make an agent the only driver of some entities, all or none.

        Raises:
            EntityNotFound: One does not exist.
            IncorrectState: One is frozen.
            Refused: Another agent drives one.
        """
        wanted = [self.entity(name) for name in dict.fromkeys(names)]
        for entity in wanted:
            self.watch.require_not_frozen(entity.name)
            self.claims.require_free(entity.name, agent)
        return tuple(self._grant(agent, entity, on_release) for entity in wanted)

    def release(self, agent: str) -> None:
        """End all claims of an agent, as each of them said it should end."""
        held = self.claims.list_claims(agent)
        for name, _ in held:
            self.claims.drop(name)
            self._add_event("released", entity=name, agent=agent)
        self._stop([self._entities[name] for name, hold in held if hold.on_release == "stop"])
        for name, hold in held:
            if hold.on_release == "delete":
                self.delete(name)
        self.claims.forget_agent(agent)
        self._noted.pop(agent, None)

    def _stop(self, entities: Sequence[Entity]) -> None:
        """Let entities stand, all at once: a pool may have held hundreds."""
        if not entities:
            return
        bodies = [entity.body for entity in entities]
        positions = self._engine.read(bodies).joint_positions
        ends = np.cumsum([len(entity.model.joints) for entity in entities])
        parts = zip(entities, np.split(positions, ends[:-1]), strict=True)
        targets = [make_stop_targets(entity.model, part) for entity, part in parts]
        self._engine.command(bodies, np.concatenate(targets))

    def command(self, agent: str, command: DriveCommand) -> bool:
        """Take an agent's targets for the next step; one that does not fit is dropped and counted.

        Returns:
            Whether it was taken.
        """
        is_of_now = command.epoch == self.epoch
        return self.claims.command(agent, self.fleets().get(agent) if is_of_now else None, command)

    def record_ready_time(self, agent: str, now_ns: int) -> None:
        """Remember how long each entity of an agent took from spawn to its first command."""
        if self._noted.get(agent) == self.claims.changes:
            return
        self._noted[agent] = self.claims.changes
        for name, _ in self.claims.list_claims(agent):
            if name not in self.ready_s:
                self.ready_s[name] = (now_ns - self._entities[name].born_ns) * 1e-9

    def step(self) -> None:
        """Advance by one step: commands, then physics."""
        for agent, targets in self.claims.take_targets():
            if (fleet := self.fleets().get(agent)) is not None:
                self._engine.command(fleet.bodies, targets)
        self.applied_forces.apply(self._engine, self._entities, self.time_ns)
        is_well = self._engine.step()
        self.steps += 1
        if not is_well:
            self.reading()

    def reset(self, scope: int) -> None:
        """Go back to the start: time, states, spawned entities, by the bits of `ResetScope`."""
        bits = scope or ResetScope.ALL
        if bits & ResetScope.SPAWNED:
            self.rollback_staged(tuple(self._expected.values()))
            for name in [entity.name for entity in self.entities if not entity.belongs_to_world]:
                self.delete(name)
            self._engine.forget_removed()
        if bits & ResetScope.STATE:
            self.reading()  # so that what has gone bad is mended before
            for entity in self.entities:
                self._unfreeze(entity)
                self._engine.set_at_rest(self._entities[entity.name].body, entity.initial)
            self.watch.forget_all()
        if bits & ResetScope.TIME:
            self.steps = 0
        self.epoch += 1
        self.claims.forget_targets()
        self.applied_forces.forget_all()
        self._reading = None
        self._add_event("reset", message=f"scope={scope}")

    def reading(self) -> BodyStates:
        """Read every entity back, once a step at most; those that have gone bad are mended."""
        if self._reading is None or not self._is_read:
            reading = self._engine.read(self.roster().bodies)
            if bad := self.watch.bad(self.roster(), reading):
                self._recover_diverged(bad)
                reading = self._engine.read(self.roster().bodies)
            self._reading = self.watch.remember(self.roster(), reading)
            self._read_at = self.steps
        return self._reading

    @property
    def _is_read(self) -> bool:
        return self._reading is not None and self._read_at == self.steps

    def fleets(self) -> dict[str, ClaimedEntities]:
        """What each agent drives."""
        return self.claims.fleets(self.roster(), self._entities)

    def drive_states(
        self, except_agents: AbstractSet[str] = frozenset()
    ) -> Iterator[tuple[str, DriveState]]:
        """Tell each agent but some where its entities are; who lost the last one is told once."""
        if self.fleets().keys() - except_agents:
            reading = self.reading()
            for agent, fleet in self.fleets().items():
                if agent not in except_agents:
                    yield agent, fleet.told(self.epoch, self.steps, self.time_ns, reading)
        for agent in self.claims.take_agents_without_claims():
            yield agent, DriveState(self.epoch, self.steps, self.time_ns, b"", b"", b"", b"")

    def snapshot(self, real_time_factor: float) -> Snapshot:
        """Tell everybody where every entity is."""
        reading = self.reading()
        return Snapshot(
            self.epoch,
            self.steps,
            self.time_ns,
            self.roster_number,
            self.roster().names,
            reading.base.tobytes(),
            reading.joint_positions.tobytes(),
            real_time_factor,
            self.state_name,
        )

    def replace_with(self, other: "World", state: State) -> None:
        """Take over another world's engine, entities and step, at time 0 of a new epoch.

        What was here is gone; the other world is not to be used any more.
        """
        for name in self._entities:
            self.claims.drop(name)
            self._add_event("deleted", entity=name)
        self._engine.close()
        self.claims.forget_targets()
        self.applied_forces.forget_all()
        self.ready_s.clear()
        self._engine, self._entities = other.release_engine()
        self._names, self._expected = NameIndex(self._entities.values()), {}
        self.step_ns, self.control_steps = other.step_ns, other.control_steps
        self.watch, self.state = DivergenceGuard(), state
        self.steps, self.epoch = 0, self.epoch + 1
        self._add_event("unloaded" if state == State.NO_WORLD else "loaded")
        for name in self._entities:
            self._add_event("spawned", entity=name)
        self._changed()

    def release_engine(self) -> tuple[Engine, dict[str, Entity]]:
        """Hand engine and entities over to the world that takes this one's place."""
        return self._engine, self._entities

    def close(self) -> None:
        """Free the engine."""
        self._engine.close()

    def _recover_diverged(self, bad: list[str]) -> None:
        entities = [self._entities[name] for name in bad]
        culprits = self.watch.find_culprits(entities, self.time_ns)
        for entity in entities:
            if entity.name in culprits:
                self._freeze(entity)
            else:
                self._restore_at_rest(entity, self.watch.last_valid_state(entity))
                self.warn(entity.name, RESET_TO_REST_MESSAGE)

    def _freeze(self, entity: Entity) -> None:
        stand = self.watch.freeze(entity)
        self.applied_forces.forget(entity.name)
        self._recreate_body(entity, make_frozen_model(entity.model, stand.positions), stand.base)
        if agent := self.claims.agent_of(entity.name):
            self.claims.drop(entity.name)
            self._add_event("released", entity=entity.name, agent=agent)
        self.warn(entity.name, FROZEN_MESSAGE)

    def _unfreeze(self, entity: Entity) -> None:
        if (stand := self.watch.unfreeze(entity.name)) is not None:
            self._restore_at_rest(entity, stand)

    def _restore_at_rest(self, entity: Entity, stand: RestState) -> None:
        self._recreate_body(entity, entity.model, stand.base)
        self._engine.set_at_rest(self._entities[entity.name].body, stand.base, stand.positions)

    def _recreate_body(self, entity: Entity, model: Model, base: FloatArray) -> None:
        """Give an entity another body: an engine may never let go of numbers that went bad."""
        self._engine.remove(entity.body)
        self._names.drop_body(entity.body)
        self._entities[entity.name] = replace(entity, body=self._engine.add(model, base))
        self._names.add(self._entities[entity.name])
        self.claims.invalidate_rows()
        self._roster = self._reading = None

    def _grant(self, agent: str, entity: Entity, on_release: OnRelease) -> Claim:
        hold = self.claims.grant(agent, entity.name, on_release)
        self._add_event("claimed", entity=entity.name, agent=agent)
        return Claim(
            hold.claim,
            entity.name,
            entity.namespace,
            entity.model,
            entity.description,
            tuple(entity.initial.tolist()),
        )

    def _changed(self) -> None:
        super()._changed()
        self.claims.invalidate_rows()
        self._reading = None
