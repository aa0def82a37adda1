"""InProcessServer: the world, services and drives of a server in this process, without network."""

import os
import time
import weakref
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar
from uuid import uuid4

import msgspec

from zensim.api.api_errors import Unsupported
from zensim.api.in_process_network import (
    InProcessNetwork,
    InProcessPublisher,
    InProcessQueries,
    InProcessSubscription,
)
from zensim.api.state_classes import NotState
from zensim.api.world_snapshots import (
    SnapshotPlace,
    check_like,
    make_wrong_snapshot,
    read_snapshot,
    write_snapshot,
)
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import ClaimShareRequest, DriveState, expand_grants
from zensim.proto.messages.input_messages import ServiceRequest
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.telemetry_messages import Event, InfoRequest, Snapshot
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
from zensim.proto.topic_catalog import CONTACTS, EVENTS, MAP, TopicSpec
from zensim.proto.topic_faults import TopicFaults
from zensim.robot_agent.agent_config import AS_DESCRIBED, RateOverrides, override_rates
from zensim.robot_agent.bumpers import read_contact_report
from zensim.robot_agent.fleet_odometry import FleetOdometryPublisher
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.sim_server.description.builtin_models import list_builtin_worlds
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import SimError, UnsupportedFeature
from zensim.sim_server.initial_world import load_initial_world, make_initial_world, make_parts
from zensim.sim_server.input_log.log_writer import make_noted_request
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.in_process_parser import InProcessParser
from zensim.sim_server.physics.engine import Engine, EngineRefused
from zensim.sim_server.runtime.contact_telemetry import ContactTelemetry, TouchingSensors
from zensim.sim_server.runtime.world_map import WorldMap
from zensim.sim_server.runtime.world_telemetry import GETTABLE_TOPICS, DueTimes, WorldTelemetry
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

POOL = "pool"
"""Name of the agent that drives all robots."""
CLIENT = "world"
"""Name of the only client."""
CMD_VEL_TIMEOUT_NS = 500_000_000
"""Default of a pool: see `AgentConfig.cmd_vel_timeout_s`."""
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


def read_no_time() -> int:
    """Return wall time 0: what a server divides among turns of its loop is done at once."""
    return 0


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


class SavedTelemetry(NamedTuple):
    """State of an `InProcessTelemetry`."""

    due_times: DueTimes
    touching: TouchingSensors


@dataclass(frozen=True)
class SavedServer:
    """State of an `InProcessServer`."""

    world: SavedWorld
    current: tuple[WorldModel, WorldResource]
    seed: int
    robots: PooledRobots
    subscriptions: list[InProcessSubscription]
    """Subscriptions of the robots."""
    queues: list[InProcessQueries]
    telemetry: SavedTelemetry
    sensor_faults: TopicFaults
    """Faults of lidars and cameras, with the messages that they keep."""
    followed: tuple[tuple[int, int], int, int]
    more: object
    """What the caller saves with it."""


def _check_kinds(saved: SavedServer) -> None:
    """Check what the lists of a saved state have; raises Invalid."""
    listed: tuple[tuple[type, object], ...] = (
        (InProcessSubscription, saved.subscriptions),
        (InProcessQueries, saved.queues),
    )
    for kind, found in listed:
        if not isinstance(found, list) or not all(isinstance(one, kind) for one in found):
            raise make_wrong_snapshot(NotState(f"a list of others than {kind.__name__}"))


