"""What service handlers share: the world and the state that the server keeps beside it; responses that are given later."""

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.world_messages import WorldResource
from zensim.sim_server.description.sdf.sdf_world import WorldModel
from zensim.sim_server.journal_protocol import ChangeJournal, JournaledResponse
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.pacing.step_goals import StepGoals
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.description_cache import DescriptionProvider, list_meshes
from zensim.sim_server.world.simulated_world import World
from zensim.sim_server.world_loading.world_catalog import WorldCatalog
from zensim.sim_server.world_loading.world_loader import BuiltWorld, WorldFactory, refuse_new_world


@dataclass(frozen=True)
class DeferredResponse:
    """What a handler returns when it has begun, and something must happen before it can answer.

    Attributes:
        is_ready: Asked at every turn of the loop, so it must cost nothing.
        outcome: Called once, when ready; raises as a handler does.
    """

    is_ready: Callable[[], bool]
    outcome: Callable[[], msgspec.Struct]


@dataclass
class ServerContext:
    """What handlers work on."""

    world: World
    loop_stats: LoopStats
    now_ns: Callable[[], int]
    descriptions: DescriptionProvider
    store: AssetStore
    world_model: str = ""
    target_real_time_factor: float = 1.0
    seed: int = 0
    alive_agents: set[str] = field(default_factory=set)
    pools: dict[str, int] = field(default_factory=dict)
    """Agents that have asked for a share, in that order, and the most robots that each drives."""
    alive_bonds: set[str] = field(default_factory=set)
    step_goals: StepGoals = field(default_factory=StepGoals)
    lockstep: Lockstep = field(default_factory=Lockstep)
    due_ns: int = 0
    """When the next step is due: wall time."""
    has_new_descriptions: bool = False
    """Whether descriptions have been read since the last turn."""
    journal: ChangeJournal | None = None
    earlier_responses: tuple[JournaledResponse, ...] = ()
    """What an earlier server answered, oldest first."""
    source: WorldModel = field(default_factory=lambda: WorldModel("default"))
    """The world as it was read."""
    bonded_entities: dict[str, list[tuple[str, int]]] = field(default_factory=dict)
    """By bond: names of entities, and when they were born."""
    resource: WorldResource = field(default_factory=WorldResource)
    """How to ask for the world that is here."""
    world_catalog: WorldCatalog = field(default_factory=lambda: WorldCatalog(()))
    world_factory: WorldFactory = refuse_new_world

    def replace_world(
        self, founded: BuiltWorld, model: WorldModel, resource: WorldResource
    ) -> None:
        """Put a world in the place of this one; a world without a name is none."""
        self.bonded_entities.clear()
        self._pin_meshes(model)
        state = State.STOPPED if model.name else State.NO_WORLD
        self.world.replace_with(founded.world, state)
        self.target_real_time_factor = founded.real_time_factor
        self.source, self.resource, self.world_model = model, resource, model.name

    def _pin_meshes(self, model: WorldModel) -> None:
        """Keep the meshes of a world for as long as one of its models may be made anew."""
        for name in {mesh for placed in model.models for mesh in list_meshes(placed.model)}:
            self.store.pin_kept(name)

    def delete_bonded_entities(self, bond: str) -> None:
        """Take out what hangs on a bond that is gone."""
        self.alive_bonds.discard(bond)
        born = {entity.name: entity.born_ns for entity in self.world.entities}
        for name, born_ns in self.bonded_entities.pop(bond, []):
            # Another entity may have got the name since.
            if born.get(name) == born_ns:
                self.world.delete(name)
