"""Names and namespaces that are still free."""

from collections.abc import Collection, Iterable

from proto.names import InvalidName, check_name, check_namespace
from sim_server.errors import NameNotUnique, NameRefused, NamespaceRefused
from sim_server.world.entity import Entity

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


def free_namespace(namespace: str, entities: Iterable[Entity]) -> str:
    """Return the namespace without slashes around it.

    Raises:
        NamespaceRefused: It is not valid, or another entity has it.
    """
    try:
        bare = check_namespace(namespace)
    except InvalidName as error:
        raise NamespaceRefused(str(error)) from error
    for entity in entities:
        if entity.namespace == bare:
            raise NamespaceRefused(
                f"namespace '{bare}' belongs to entity '{entity.name}'; choose another"
            )
    return bare
