"""A world's entities, each with its body: made, expected, there."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.errors import EntityNotFound
from zensim.sim_server.physics.engine import Engine, as_async, as_hiding
from zensim.sim_server.world.birth import Birth
from zensim.sim_server.world.chronicle import Chronicle
from zensim.sim_server.world.entity import Entity, Roster, info_of, roster_of
from zensim.sim_server.world.naming import Names


class Inhabited(Chronicle):
    """An engine and the entities in it."""

    def __init__(self, engine: Engine, *, step_ns: int) -> None:
        super().__init__(step_ns=step_ns)
        self.roster_number = 0
        self._engine = engine
        self._entities: dict[str, Entity] = {}
        self._expected: dict[str, Entity] = {}
        self._names = Names()
        self._roster: Roster | None = None

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

    def spawn(self, birth: Birth) -> Entity:
        """Put an entity into the world.

        Raises:
            NameNotUnique: The name is taken and may not be changed.
            NameRefused: The name is not valid.
            NamespaceRefused: The namespace is not valid, or another entity has it.
            EngineRefused: The engine cannot simulate the model.
        """
        entity = self._make(birth)
        self._let_in(entity)
        return entity

    def names_for(self, birth: Birth) -> tuple[str, str]:
        """Find the name and the namespace that a spawn would get; raises as `spawn` does."""
        return birth.names_among(self._names)

    def expect(self, birth: Birth) -> tuple[Entity, Callable[[], list[str]]]:
        """Make an entity that is not there before it is let in; its names are; raises as `spawn`.

        An engine that cannot conceal it lets it stand where it will be.

        Returns:
            The entity, and what says the names of those that it overlaps: it may wait for them
            unless `is_idle`, and is to be asked before anybody goes.
        """
        entity = self._make(birth)
        self._expected[entity.name] = entity
        overlapped = self._overlapped_soon(entity)
        if hiding := as_hiding(self._engine):
            hiding.hide(entity.body)
        return entity, overlapped

    @property
    def is_idle(self) -> bool:
        """Whether the engine has done all that it was told; asked at every turn of the loop."""
        return (engine := as_async(self._engine)) is None or engine.is_idle()

    def expects(self, entity: Entity) -> bool:
        """Whether an entity is still expected: a reset or another world ends it."""
        return self._expected.get(entity.name) is entity

    def let_in(self, entities: Sequence[Entity]) -> None:
        """Let what is expected be there, all at once."""
        if hiding := as_hiding(self._engine):
            hiding.show([entity.body for entity in entities])
        for entity in entities:
            self._let_in(self._expected.pop(entity.name))

    def turn_away(self, entities: Iterable[Entity]) -> None:
        """Take back what is expected; nobody has been told of it."""
        for entity in [one for one in entities if self.expects(one)]:
            del self._expected[entity.name]
            self._names.drop(entity)
            self._engine.remove(entity.body)

    def _make(self, birth: Birth) -> Entity:
        name, namespace = self.names_for(birth)
        body = self._engine.add(birth.model, birth.base)
        entity = Entity(
            *(name, namespace, birth.model, body, birth.base.copy(), birth.description),
            born_ns=birth.born_ns,
            belongs_to_world=birth.belongs_to_world,
            info=birth.info or info_of(birth.model),
        )
        self._names.add(entity)
        return entity

    def _let_in(self, entity: Entity) -> None:
        self._entities[entity.name] = entity
        self._changed()
        self._tell("spawned", entity=entity.name)

    def describe(self, name: str, info: EntityInfo) -> None:
        """Say what an entity is; raises EntityNotFound."""
        self._entities[name] = replace(self.entity(name), info=info)

    def rehearse(self, birth: Birth) -> list[str]:
        """Spawn and take back at once; name the entities that it overlaps; raises as `spawn` does.

        Nobody is told.
        """
        self.names_for(birth)
        body = self._engine.add(birth.model, birth.base)
        try:
            return self._names.of_bodies(self._engine.find_overlaps(body))
        finally:
            self._engine.remove(body)

    def overlapped(self, entity: Entity) -> list[str]:
        """Name the entities that an entity overlaps."""
        return self._names.of_bodies(self._engine.find_overlaps(entity.body))

    def _overlapped_soon(self, entity: Entity) -> Callable[[], list[str]]:
        if (engine := as_async(self._engine)) is None:
            names = self.overlapped(entity)
            return lambda: names
        soon = engine.find_overlaps_async(entity.body)
        return lambda: self._names.of_bodies(soon())

    def roster(self) -> Roster:
        """Where each entity stands in the arrays."""
        if self._roster is None:
            self._roster = roster_of(self.entities)
        return self._roster

    def _changed(self) -> None:
        """Note that others are there, or that they have other bodies."""
        self.roster_number += 1
        self._roster = None
