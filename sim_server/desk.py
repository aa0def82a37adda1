"""What handlers work on: the world, and what the server keeps beside it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.world_messages import WorldResource
from zensim.sim_server.description.sdf.sdf_world import WorldModel
from zensim.sim_server.durable import Durable, Told
from zensim.sim_server.errors import Refused
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.meter import Meter
from zensim.sim_server.pacing.stepping import Stepping
from zensim.sim_server.reading.assets import AssetStore
from zensim.sim_server.reading.descriptions import Descriptions, meshes_of
from zensim.sim_server.world.world import World
from zensim.sim_server.worlds.atlas import Atlas


@dataclass(frozen=True)
class Founded:
    """A world that is ready to take the place of another, and how fast it is to go."""

    world: World
    real_time_factor: float


Founding = Callable[[WorldModel], Iterator[Founded | None]]
"""Makes an engine and puts a world's models into it, a part at a time; the world comes last.

Raises SimError. Who does not go on to the end closes it.
"""


def no_founding(model: WorldModel) -> Iterator[Founded | None]:
    """Refuse: this desk has one world only."""
    raise Refused(
        ResultCode.FEATURE_UNSUPPORTED, f"world {model.name[:80]!r} cannot be made here; start anew"
    )


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
    pools: dict[str, int] = field(default_factory=dict)
    """Agents that have asked for a share, in that order, and the most robots that each drives."""
    alive_bonds: set[str] = field(default_factory=set)
    stepping: Stepping = field(default_factory=Stepping)
    lockstep: Lockstep = field(default_factory=Lockstep)
    due_ns: int = 0
    """When the next step is due: wall time."""
    has_read: bool = False
    """Whether descriptions have been read since the last turn."""
    journal: Durable | None = None
    told: tuple[Told, ...] = ()
    """What an earlier server answered, oldest first."""
    source: WorldModel = field(default_factory=lambda: WorldModel("default"))
    """The world as it was read."""
    bonded: dict[str, list[tuple[str, int]]] = field(default_factory=dict)
    """By bond: names of entities, and when they were born."""
    resource: WorldResource = field(default_factory=WorldResource)
    """How to ask for the world that is here."""
    atlas: Atlas = field(default_factory=lambda: Atlas(()))
    founding: Founding = no_founding

    def replace_world(self, founded: Founded, model: WorldModel, resource: WorldResource) -> None:
        """Put a world in the place of this one; a world without a name is none."""
        self.bonded.clear()
        self._pin_meshes(model)
        state = State.STOPPED if model.name else State.NO_WORLD
        self.world.become(founded.world, state)
        self.target_real_time_factor = founded.real_time_factor
        self.source, self.resource, self.world_model = model, resource, model.name

    def _pin_meshes(self, model: WorldModel) -> None:
        """Keep the meshes of a world for as long as one of its models may be made anew."""
        for name in {mesh for placed in model.models for mesh in meshes_of(placed.model)}:
            self.store.pin_kept(name)

    def end_bond(self, bond: str) -> None:
        """Take out what hangs on a bond that is gone."""
        self.alive_bonds.discard(bond)
        born = {entity.name: entity.born_ns for entity in self.world.entities}
        for name, born_ns in self.bonded.pop(bond, []):
            # Another entity may have got the name since.
            if born.get(name) == born_ns:
                self.world.delete(name)
