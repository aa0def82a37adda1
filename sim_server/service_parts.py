"""Parts of a server that service handlers take as parameters, and deferred responses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple

import msgspec

from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model, Quat
from zensim.proto.messages.sensing_messages import Environment, SensorsReply
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.telemetry_messages import ModelFiles
from zensim.proto.messages.world_messages import WorldResource
from zensim.proto.rigid_transforms import multiply
from zensim.proto.sensor_libraries import Library
from zensim.proto.service_catalog import Response
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.description.model_geometry import FindCorners, find_ground_clearance
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import IncorrectState
from zensim.sim_server.pacing.joined_clients import JoinedClients
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.pacing.step_goals import StepGoals
from zensim.sim_server.pacing.stepping_lease import SteppingLease
from zensim.sim_server.pacing.topic_answers import TopicAnswers
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.description_cache import DescriptionProvider, list_assets
from zensim.sim_server.parser_process.mesh_server import PublishedFiles
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.simulated_world import BuiltWorld, SimulatedWorld, WorldFactory
from zensim.sim_server.world_loading.world_catalog import WorldCatalog

MAX_CLEARANCES = 64
"""Most models and orientations whose height over the ground is kept."""
UPSIDE_DOWN: Quat = (1.0, 0.0, 0.0, 0.0)
FLAT_M = 0.02
"""Height of a world's file that is ground only."""


@dataclass(frozen=True)
class DeferredResponse(Generic[Response]):
    """A response that a handler finishes in a later turn of the loop.

    Attributes:
        is_ready: Called at every turn of the loop in which it is due, so it must be cheap.
        outcome: Called once, when ready; raises as a handler does.
        is_due: Whether it may have become ready: reads one value, as its time is not measured.
    """

    is_ready: Callable[[], bool]
    outcome: Callable[[], Response]
    is_due: Callable[[], bool] = lambda: True


@dataclass(frozen=True)
class StepMode:
    """How simulation time advances."""

    state: State
    real_time_factor: float


@dataclass
class Pacing:
    """When steps are made: requested steps, lockstep, speed and timing of the loop."""

    now_ns: Callable[[], int]
    """Wall time."""
    loop_stats: LoopStats
    target_real_time_factor: float = 1.0
    """0 = as fast as possible."""
    step_goals: StepGoals = field(default_factory=StepGoals)
    lockstep: Lockstep = field(default_factory=Lockstep)
    lease: SteppingLease[StepMode] = field(default_factory=SteppingLease)
    joined: JoinedClients = field(init=False)
    answers: TopicAnswers = field(init=False)
    due_ns: int = 0
    """Wall time at which the next step is due."""

    def __post_init__(self) -> None:
        """Let the clients that join be awaited as agents are."""
        self.joined = JoinedClients(self.lockstep)
        self.answers = TopicAnswers(self.lockstep)

    @property
    def is_awaited(self) -> bool:
        """Whether the loop waits at control steps for agents and sensor processes."""
        has_clients = self.lockstep.settings.lockstep or self.answers.has_topics
        return has_clients or len(self.step_goals) > 0

    @property
    def is_paced(self) -> bool:
        """Whether simulation time runs at most as fast as wall time, or waits for replies."""
        return 0.0 < self.target_real_time_factor <= 1.0 or self.is_awaited


class ShareGrace(NamedTuple):
    """How long a pool that sends no command keeps its robots from other pools."""

    time_ns: int
    """Simulation time at which this began."""
    wall_ns: int
    """Wall time at which this began."""
    lasts_ns: int
    """Duration in simulation time and in wall time."""

    def lasts_at(self, time_ns: int, wall_ns: int) -> bool:
        """Whether it is not over; a reset, which sets time back, ends it."""
        passed_ns = min(time_ns - self.time_ns, wall_ns - self.wall_ns)
        return time_ns >= self.time_ns and passed_ns < self.lasts_ns