class InProcessServer:
    """One world, its services, and a pool that drives all robots.

    It does what a paused server in lockstep with one pool does, with the same bits.
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
        parts = self.config, loaded, self.world, InProcessParser(store)
        self.parts: ServerParts = make_parts(*parts, store=store, now_ns=read_no_time)
        self.parts.agents.alive.add(POOL)
        self.parts.pacing.lease.alive.add(CLIENT)
        self._handlers = ServiceHandlers(self.parts)
        self.network = InProcessNetwork(self.call)
        self.sensor_network = InProcessNetwork(self.call)
        """Network of lidars, cameras and the user's subscriptions; it is no part of the state."""
        self._sensors: InProcessSensors | None = None
        """Sensors from the first subscription to one of them on."""
        self._sensor_faults = TopicFaults()
        self.robots = PooledRobots(self.network, CMD_VEL_TIMEOUT_NS)
        self._telemetry = InProcessTelemetry(self.parts, self.network, self.robots)
        self.collision_watch: CollisionWatch | None = None
        self.recorders: list[StepRecorder] = []
        self._engine, self._key = _name_states(self.world.engine)
        self._users = weakref.WeakSet[InProcessSubscription]()
        """Subscriptions of the user; those of the robots are a part of the state."""
        self._shared_roster = self.world.entities.roster_number
        self._followed = self._version
        self._followed_orders = 0

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
        world = self.world
        for _ in range(steps):
            world.step()
            if self.collision_watch is not None:
                self.collision_watch.update()
            if world.is_control_step:
                self._finish_control_step()
        self._telemetry.publish_events()

    def follow(self) -> None:
        """Let the pool answer the present state, as after each control step."""
        for agent, state in self.world.drive_states():
            if agent == POOL:
                self._follow_state(state)
        self._followed = self._version
        self.world.commanded_twists.note_published()
        self._followed_orders = self.world.commanded_twists.changes

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
        if not isinstance(saved, SavedServer) or not isinstance(saved.more, type(like)):
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

    def _hold(self, more: object) -> SavedServer:
        """Take the state; its objects are those in use."""
        return SavedServer(
            world=self.world.save(),
            current=(self.parts.current_world.model, self.parts.current_world.resource),
            seed=self.parts.current_world.seed,
            robots=self.robots,
            subscriptions=[one for one in self.network.subscriptions if one not in self._users],
            queues=self.network.queues,
            telemetry=self._telemetry.save(),
            sensor_faults=self._sensor_faults,
            followed=(self._followed, self._followed_orders, self._shared_roster),
            more=more,
        )

    def _load(self, saved: SavedServer) -> None:
        """Replace the state; it must be a copy, or the one that was before."""
        self.world.load(saved.world)
        current = self.parts.current_world
        (current.model, current.resource), current.seed = saved.current, saved.seed
        users = [one for one in self.network.subscriptions if one in self._users]
        self.network.replace([*users, *saved.subscriptions], saved.queues)
        self.robots = saved.robots
        self._telemetry = InProcessTelemetry(self.parts, self.network, self.robots)
        self._telemetry.load(saved.telemetry)
        self._sensors, self._sensor_faults = None, saved.sensor_faults
        self.sensor_network = InProcessNetwork(self.call)
        for subscription in users:
            self.sensor_network.add(subscription)
        self._followed, self._followed_orders, self._shared_roster = saved.followed
        self._find_sensors()

    def subscribe(self, key: str, depth: int) -> InProcessSubscription:
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
        self.robots.check_all()
        self.robots.reply_to_queries()
        last = query.samples or self.get_of_world(key)
        if (sensors := self._sensors) is not None:
            query = self.sensor_network.query(key)
            sensors.reply_to_queries()
            last = last or query.samples
        return last

    def get_of_world(self, key: str) -> list[Sample]:
        """Get the last value of a topic of the world, if it always has one."""
        return self._telemetry.find_last(key)

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

    def _is_of_a_sensor(self, subscription: InProcessSubscription) -> bool:
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
        goals = self.parts.pacing.step_goals
        self._follow_orders()
        while goals.has_steps_left and self.world.clock.state == State.PAUSED:
            self.step(1)
            goals.note_step()
        goals.finish_completed()

    def _follow_orders(self) -> None:
        """Let the pool answer the present state again if twists were ordered since."""
        twists = self.world.commanded_twists
        if self._followed_orders == twists.changes:
            return
        for agent, state in self.world.drive_states():
            if agent == POOL and state.twists and self.robots.repeats(state):
                self.world.command(POOL, self.robots.repeat(state))
        twists.note_published()
        self._followed_orders = twists.changes

    def _settle(self) -> None:
        """Let the pool claim new robots, and follow changed claims and resets."""
        for recorder in self.recorders:
            recorder.note_call()
        roster = self.world.entities.roster_number
        if roster != self._shared_roster:
            self._shared_roster = roster
            self._claim()
            self._find_sensors()
        if self._followed != self._version:
            self.follow()
        self._telemetry.publish_events()

    def _claim(self) -> None:
        is_more = True
        while is_more:
            response = self._handlers.handle(ClaimShareRequest(POOL))
            assert isinstance(response, CLAIM_SHARE.response)
            claims = expand_grants(response)
            self.robots.add_claims(override_rates(claims, AS_DESCRIBED, self.rates))
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

    @property
    def _version(self) -> tuple[int, int]:
        return self.world.clock.epoch, self.world.claims.changes

    @cached_property
    def _odometry(self) -> FleetOdometryPublisher:
        return FleetOdometryPublisher(self.network, self.world.name, POOL)

    def _follow_state(self, state: DriveState) -> None:
        if state.epoch != self._followed[0]:
            self.robots.reset()
        self.robots.release_all_except(state.claims)
        if state.claims:
            self.world.command(POOL, self.robots.advance(state))
            self.robots.publish()
            if self._odometry.is_wanted:
                self._odometry.publish(state, self.robots.list_odometry())

    def _finish_control_step(self) -> None:
        if self._users:
            self._telemetry.publish()
            if self._sensors is not None:
                self._sensors.publish()
        self.follow()
        for recorder in self.recorders:
            recorder.take()


