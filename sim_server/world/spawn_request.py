"""A validated spawn request, and the free names and namespaces that it resolves to."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.proto.names import InvalidName, check_name, check_namespace
from zensim.sim_server.errors import NameNotUnique, NameRefused, NamespaceRefused
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.world.entity_store import EntityStore

MAX_RENAMES = 100_000
BASE_NAME_CHARACTERS = 56
"""Characters that are kept of a name when a number is appended."""


def find_free_name(name: str, taken: Collection[str], *, allow_renaming: bool) -> str:
    """Return the name, with a number appended if it is taken.

    Raises:
        NameRefused: It is not valid.
        NameNotUnique: It is taken and renaming is not allowed.
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
    """Return the namespace without surrounding slashes.

    Args:
        namespace: As requested.
        owners: Names of entities by namespace.

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


@dataclass(frozen=True)
class ValidatedSpawn:
    """A validated request to spawn an entity."""

    name: str
    namespace: str
    model: Model
    base: FloatArray
    description: str = ""
    allow_renaming: bool = False
    born_ns: int = 0
    belongs_to_world: bool = False
    info: EntityInfo | None = None
    start: FloatArray | None = None
    """State row (13,) at which the body is made; None = `base`, which a reset restores."""

    def resolve_names(self, entities: EntityStore) -> tuple[str, str]:
        """Find a free name and namespace.

        Raises:
            NameNotUnique: The name is taken and renaming is not allowed.
            NameRefused: The name is not valid.
            NamespaceRefused: The namespace is not valid, or another entity has it.
        """
        name = find_free_name(self.name, entities.names, allow_renaming=self.allow_renaming)
        if self.belongs_to_world and self.model.drive is None:
            return name, ""
        return name, check_free_namespace(self.namespace or name, entities.namespace_owners)