@dataclass
class Agents:
    """Agents that have a liveliness token."""

    alive: set[str] = field(default_factory=set)
    pool_limits: dict[str, int] = field(default_factory=dict)
    """Most robots of each pool, in the order of their first request."""
    state_formats: dict[str, Format] = field(default_factory=dict)
    """Format of the drive states of each agent that has asked for one."""
    settled_shares: dict[str, object] = field(default_factory=dict)
    """Basis of the last share of each pool that had nothing new."""
    graces: dict[str, ShareGrace] = field(default_factory=dict)
    """Grace, until the next command, of pools that sent none since they got robots, or for long."""


@dataclass
class SensorProcesses:
    """Sensor processes: those subscribed to scene states, and what the hosts of all lack."""

    active: set[str] = field(default_factory=set)
    missing: dict[str, frozenset[Library]] = field(default_factory=dict)
    """Missing libraries by process, also of one that is not active."""
    replies: dict[str, SensorsReply] = field(default_factory=dict)
    """Last reply of each process, with what it has published."""

    def note_missing(self, process: str, missing: frozenset[Library], *, is_alive: bool) -> None:
        """Note a token of what the host of a process lacks; the former one goes later."""
        if is_alive:
            self.missing[process] = missing
        elif self.missing.get(process) == missing:
            del self.missing[process]


@dataclass
class Bonds:
    """Entities that are deleted when the liveliness token of their bond disappears."""

    world: SimulatedWorld
    alive: set[str] = field(default_factory=set)
    entities: dict[str, list[tuple[str, int]]] = field(default_factory=dict)
    """Names of entities and `Entity.born_ns`, by bond."""

    def require(self, bond: str) -> None:
        """Refuse a bond without a token; an empty name is no bond.

        Raises:
            IncorrectState: The bond has no token.
        """
        if bond and bond not in self.alive:
            raise IncorrectState(
                f"bond '{bond[:80]}' has no liveliness token; declare it before spawning"
            )

    def add(self, bond: str, entity: Entity) -> None:
        """Delete the entity when the bond ends."""
        self.entities.setdefault(bond, []).append((entity.name, entity.born_ns))

    def end(self, bond: str) -> None:
        """Delete the entities of a bond whose token has disappeared."""
        self.alive.discard(bond)
        born = {entity.name: entity.born_ns for entity in self.world.entities}
        for name, born_ns in self.entities.pop(bond, []):
            # Another entity may have got the name since.
            if born.get(name) == born_ns:
                self.world.delete(name)


@dataclass
class Descriptions:
    """Parsed models, and the mesh files that they name."""

    provider: DescriptionProvider
    store: AssetStore
    has_new: bool = False
    """Whether descriptions have been parsed since the last turn of the loop."""
    published: PublishedFiles | None = None
    """Files that are offered by http; None = none are."""
    _clearances: dict[tuple[int, Quat], tuple[Model, float]] = field(
        default_factory=dict, repr=False, compare=False
    )

    def find_ground_clearance(self, model: Model, turn: Quat) -> float:
        """Find the height [m] of the lowest collision point; robots of a fleet share a model."""
        key = id(model), turn
        if (found := self._clearances.get(key)) is None:
            if len(self._clearances) >= MAX_CLEARANCES:
                self._clearances.clear()
            # The model is kept: another one could get its id.
            found = model, find_ground_clearance(model, turn, self.store.vertices)
            self._clearances[key] = found
        return found[1]

    def list_files(self, model: Model) -> ModelFiles:
        """List the files of the description of a model, while it is in the cache."""
        key = self.provider.find_parse_key(model)
        return ModelFiles(key.assets if key is not None else ())

    def locate_files(self, claims: Sequence[Claim]) -> tuple[Claim, ...]:
        """Name the files of claimed robots by their URLs in the descriptions, if offered."""
        if self.published is None:
            return tuple(claims)
        keys = {id(one.model): self.provider.find_parse_key(one.model) for one in claims}
        return tuple(
            msgspec.structs.replace(
                one, robot_description=self.published.publish(one.robot_description, key.assets)
            )
            if (key := keys[id(one.model)]) is not None
            else one
            for one in claims
        )


