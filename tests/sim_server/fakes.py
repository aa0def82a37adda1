"""A world, an inbox, a publisher and a wall clock for tests of the server; no network, no sleep."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from tests.engines import STEP_NS, ObedientEngine
from tests.fakes import MemoryCall
from tests.models import a_cart, on_ground
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.spawn_messages import SpawnEntityOrder
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.network_protocols import Sample, ServiceCall
from zensim.proto.topic_catalog import DRIVE_COMMAND, INPUTS, TopicSpec
from zensim.sim_server.description.builtin_models import resolve_resource
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.journal_protocol import ChangeJournal
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.description_cache import ParseKey
from zensim.sim_server.parser_process.parser_protocol import ParseRequest, ParseResult
from zensim.sim_server.parser_process.parser_worker import parse_request
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.server_config import ServerConfig
from zensim.sim_server.service_parts import (
    CurrentWorld,
    DeferredResponse,
    Descriptions,
    Pacing,
    ServerParts,
    make_server_parts,
)
from zensim.sim_server.services.service_registry import ServiceHandlers
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world.spawn_request import ValidatedSpawn
from zensim.sim_server.world_loading.world_catalog import WorldCatalog
from zensim.sim_server.world_loading.world_loader import make_world_factory

CONTROL_STEPS = 3


class WallTime:
    """A wall clock that advances by setting it and by sleeping."""

    def __init__(self, now_ns: int = 5_000_000_000) -> None:
        self.ns = now_ns
        self.used = 0
        self.slept_s: list[float] = []

    def now_ns(self) -> int:
        return self.ns

    def used_ns(self) -> int:
        return self.used

    def sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.ns += round(seconds * 1e9)


class TimedEngine(ObedientEngine):
    """An ideal engine whose steps take wall time."""

    def __init__(self, wall: WallTime, cost_ns: int = 0) -> None:
        super().__init__(EngineConfig(STEP_NS))
        self.cost_ns = cost_ns
        self.began_ns: list[int] = []
        self._wall = wall

    def step(self) -> bool:
        self.began_ns.append(self._wall.ns)
        self._wall.ns += self.cost_ns
        self._wall.used += self.cost_ns
        return super().step()


class InlineParser:
    """Parse descriptions in this process, unless `is_slow`; `given` replaces the parsed model."""

    def __init__(self, store: AssetStore | None = None) -> None:
        self.is_slow = False
        self.given: Model | None = None
        self.remembered: dict[int, ParseKey] = {}
        self.store = store or AssetStore()
        self.unread: list[tuple[ParseResult, Callable[[ParseResult], None]]] = []

    def is_parsed(self, order: SpawnEntityOrder) -> bool:  # noqa: ARG002
        return not self.is_slow

    def model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        text = resolve_resource(order.entity_resource)
        if self.given is not None:
            return self.given, text
        described = parse_description(
            text, assets={}, allow_missing=order.allow_missing, compat=order.compat
        )
        return msgspec.structs.replace(described.model, dynamics=order.dynamics), text

    def find_parse_key(self, model: Model) -> ParseKey | None:
        return self.remembered.get(id(model))

    def remember(self, reading: ParseKey, model: Model) -> None:
        self.remembered[id(model)] = reading

    def parse(self, request: ParseRequest, on_parsed: Callable[[ParseResult], None]) -> None:
        files = {name: self.store.read(name, 0, self.store.size(name)) for name in request.files}
        answer, meshes = parse_request(request, files)
        for name, data in meshes.items():
            self.store.add(name, data)
        self.unread.append((answer, on_parsed))

    def poll(self) -> bool:
        if self.is_slow:
            return False
        unread, self.unread = self.unread, []
        for answer, on_parsed in unread:
            on_parsed(answer)
        return True


@dataclass
class ScriptedInbox:
    """An inbox filled by tests."""

    calls: list[MemoryCall] = field(default_factory=list)
    commands: list[Sample] = field(default_factory=list)
    agents: list[tuple[str, bool]] = field(default_factory=list)
    bonds: list[tuple[str, bool]] = field(default_factory=list)
    sensor_processes: list[tuple[str, bool]] = field(default_factory=list)
    sensor_libraries: list[tuple[str, str, bool]] = field(default_factory=list)
    sensor_replies: list[Sample] = field(default_factory=list)
    clients: list[tuple[str, bool]] = field(default_factory=list)
    twists: list[Sample] = field(default_factory=list)
    backlogged: set[str] = field(default_factory=set)
    """Clients with many unsent replies."""

    def take_calls(self) -> list[ServiceCall]:
        taken, self.calls = self.calls, []
        return taken  # type: ignore[return-value]

    def take_commands(self) -> list[Sample]:
        taken, self.commands = self.commands, []
        return taken

    def take_agents(self) -> list[tuple[str, bool]]:
        taken, self.agents = self.agents, []
        return taken

    def take_sensor_processes(self) -> list[tuple[str, bool]]:
        taken, self.sensor_processes = self.sensor_processes, []
        return taken

    def take_sensor_libraries(self) -> list[tuple[str, str, bool]]:
        taken, self.sensor_libraries = self.sensor_libraries, []
        return taken

    def take_sensor_replies(self) -> list[Sample]:
        taken, self.sensor_replies = self.sensor_replies, []
        return taken

    def take_clients(self) -> list[tuple[str, bool]]:
        taken, self.clients = self.clients, []
        return taken

    def take_twists(self) -> list[Sample]:
        taken, self.twists = self.twists, []
        return taken

    def take_bonds(self) -> list[tuple[str, bool]]:
        taken, self.bonds = self.bonds, []
        return taken

    def has_reply_backlog(self, client: str) -> bool:
        return client in self.backlogged

    def settle_replies(self, timeout_s: float) -> None:
        pass


@dataclass
class RecordingPublisher:
    """A publisher that records its messages."""

    sent: list[tuple[str, msgspec.Struct]] = field(default_factory=list)
    drive_states: list[tuple[str, DriveState]] = field(default_factory=list)
    forgotten: list[str] = field(default_factory=list)
    unwanted: set[str] = field(default_factory=lambda: {INPUTS.suffix})

    def is_wanted(self, topic: TopicSpec) -> bool:
        return topic.suffix not in self.unwanted

    def publish(self, topic: TopicSpec, message: msgspec.Struct) -> None:
        self.sent.append((topic.suffix, message))

    def serve_late_subscribers(self) -> None:
        pass

    def hold_messages(self) -> AbstractContextManager[None]:
        """Hold nothing."""
        return nullcontext()

    def publish_drive_state(
        self, agent: str, state: DriveState, form: Format = Format.MSGPACK
    ) -> None:
        del form
        self.drive_states.append((agent, state))

    def forget_agent(self, agent: str) -> None:
        self.forgotten.append(agent)

    def on(self, topic: str) -> list[msgspec.Struct]:
        return [message for topic_, message in self.sent if topic_ == topic]


@dataclass
class ServerFixture:
    """A loop with its fakes."""

    wall: WallTime
    engine: TimedEngine
    world: SimulatedWorld
    parts: ServerParts
    inbox: ScriptedInbox
    publisher: RecordingPublisher
    loop: ServerLoop

    def request(
        self, service: str, request: msgspec.Struct, format_: Format = Format.MSGPACK
    ) -> MemoryCall:
        """Put a request into the inbox."""
        return self.send(service, encode(request, format_), make_encoding(request, format_))

    def send(self, service: str, payload: bytes, encoding: str = "") -> MemoryCall:
        """Put bytes into the inbox as a request."""
        call = MemoryCall(f"sim/default/{service}", payload, encoding, b"")
        self.inbox.calls.append(call)
        return call

    def drive(self, agent: str, *targets: float) -> None:
        """Put an up-to-date drive command into the inbox."""
        command = msgspec.structs.replace(a_command(self.world, agent, *targets))
        self.inbox.commands.append(
            Sample(DRIVE_COMMAND.key("default", agent), encode(command, Format.MSGPACK), "")
        )

    def turn_for(self, seconds: float) -> None:
        """Turn the loop for a wall time."""
        end_ns = self.wall.ns + round(seconds * 1e9)
        while self.wall.ns < end_ns:
            before_ns = self.wall.ns
            self.loop.turn()
            if self.wall.ns == before_ns:
                self.wall.ns += 1000

    def events(self) -> list[tuple[str, str]]:
        """List the published events: kind and entity."""
        sent = [event for event in self.publisher.on("events") if isinstance(event, Event)]
        return [(event.kind, event.entity) for event in sent]


def a_server(
    *names: str, factor: float = 1.0, cost_ns: int = 0, journal: ChangeJournal | None = None
) -> ServerFixture:
    """Make a loop over a world of carts."""
    wall = WallTime()
    engine = TimedEngine(wall, cost_ns)
    world = a_world(*names, engine=engine)
    parts = make_parts(world, wall, factor=factor)
    inbox, publisher = ScriptedInbox(), RecordingPublisher()
    loop = ServerLoop(parts, inbox, publisher, wall, journal)
    return ServerFixture(wall, engine, world, parts, inbox, publisher, loop)


def make_parts(
    world: SimulatedWorld, wall: WallTime | None = None, *, factor: float = 1.0
) -> ServerParts:
    """Make the parts of a server for a world."""
    clock = wall or WallTime()
    store = AssetStore()
    return make_server_parts(
        world,
        CurrentWorld(WorldModel("empty", ground_plane=True), seed=7),
        Pacing(clock.now_ns, LoopStats(clock.now_ns()), factor),
        Descriptions(InlineParser(store), store),
        catalog=WorldCatalog(()),
        factory=make_world_factory(
            ServerConfig(bus=BusConfig()),
            lambda config, _: ObedientEngine(EngineConfig(config.step_ns)),
        ),
    )


def handle_request(
    parts: ServerParts, request: msgspec.Struct
) -> msgspec.Struct | DeferredResponse[Any]:
    """Handle a request with the handlers of one server."""
    return ServiceHandlers(parts).handle(request)


def a_world(*names: str, engine: ObedientEngine | None = None) -> SimulatedWorld:
    """Make a world of carts, 1 m apart, whose events have been taken."""
    world = SimulatedWorld(
        engine or ObedientEngine(EngineConfig(STEP_NS)),
        name="default",
        step_ns=STEP_NS,
        control_steps=CONTROL_STEPS,
    )
    for i, name in enumerate(names):
        world.spawn(a_spawn(name, base=on_ground(float(i))))
    world.clock.take_events()
    return world


def a_spawn(
    name: str,
    namespace: str = "",
    *,
    model: Model | None = None,
    base: FloatArray | None = None,
    allow_renaming: bool = False,
) -> ValidatedSpawn:
    place = on_ground() if base is None else base
    return ValidatedSpawn(name, namespace, model or a_cart(), place, "<robot/>", allow_renaming)


def a_command(world: SimulatedWorld, agent: str, *targets: float) -> DriveCommand:
    """Make a command that replies to the newest state."""
    fleet = world.claimed_by_agent().get(agent)
    claims = fleet.claims if fleet else b""
    return DriveCommand(world.clock.epoch, world.clock.steps, claims, floats(targets))


def floats(numbers: Sequence[float]) -> bytes:
    return np.array(numbers, dtype="<f8").tobytes()


def answer_of(call: MemoryCall, kind: type[msgspec.Struct]) -> msgspec.Struct:
    """Decode the only reply of a call."""
    (answer,) = call.answers
    return decode(kind, answer.payload, answer.encoding)


def names_in(world: SimulatedWorld) -> list[str]:
    return [entity.name for entity in world.entities]


def kinds_of_events(world: SimulatedWorld) -> list[str]:
    return [event.kind for event in world.clock.take_events()]


def wheel_speeds(world: SimulatedWorld) -> list[float]:
    speeds: list[float] = world.states().joint_velocities.tolist()
    return speeds
