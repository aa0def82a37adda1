"""The entities of a world by name, those staged, and their rows in the state arrays."""

from collections.abc import Iterable, Iterator, Mapping

from zensim.sim_server.errors import EntityNotFound
from zensim.sim_server.world.entity import Entity, EntityIndex, append_to_index, make_entity_index


class EntityStore:
    """Entities in the order of spawning, and the owners of names, namespaces and bodies.

    A staged entity has its name, namespace and body reserved, and is not iterated over.
    """

    def __init__(self) -> None:
        self.roster_number = 0
        """Counts changes of the entities and of their models."""
        self.names: set[str] = set()
        """Names of all entities, staged ones included."""
        self.namespace_owners: dict[str, str] = {}
        """Names of entities by namespace, staged ones included."""
        self._entities: dict[str, Entity] = {}
        self._staged: dict[str, Entity] = {}
        self._body_owners: dict[int, str] = {}
        self._index: EntityIndex | None = None
        self._appended: list[Entity] = []
        """Entities that the index lacks; they follow its rows."""
        self._changed: dict[str, None] | None = None
        """Names of changed entities, in order; None = not recorded."""

    def __iter__(self) -> Iterator[Entity]:
        # A copy, so that callers may delete entities while they iterate.
        return iter(tuple(self._entities.values()))

    def __len__(self) -> int:
        return len(self._entities)

    def __contains__(self, name: str) -> bool:
        return name in self._entities

    @property
    def by_name(self) -> Mapping[str, Entity]:
        """The entities by name."""
        return self._entities

    @property
    def staged(self) -> tuple[Entity, ...]:
        """All staged entities."""
        return tuple(self._staged.values())

    @property
    def index(self) -> EntityIndex:
        """Rows of the entities in the state arrays; another object after each change."""
        if self._index is None:
            self._index = make_entity_index(tuple(self))
        elif self._appended:
            self._index = append_to_index(self._index, self._appended)
        self._appended.clear()
        return self._index

    def find(self, name: str) -> Entity:
        """Find an entity.

        Raises:
            EntityNotFound: There is none of this name.
        """
        if (entity := self._entities.get(name)) is None:
            raise EntityNotFound(name)
        return entity

    def find_owners(self, bodies: Iterable[int]) -> list[str]:
        """List the names of the entities that have these bodies, staged ones included."""
        return [self._body_owners[body] for body in bodies if body in self._body_owners]

    def is_staged(self, entity: Entity) -> bool:
        """Whether an entity is still staged: a reset or another world ends it."""
        return self._staged.get(entity.name) is entity

    def stage(self, entity: Entity) -> None:
        """Reserve the name, namespace and body of an entity."""
        self._staged[entity.name] = entity
        self._reserve(entity)

    def commit(self, entity: Entity) -> None:
        """Add a staged entity to the world, after all others."""
        self._entities[entity.name] = self._staged.pop(entity.name)
        self._appended.append(entity)
        self._note_change(entity.name)
        self.roster_number += 1

    def rollback(self, entity: Entity) -> None:
        """Drop a staged entity."""
        self._free(self._staged.pop(entity.name))

    def remove(self, name: str) -> None:
        """Remove an entity; raises as `find` does."""
        self._free(self.find(name))
        del self._entities[name]
        self._note_change(name)
        self._count_change()

    def replace(self, entity: Entity) -> None:
        """Replace the entity of the same name by one with another body, model or info."""
        former = self.find(entity.name)
        self._free(former)
        self._reserve(entity)
        self._entities[entity.name] = entity
        self._note_change(entity.name)
        if entity.body != former.body:
            self._index = None
        if entity.model is not former.model:
            self._count_change()

    def replace_all(self, entities: Iterable[Entity]) -> None:
        """Replace all entities, and drop those staged."""
        self._changed = None
        self.names, self.namespace_owners, self._body_owners = set(), {}, {}
        self._staged = {}
        self._entities = {entity.name: entity for entity in entities}
        for entity in self:
            self._reserve(entity)
        self._count_change()

    def take_changed(self) -> list[str] | None:
        """Take the names of the entities that came, went or were replaced since the last call.

        Returns:
            Names in the order of the changes; None if they are not known, as at the first call.
        """
        changed, self._changed = self._changed, {}
        return None if changed is None else list(changed)

    def _note_change(self, name: str) -> None:
        if self._changed is not None:
            self._changed.pop(name, None)  # the last change decides the order
            self._changed[name] = None

    def _reserve(self, entity: Entity) -> None:
        self.names.add(entity.name)
        self._body_owners[entity.body] = entity.name
        if entity.namespace:
            self.namespace_owners[entity.namespace] = entity.name

    def _free(self, entity: Entity) -> None:
        self.names.discard(entity.name)
        self.namespace_owners.pop(entity.namespace, None)
        self._body_owners.pop(entity.body, None)

    def _count_change(self) -> None:
        self.roster_number += 1
        self._index = None
        self._appended.clear()