@dataclass
class CurrentWorld:
    """Description of the world that is loaded, and how to request it."""

    model: WorldModel
    resource: WorldResource = field(default_factory=WorldResource)
    seed: int = 0
    physics: EngineSettings = field(default_factory=EngineSettings)
    """Options of the server, for every world."""
    _top: tuple[WorldModel, float | None] | None = field(default=None, repr=False, compare=False)

    def find_top(self, corners: FindCorners) -> float | None:
        """Find the height [m] of the highest collision of the world's file; None on bare ground."""
        if self._top is None or self._top[0] is not self.model:
            heights = [
                placed.origin.position[2]
                - find_ground_clearance(
                    placed.model, multiply(UPSIDE_DOWN, placed.origin.orientation), corners
                )
                for placed in self.model.models
                if any(link.collisions for link in placed.model.links)
            ]
            self._top = self.model, max((one for one in heights if one > FLAT_M), default=None)
        return self._top[1]


def make_environment(world: SimulatedWorld, current: CurrentWorld) -> Environment:
    """Collect what sensors must know about the loaded world apart from its entities."""
    return Environment(
        seed=current.seed,
        gravity=current.model.gravity,
        magnetic_field=current.model.magnetic_field,
        spherical_coordinates=current.model.spherical_coordinates,
        step_ns=world.clock.step_ns,
        control_steps=world.control_steps,
        has_ground=current.model.ground_plane,
    )


@dataclass(frozen=True)
class Spawning:
    """What a spawn reads and changes."""

    world: SimulatedWorld
    descriptions: Descriptions
    bonds: Bonds
    pacing: Pacing
    current: CurrentWorld
    sensors: SensorProcesses = field(default_factory=SensorProcesses)


@dataclass
class WorldLoading:
    """What loading a world reads and replaces."""

    world: SimulatedWorld
    current: CurrentWorld
    pacing: Pacing
    bonds: Bonds
    descriptions: Descriptions
    catalog: WorldCatalog
    factory: WorldFactory

    def replace_world(self, built: BuiltWorld, model: WorldModel, resource: WorldResource) -> None:
        """Replace the loaded world; a model without a name means that no world is loaded."""
        self.bonds.entities.clear()
        self._pin_meshes(model)
        state = State.STOPPED if model.name else State.NO_WORLD
        self.world.replace_with(built.world, state)
        self.pacing.target_real_time_factor = built.real_time_factor
        self.current.model, self.current.resource = model, resource

    def _pin_meshes(self, model: WorldModel) -> None:
        """Pin the meshes of a world: a reset builds its models again."""
        for name in {mesh for placed in model.models for mesh in list_assets(placed.model)}:
            self.descriptions.store.pin_stored(name)


@dataclass(frozen=True)
class ServerParts:
    """All parts of one server: a handler gets those that its parameters name by type."""

    world: SimulatedWorld
    current_world: CurrentWorld
    pacing: Pacing
    agents: Agents
    sensors: SensorProcesses
    bonds: Bonds
    descriptions: Descriptions
    store: AssetStore
    spawning: Spawning
    loading: WorldLoading


def make_server_parts(
    world: SimulatedWorld,
    current: CurrentWorld,
    pacing: Pacing,
    descriptions: Descriptions,
    *,
    catalog: WorldCatalog,
    factory: WorldFactory,
) -> ServerParts:
    """Make the parts that depend on others."""
    bonds, sensors = Bonds(world), SensorProcesses()
    return ServerParts(
        world,
        current,
        pacing,
        Agents(),
        sensors,
        bonds,
        descriptions,
        descriptions.store,
        Spawning(world, descriptions, bonds, pacing, current, sensors),
        WorldLoading(world, current, pacing, bonds, descriptions, catalog, factory),
    )
