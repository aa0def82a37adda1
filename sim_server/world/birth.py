"""A checked wish to spawn, and the names that it would get."""

from dataclasses import dataclass

from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.world.naming import Names, free_name, free_namespace


@dataclass(frozen=True)
class Birth:
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

    def names_among(self, names: Names) -> tuple[str, str]:
        """Find the name and the namespace that it would get beside others.

        Raises:
            NameNotUnique: The name is taken and may not be changed.
            NameRefused: The name is not valid.
            NamespaceRefused: The namespace is not valid, or another entity has it.
        """
        name = free_name(self.name, names.taken, allow_renaming=self.allow_renaming)
        if self.belongs_to_world and self.model.drive is None:
            return name, ""
        return name, free_namespace(self.namespace or name, names.owners)
