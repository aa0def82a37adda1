"""WorldHost: the loop, services and drives of a server in this process, without network."""

import os
import time
import weakref
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol, TypeVar
from uuid import uuid4

import msgspec

from zensim.api.api_errors import Unsupported
from zensim.api.state_classes import NotState
from zensim.api.world_pool import POOL, WorldOutput, WorldPool
from zensim.api.world_snapshots import (
    SnapshotPlace,
    check_like,
    make_wrong_snapshot,
    read_snapshot,
    write_snapshot,
)
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode, make_encoding
from zensim.proto.memory_bus import MemoryBus, MemoryQueries, MemorySubscription
from zensim.proto.messages.agent_messages import ClaimShareRequest, expand_grants
from zensim.proto.messages.input_messages import ServiceRequest
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.messages.telemetry_messages import InfoRequest, Snapshot
from zensim.proto.messages.world_messages import WorldResource
from zensim.proto.network_protocols import Sample
from zensim.proto.service_catalog import (
    CLAIM_SHARE,
    INFO,
    JOIN_LOCKSTEP,
    SIMULATE_STEPS,
    Request,
    Response,
    Service,
    require_ok,
)
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.topic_catalog import MAP
from zensim.proto.topic_faults import TopicFaults
from zensim.robot_agent.agent_config import AS_DESCRIBED, override_rates
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.sim_server.description.builtin_models import list_builtin_worlds
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import SimError, UnsupportedFeature
from zensim.sim_server.initial_world import load_initial_world, make_initial_world, make_parts
from zensim.sim_server.input_log.log_writer import make_noted_request
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.in_process_parser import InProcessParser
from zensim.sim_server.physics.engine import Engine, EngineRefused
from zensim.sim_server.runtime.loop import SavedLoop, ServerLoop
from zensim.sim_server.runtime.loop_channels import BusInbox
from zensim.sim_server.runtime.world_telemetry import GETTABLE_TOPICS
from zensim.sim_server.server_config import ServerConfig, validate_config
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.services.service_registry import ServiceHandlers, make_refusal
from zensim.sim_server.world.simulated_world import SavedWorld
from zensim.sim_server.world_loading.world_loader import (
    LoadedWorld,
    WorldLoaderRequest,
    load_world_in_process,
)
from zensim.sim_server.world_loading.world_loader_process import load_world_file

if TYPE_CHECKING:
    from zensim.api.collision_watch import CollisionWatch
    from zensim.api.in_process_sensors import InProcessSensors

CLIENT = "world"
"""Name of the only client."""
NO_RATES: Mapping[str, RateOverrides] = MappingProxyType({})
KEY_BYTES = 32
WAIT_S = 2e-4
"""Pause while a thread of the engine compiles a model."""


def load_trusted_world(request: WorldLoaderRequest) -> LoadedWorld:
    """Load a world in this process, without a sandbox; raises as `load_world_in_process`."""
    if request.name in list_builtin_worlds():
        return _load_builtin_world(request.name)
    return load_world_file(request.name, request.files)


@cache
def _load_builtin_world(name: str) -> LoadedWorld:
    return load_world_in_process(WorldLoaderRequest(name))  # needs no process


@cache
def open_shared_store(process_id: int) -> AssetStore:
    """Open the store of all worlds of a process: files and compiled models are shared."""
    del process_id
    return AssetStore()


More = TypeVar("More")
"""What a caller saves with the state of a server."""


def _name_states(engine: Engine) -> tuple[str, bytes]:
    """Choose the name of the engine of states, and their key.

    States that fit this world only have a name and key of its own: what Bullet reads of a state is
    not checked, so nobody else may write it.
    """
    if engine.capabilities.copies:
        return engine.name, b""
    return f"{engine.name}:{uuid4().hex}", os.urandom(KEY_BYTES)


class StepRecorder(Protocol):
    """Records what this world publishes."""

    def note_request(self, request: ServiceRequest) -> None:
        """Note a request that changed the world, or was refused."""

    def note_call(self) -> None:
        """Note that a service was called: time may have been reset, and entities spawned."""

    def take(self) -> None:
        """Take what was published since the last call."""


@dataclass(frozen=True)
class SavedHost:
    """State of an `WorldHost`."""

    world: SavedWorld
    current: tuple[WorldModel, WorldResource]
    seed: int
    robots: PooledRobots
    subscriptions: list[MemorySubscription]
    """Subscriptions of the robots."""
    queues: list[MemoryQueries]
    loop: SavedLoop
    sensor_faults: TopicFaults
    """Faults of lidars and cameras, with the messages that they keep."""
    followed: tuple[int, int]
    """Epoch of the robots' last state, and the roster of which they were claimed."""
    more: object
    """What the caller saves with it."""


