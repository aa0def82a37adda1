"""Names and namespaces that are still free."""

from collections.abc import Collection, Iterable, Mapping

from zensim.proto.names import InvalidName, check_name, check_namespace
from zensim.sim_server.errors import NameNotUnique, NameRefused, NamespaceRefused
from zensim.sim_server.world.entity import Entity

MAX_RENAMES = 100_000
BARE_CHARACTERS = 56
"""Of a name that gets a number: the rest is for the number."""


def free_name(name: str, taken: Collection[str], *, allow_renaming: bool) -> str:
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
    numbered = (f"{name[:BARE_CHARACTERS]}_{i}" for i in range(1, MAX_RENAMES))
    return next(candidate for candidate in numbered if candidate not in taken)


def free_namespace(namespace: str, owners: Mapping[str, str]) -> str:
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


class Names:
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

    def of_bodies(self, bodies: Iterable[int]) -> list[str]:
        """Name the entities that have these bodies."""
        return [self._of_body[body] for body in bodies if body in self._of_body]