class InProcessTelemetry:
    """Publishes the topics of a world in simulation time, and contacts to its pool."""

    def __init__(self, parts: ServerParts, network: InProcessNetwork, robots: PooledRobots) -> None:
        self._world = parts.world
        self._network = network
        self._robots = robots
        self._publishers: dict[TopicSpec, InProcessPublisher] = {}
        self._map = WorldMap(
            parts,
            is_wanted=self._is_wanted,
            publish=self._put,
            # They get it from `find_last`.
            serve_late_subscribers=lambda: None,
        )
        self._messages = WorldTelemetry(parts.world, parts.pacing, parts.sensors, self._map)
        self._contacts = ContactTelemetry(parts.world, parts.store.vertices)
        self._checked = (-1, -1)
        """Version of the subscriptions and of the claims that the publishers of robots know."""
        self._published_ns = 0

    def publish(self) -> None:
        """Publish what is due at a control step; contacts first, as a server does."""
        self._check_publishers()
        self._publish_contacts()
        time_ns = self._world.clock.time_ns
        if time_ns < self._published_ns:
            self._messages.restart()
        self._published_ns = time_ns
        for topic in self._messages.due(time_ns):
            if self._is_wanted(topic):
                self._put(topic, self._messages.message(topic))
        self._map.poll(time_ns)

    def _check_publishers(self) -> None:
        """Let robots know of changed subscriptions, all at once: no message may be missed."""
        present = self._network.version, self._world.claims.changes
        if self._checked != present:
            self._checked = present
            self._robots.check_all()
            self._robots.reply_to_queries()

    def save(self) -> SavedTelemetry:
        """Take the times at which messages are due, and what contact sensors touch."""
        return SavedTelemetry(self._messages.save(), self._contacts.save())

    def load(self, saved: SavedTelemetry) -> None:
        """Replace what `save` took."""
        self._messages.load(saved.due_times)
        self._contacts.load(saved.touching)

    def find_last(self, key: str) -> list[Sample]:
        """Make the message of a topic of the world, if it is one that always has a value."""
        for topic in GETTABLE_TOPICS.values():
            if topic.key(self._world.name) == key:
                message = self._map.draw() if topic is MAP else self._messages.message(topic)
                return [Sample(key, encode(message, topic.format), topic.encoding)]
        return []

    def publish_events(self) -> None:
        """Publish the events since the last call."""
        events: list[Event] = self._world.clock.take_events()
        for event in events if self._network.subscriptions else ():
            self._put(EVENTS, event)

    def _publish_contacts(self) -> None:
        wants = self._robots.wants_contacts
        is_wanted = wants or self._is_wanted(CONTACTS) or self._is_wanted(EVENTS)
        if is_wanted and self._contacts.has_sensors:
            contacts = self._contacts.read()
            self._put(CONTACTS, contacts)
            if wants:
                self._robots.publish_contacts(read_contact_report(contacts))

    def _is_wanted(self, topic: TopicSpec) -> bool:
        return self._find_publisher(topic).is_matched

    def _put(self, topic: TopicSpec, message: msgspec.Struct) -> None:
        if (publisher := self._find_publisher(topic)).is_matched:
            publisher.send(encode(message, topic.format))

    def _find_publisher(self, topic: TopicSpec) -> InProcessPublisher:
        if (publisher := self._publishers.get(topic)) is None:
            key = topic.key(self._world.name)
            publisher = self._publishers[topic] = self._network.advertise(key, topic.encoding)
        return publisher