def _check_kinds(saved: SavedHost) -> None:
    """Check what the lists of a saved state have; raises Invalid."""
    listed: tuple[tuple[type, object], ...] = (
        (MemorySubscription, saved.subscriptions),
        (MemoryQueries, saved.queues),
    )
    for kind, found in listed:
        if not isinstance(found, list) or not all(isinstance(one, kind) for one in found):
            raise make_wrong_snapshot(NotState(f"a list of others than {kind.__name__}"))


class IdleClock:
    """Clock of a loop that waits for nothing: what it divides among its turns is done at once."""

    def now_ns(self) -> int:
        """Read wall time 0; see `LoopClock`."""
        return 0

    def used_ns(self) -> int:
        """Read CPU time 0; see `LoopClock`."""
        return 0

    def sleep(self, seconds: float) -> None:
        """Sleep for a wall time; see `LoopClock`."""
        time.sleep(seconds)


CLOCK = IdleClock()


class WorldHost:
    """The loop of a paused server, in lockstep with a pool that drives all robots.

    The loop makes the steps and publishes what they change; services are called without a queue.
    """

    def __init__(self, config: ServerConfig, rates: Mapping[str, RateOverrides] = NO_RATES) -> None:
        """Load the world.

        Args:
            config: Of the server.
            rates: Of odometry and tf, by name of the robot; others have those of their model.

        Raises:
            ConfigError: The configuration is not valid, or there is no such world.
        """
        self.rates = rates
        config = msgspec.structs.replace(validate_config(config), requested=config)
        self._cleanup = ExitStack()
        self.close = weakref.finalize(self, self._cleanup.close)
        store = open_shared_store(os.getpid())
        loaded, self.config = load_initial_world(config, None, load_trusted_world)
        self.world = make_initial_world(self.config, loaded, store)
        self._cleanup.callback(self.world.close)
        self.parts = self._make_parts(loaded, store)
        self._handlers = ServiceHandlers(self.parts)
        self.network = MemoryBus(self.call)
        self.sensor_network = MemoryBus(self.call)
        """Network of lidars, cameras and the user's subscriptions; it is no part of the state."""
        self._sensors: InProcessSensors | None = None
        """Sensors from the first subscription to one of them on."""
        self._sensor_faults = TopicFaults()
        self.pool = WorldPool(self.network, self.world.name)
        self._output = WorldOutput(self.network, self.world.name, self.pool)
        nobody = BusInbox(MemoryBus(), self.world.name)
        self._loop = ServerLoop(self.parts, nobody, self._output, CLOCK)
        self._checked = (-1, -1)
        """Version of the subscriptions and of the claims that the publishers of robots know."""
        self._published_ns = 0
        self.collision_watch: CollisionWatch | None = None
        self.recorders: list[StepRecorder] = []
        self._engine, self._key = _name_states(self.world.engine)
        self._users = weakref.WeakSet[MemorySubscription]()
        """Subscriptions of the user; those of the robots are a part of the state."""
        self._shared_roster = self.world.entities.roster_number

    def _make_parts(self, loaded: LoadedWorld, store: AssetStore) -> ServerParts:
        world = self.config, loaded, self.world, InProcessParser(store)
        parts = make_parts(*world, store=store, now_ns=CLOCK.now_ns)
        parts.agents.alive.add(POOL)
        parts.pacing.lease.alive.add(CLIENT)
        return parts

    def call(self, service: Service[Request, Response], request: Request) -> Response:
        """Call a service; what it changes is done when this returns.

        Raises:
            ServiceError: The request was refused.
        """
        step = self.world.clock.steps
        try:
            response = self._handle(service, request)
        except SimError as error:
            response = make_refusal(service.name, error.code, str(error))
        except MalformedPayload as error:
            text = f"malformed request: {error}"
            response = make_refusal(service.name, ResultCode.OPERATION_FAILED, text)
        if self.recorders and service.is_mutating and service is not SIMULATE_STEPS:
            self._note_request(step, service.name, request, response)
        self._settle()
        return require_ok(service, response)

    def _note_request(
        self, step: int, service: str, request: msgspec.Struct, response: msgspec.Struct
    ) -> None:
        result = getattr(response, "result", None) or Result()
        code, message = result.result, result.error_message
        noted = make_noted_request(step, service, CLIENT, request, code, message)
        for recorder in self.recorders:
            recorder.note_request(noted)

    def step(self, steps: int) -> None:
        """Make steps; the pool answers each control step before the next step."""
        for _ in range(steps):
            self._check_publishers()
            self._loop.tick(0)
            self._finish_step()

    def _finish_step(self) -> None:
        """Do what is no part of a server's loop after a step, and let the pool answer."""
        if self.collision_watch is not None:
            self.collision_watch.update()
        if self.world.is_control_step:
            self._publish_due()
            self._answer()
            for recorder in self.recorders:
                recorder.take()
        self._loop.publish_events()

    def _answer(self, *, only_orders: bool = False) -> None:
        """Let the pool answer the states that were published.

        Orders between two control steps act at the next one.
        """
        for state in self._output.take_states():
            if only_orders and not self.pool.robots.repeats(state):
                continue
            if (command := self.pool.answer(state)) is not None:
                self._loop.agent_sessions.answer(POOL, command)

    def snapshot(self) -> Snapshot:
        """Read the states of all entities."""
        return self.world.snapshot(0.0)

    def save(self, more: object) -> bytes:
        """Write the state, and more, as bytes; see `restore`.

        Raises:
            Unsupported: The engine cannot save its state.
        """
        return write_snapshot(self._place, self._hold(more))

    def restore(self, snapshot: bytes, like: More) -> More:
        """Replace the state by a saved one; return what was saved with it, of such a class.

        Subscriptions of users stay. If it fails, the world is as before.

        Raises:
            Invalid: It is not a snapshot of this version and engine.
            Unsupported: The engine cannot restore it in this world.
        """
        try:
            saved = read_snapshot(self._place, snapshot)
        except EngineRefused as refused:
            raise Unsupported(str(refused), slug="not_restorable") from refused
        before, former = self._hold(like), self.world.engine
        if not isinstance(saved, SavedHost) or not isinstance(saved.more, type(like)):
            raise make_wrong_snapshot(NotState(f"a {type(saved).__name__}"))
        check_like(saved, before)
        _check_kinds(saved)
        try:
            self._load(saved)
            self.world.engine.resume()
            self._try_reading()
        except Exception as error:
            self._load(before)
            raise make_wrong_snapshot(error) from error
        former.close()
        return saved.more

    def _try_reading(self) -> None:
        """Read what each step reads; this raises if parts do not fit each other."""
        self.snapshot()
        self._handle(INFO, InfoRequest())
        for _ in self.world.drive_states():
            pass

    def _hold(self, more: object) -> SavedHost:
        """Take the state; its objects are those in use."""
        return SavedHost(
            world=self.world.save(),
            current=(self.parts.current_world.model, self.parts.current_world.resource),
            seed=self.parts.current_world.seed,
            robots=self.pool.robots,
            subscriptions=[one for one in self.network.subscriptions if one not in self._users],
            queues=self.network.queues,
            loop=self._loop.save(),
            sensor_faults=self._sensor_faults,
            followed=(self.pool.epoch, self._shared_roster),
            more=more,
        )

    def _load(self, saved: SavedHost) -> None:
        """Replace the state; it must be a copy, or the one that was before."""
        self.world.load(saved.world)
        current = self.parts.current_world
        (current.model, current.resource), current.seed = saved.current, saved.seed
        users = [one for one in self.network.subscriptions if one in self._users]
        self.network.replace([*users, *saved.subscriptions], saved.queues)
        self.pool.robots = saved.robots
        self._loop.load(saved.loop)
        self._checked, self._published_ns = (-1, -1), 0
        self._sensors, self._sensor_faults = None, saved.sensor_faults
        self.sensor_network = MemoryBus(self.call)
        for subscription in users:
            self.sensor_network.add(subscription)
        self.pool.epoch, self._shared_roster = saved.followed
        self._find_sensors()

    def subscribe(self, key: str, depth: int) -> MemorySubscription:
        """Subscribe to a topic, the last value of its keys first.

        Raises:
            Unsupported: It is of a sensor that this host cannot measure.
        """
        subscription = self.network.subscribe(key, depth)
        self._users.add(subscription)
        self.sensor_network.add(subscription)
        sensors = self._find_sensors()
        if sensors is not None and (refusal := sensors.find_refusal(key)):
            subscription.close()
            raise Unsupported(f"topic '{key}': {refusal}", slug="sensor_not_measured")
        subscription.samples.extend(self.get(key))
        return subscription

    def get(self, key: str) -> list[Sample]:
        """Get the last value of each key that fits."""
        query = self.network.query(key)
        self.pool.robots.check_all()
        self.pool.robots.reply_to_queries()
        last = query.samples or self.get_of_world(key)
        if (sensors := self._sensors) is not None:
            query = self.sensor_network.query(key)
            sensors.reply_to_queries()
            last = last or query.samples
        return last

    def get_of_world(self, key: str) -> list[Sample]:
        """Get the last value of a topic of the world, if it always has one."""
        for topic in GETTABLE_TOPICS.values():
            if topic.key(self.world.name) == key:
                loop = self._loop
                drawn = loop.world_map.draw() if topic is MAP else loop.telemetry.message(topic)
                return [Sample(key, encode(drawn, topic.format), topic.encoding)]
        return []

    def ask(self, service: Service[Request, Response], request: Request) -> Response:
        """Call a service that changes nothing, also between the parts of a step.

        Raises:
            ServiceError: The request was refused.
        """
        try:
            return require_ok(service, self._handle(service, request))
        except SimError as error:
            refusal = make_refusal(service.name, error.code, str(error))
            return require_ok(service, refusal)

    def publish(self, key: str, payload: bytes, encoding: str) -> None:
        """Publish a message of the user to robots and sensors."""
        for network in (self.network, self.sensor_network):
            network.advertise(key, encoding).send(payload)

    def _find_sensors(self) -> "InProcessSensors | None":
        """Find what measures the sensors, from the first subscription to one of them on."""
        if self._sensors is None and any(map(self._is_of_a_sensor, self._users)):
            from zensim.api.in_process_sensors import InProcessSensors  # noqa: PLC0415  casters

            self._sensors = InProcessSensors(self.world, self.sensor_network, self._sensor_faults)
        return self._sensors

    def _is_of_a_sensor(self, subscription: MemorySubscription) -> bool:
        """Whether a lidar or camera of this world has a topic of a subscription."""
        return any(
            keys.intersect(
                subscription.key, keys.robot(entity.namespace or entity.name, topic.name)
            )
            for entity in self.world.entities
            for sensor in entity.model.sensors
            if isinstance(sensor.settings, RaySensor | CameraSensor)
            for topic in sensor.topics
        )

    def _handle(self, service: Service[Request, Response], request: Request) -> msgspec.Struct:
        if service is JOIN_LOCKSTEP:
            raise UnsupportedFeature("a world in process has one client, which makes the steps")
        # Through the codec, which refuses what a server would refuse.
        encoding = make_encoding(request, Format.MSGPACK)
        read = decode(service.request, encode(request, Format.MSGPACK), encoding)
        response = self._handlers.handle(read)
        return self._finish(response) if isinstance(response, DeferredResponse) else response

    def _finish(self, deferred: DeferredResponse[Any]) -> msgspec.Struct:
        """Do what a response waits for: parsing, building, or requested steps."""
        descriptions, goals = self.parts.descriptions, self.parts.pacing.step_goals
        while True:
            descriptions.has_new = descriptions.provider.poll()
            if deferred.is_ready():
                response: msgspec.Struct = deferred.outcome()
                return response
            if goals:
                self._make_requested_steps()
            elif not descriptions.has_new:
                time.sleep(WAIT_S)

    def _make_requested_steps(self) -> None:
        self._loop.agent_sessions.publish_ordered_twists()
        self._answer(only_orders=True)
        self._check_publishers()
        self._loop.make_requested_steps(self._finish_step)
        self.pool.robots.log_malformed()

    def _settle(self) -> None:
        """Let the pool claim new robots, and follow changed claims and resets."""
        for recorder in self.recorders:
            recorder.note_call()
        roster = self.world.entities.roster_number
        if roster != self._shared_roster:
            self._shared_roster = roster
            self._claim()
            self._find_sensors()
        self._loop.agent_sessions.publish_changed_claims()
        self._answer()
        self._loop.publish_events()

    def _claim(self) -> None:
        is_more = True
        while is_more:
            response = self._handlers.handle(ClaimShareRequest(POOL))
            assert isinstance(response, CLAIM_SHARE.response)
            claims = expand_grants(response)
            self.pool.robots.add_claims(override_rates(claims, AS_DESCRIBED, self.rates))
            is_more = response.is_more

    @property
    def _place(self) -> SnapshotPlace:
        """Where a snapshot is taken and put; what it names is left as it is by `restore`."""
        parts = self.parts
        fixed = {
            "world": self.world,
            "network": self.network,
            "store": parts.store,
            "pacing": parts.pacing,
        }
        return SnapshotPlace(self._engine, fixed, parts.store.folder, self._key)

    def _check_publishers(self) -> None:
        """Let robots know of changed subscriptions, all at once: no message may be missed."""
        present = self.network.version, self.world.claims.changes
        if self._users and self._checked != present:
            self._checked = present
            self.pool.robots.check_all()
            self.pool.robots.reply_to_queries()

    def _publish_due(self) -> None:
        """Publish what users have subscribed to, in simulation time."""
        if not self._users:
            return
        time_ns = self.world.clock.time_ns
        if time_ns < self._published_ns:
            self._loop.telemetry.restart()
        self._published_ns = time_ns
        self._loop.publish_due(time_ns)
        if self._sensors is not None:
            self._sensors.publish()
