"""A validated spawn request, and the free names and namespaces that it resolves to."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.proto.names import InvalidName, check_name, check_namespace
from zensim.sim_server.errors import NameNotUnique, NameRefused, NamespaceRefused
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.world.entity import Entity

MAX_RENAMES = 100_000
BASE_NAME_CHARACTERS = 56
"""Of a name that gets a number: the rest is for the number."""


def find_free_name(name: str, taken: Collection[str], *, allow_renaming: bool) -> str:
    """Return the name, or with a number behind it when it is taken.

    Raises:
        NameRefused: It is not valid.
        NameNotUnique: It is taken and may not be changed.
    """
    try:
        check_name(name)
    except InvalidName as error:
        raise NameRefused(str(error)) from error
    if name not in taken:
        return name
    if not allow_renaming:
        raise NameNotUnique(name)
    numbered = (f"{name[:BASE_NAME_CHARACTERS]}_{i}" for i in range(1, MAX_RENAMES))
    return next(candidate for candidate in numbered if candidate not in taken)


def check_free_namespace(namespace: str, owners: Mapping[str, str]) -> str:
    """Return the namespace without slashes around it.

    Args:
        namespace: What was wished for.
        owners: Entities by the namespaces that they have.

    Raises:
        NamespaceRefused: It is not valid, or another entity has it.
    """
    try:
        bare = check_namespace(namespace)
    except InvalidName as error:
        raise NamespaceRefused(str(error)) from error
    if (owner := owners.get(bare)) is not None:
        raise NamespaceRefused(f"namespace '{bare}' belongs to entity '{owner}'; choose another")
    return bare


class NameIndex:
    """Which names, namespaces and bodies belong to whom, of those too that are expected only."""

    def __init__(self, entities: Iterable[Entity] = ()) -> None:
        self.taken: set[str] = set()
        self.owners: dict[str, str] = {}
        """Entities by their namespaces."""
        self._of_body: dict[int, str] = {}
        for entity in entities:
            self.add(entity)

    def add(self, entity: Entity) -> None:
        """Note an entity, or that it has another body."""
        self.taken.add(entity.name)
        self._of_body[entity.body] = entity.name
        if entity.namespace:
            self.owners[entity.namespace] = entity.name

    def drop(self, entity: Entity) -> None:
        """Note that an entity has gone."""
        self.taken.discard(entity.name)
        self.owners.pop(entity.namespace, None)
        self.drop_body(entity.body)

    def drop_body(self, body: int) -> None:
        """Note that a body has gone."""
        self._of_body.pop(body, None)

    def names_of_bodies(self, bodies: Iterable[int]) -> list[str]:
        """Name the entities that have these bodies."""
        return [self._of_body[body] for body in bodies if body in self._of_body]


@dataclass(frozen=True)
class ValidatedSpawn:
    """A checked wish to spawn."""

    name: str
    namespace: str
    model: Model
    base: FloatArray
    description: str = ""
    allow_renaming: bool = False
    born_ns: int = 0
    belongs_to_world: bool = False
    info: EntityInfo | None = None

    def resolve_names(self, names: NameIndex) -> tuple[str, str]:
        """Find the name and the namespace that it would get beside others.

        Raises:
            NameNotUnique: The name is taken and may not be changed.
            NameRefused: The name is not valid.
            NamespaceRefused: The namespace is not valid, or another entity has it.
        """
        name = find_free_name(self.name, names.taken, allow_renaming=self.allow_renaming)
        if self.belongs_to_world and self.model.drive is None:
            return name, ""
        return name, check_free_namespace(self.namespace or name, names.owners)
