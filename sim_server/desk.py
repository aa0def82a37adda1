"""What handlers work on: the world, and what the server keeps beside it."""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim_server.assets import AssetStore
from sim_server.descriptions import Descriptions
from sim_server.lockstep import Lockstep
from sim_server.meter import Meter
from sim_server.stepping import Stepping
from sim_server.world import World


@dataclass
class Desk:
    """What handlers work on."""

    world: World
    meter: Meter
    now_ns: Callable[[], int]
    descriptions: Descriptions
    store: AssetStore
    world_model: str = ""
    target_real_time_factor: float = 1.0
    seed: int = 0
    alive_agents: set[str] = field(default_factory=set)
    alive_bonds: set[str] = field(default_factory=set)
    stepping: Stepping = field(default_factory=Stepping)
    lockstep: Lockstep = field(default_factory=Lockstep)
    has_read: bool = False
    """Whether descriptions have been read since the last turn."""
    bonded: dict[str, list[tuple[str, int]]] = field(default_factory=dict)
    """By bond: names of entities, and when they were born."""

    def end_bond(self, bond: str) -> None:
        """Take out what hangs on a bond that is gone."""
        self.alive_bonds.discard(bond)
        born = {entity.name: entity.born_ns for entity in self.world.entities}
        for name, born_ns in self.bonded.pop(bond, []):
            # Another entity may have got the name since.
            if born.get(name) == born_ns:
                self.world.delete(name)
