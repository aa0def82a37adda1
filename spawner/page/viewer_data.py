"""ViewerDataSource: what the page draws of one world, subscribed while a client looks at it."""

from collections.abc import Callable
from typing import Final

import msgspec

from zensim.proto import keys
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.messages.telemetry_messages import GetModelsResponse, Snapshot, Stats
from zensim.proto.network_protocols import FollowingNetwork, Sample
from zensim.proto.se3 import transform_points
from zensim.proto.topic_catalog import CMD_VEL, SNAPSHOT, STATS, find_topic
from zensim.spawner.client.topic_reader import TopicReader, WantedTopics, keep_raw, read_topic
from zensim.spawner.client.world_follower import WorldFollower
from zensim.spawner.page.mesh_fetcher import MeshFetcher
from zensim.spawner.page.model_visuals import TriangleMeshes
from zensim.spawner.page.render_state import (
    LastCommand,
    MismatchedSnapshot,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
    UnknownEntity,
    find_sensor_pose,
    make_fleet,
    make_frame,
)
from zensim.spawner.page.sensor_views import (
    SensedFrame,
    SensorChoice,
    SensorView,
    read_picture,
    read_points,
)
from zensim.spawner.page.side_panel import WatchedTopic
from zensim.spawner.page.world_calls import CALL_TIMEOUT_S

MIN_FRAME_PERIOD_S: Final = 0.025
"""Minimum time between frames: 30 snapshots/s are all shown, of 60/s every other."""
STILL_PERIOD_S: Final = 0.1
"""Time between two views of a world that plays while nothing in it moves."""
SERVER_TIMEOUT_S: Final = 1.8
"""A server sends snapshots at 2 Hz even when paused."""
MonotonicClock = Callable[[], float]
_FleetInputs = tuple[tuple[str, ...], GetModelsResponse, TriangleMeshes]
"""Arguments of `make_fleet`."""


class ViewState(msgspec.Struct, frozen=True, eq=False):
    """Everything to show at one step."""

    fleet: RenderedFleet
    frame: RenderedFrame
    status: SimulationStatus


SCAN_PERIOD_S: Final = 0.1
"""Minimum time between two drawings of a lidar."""
PICTURE_PERIOD_S: Final = 0.2
"""Minimum time between two pictures of a camera."""
WATCH_PERIOD_S: Final = 0.1
"""Minimum time between two messages of a watched topic."""
MAX_WATCHED_BYTES: Final = 512 << 10
"""Largest message of a watched topic: 100,000 rays, decoded while nothing is drawn."""


class SensorMonitors:
    """Subscriptions to exactly the sensors that clients show.

    Attributes:
        malformed: Messages that could not be read.
    """

    def __init__(self, subscribe: Callable[[str], TopicReader[Sample]]) -> None:
        self._topics: WantedTopics[tuple[SensorChoice, SensorView], TopicReader[Sample]]
        self._topics = WantedTopics(subscribe)
        self.malformed = 0

    def receive(self, choices: frozenset[SensorChoice], view: ViewState) -> SensedFrame:
        """Subscribe to exactly these sensors; return what is new of each.

        Args:
            choices: Those of unknown entities or topics are not shown.
            view: Of the poses at which points are drawn.
        """
        fleet = view.fleet
        wanted = {
            (choice, sensor): keys.robot(fleet.members[choice.entity].namespace, choice.topic)
            for choice in choices
            if (sensor := fleet.sensors.get(choice)) is not None
        }
        self._topics.follow(wanted)
        sensed = SensedFrame()
        for (choice, sensor), reader in self._topics:
            sample = reader.newest(PICTURE_PERIOD_S if sensor.is_picture else SCAN_PERIOD_S)
            if sample is None:
                continue
            try:
                self._read(choice, sensor, sample, view, sensed)
            except MalformedPayload:
                self.malformed += 1
        return sensed

    def close(self) -> None:
        """Close all subscriptions."""
        self._topics.close()

    @staticmethod
    def _read(
        choice: SensorChoice, sensor: SensorView, sample: Sample, at: ViewState, sensed: SensedFrame
    ) -> None:
        if sensor.is_picture:
            sensed.pictures[choice] = read_picture(sample.payload, sample.encoding)
            return
        points = read_points(sensor, sample.payload, sample.encoding)
        pose = find_sensor_pose(at.fleet, at.frame, choice)
        sensed.points[choice] = transform_points(pose, points)


class WatchMonitors:
    """Subscriptions to exactly the topics that clients watch.

    Attributes:
        malformed: Messages that could not be read.
    """

    def __init__(self, subscribe: Callable[[str], TopicReader[Sample]], world: str) -> None:
        self._world = world
        self._topics: WantedTopics[WatchedTopic, TopicReader[Sample]] = WantedTopics(subscribe)
        self.malformed = 0

    def receive(
        self, watches: frozenset[WatchedTopic], fleet: RenderedFleet
    ) -> dict[WatchedTopic, msgspec.Struct]:
        """Subscribe to exactly these topics; return the newest message of each.

        Args:
            watches: Those of unknown entities are not received.
            fleet: All entities.
        """
        wanted = {watch: key for watch in watches if (key := self._find_key(watch, fleet))}
        self._topics.follow(wanted)
        found: dict[WatchedTopic, msgspec.Struct] = {}
        for watch, reader in self._topics:
            if (sample := reader.newest(WATCH_PERIOD_S)) is None:
                continue
            try:
                found[watch] = read_watched(watch, sample)
            except MalformedPayload:
                self.malformed += 1
        return found

    def close(self) -> None:
        """Close all subscriptions."""
        self._topics.close()

    def _find_key(self, watch: WatchedTopic, fleet: RenderedFleet) -> str:
        if not watch.entity:
            return find_topic(watch.topic).key(self._world)
        member = fleet.members.get(watch.entity)
        return keys.robot(member.namespace, watch.name) if member and member.namespace else ""


def read_watched(watch: WatchedTopic, sample: Sample) -> msgspec.Struct:
    """Decode a message of a watched topic.

    Raises:
        MalformedPayload: It is of another type, or too large.
    """
    if len(sample.payload) > MAX_WATCHED_BYTES:
        raise MalformedPayload(f"{len(sample.payload)} bytes; at most {MAX_WATCHED_BYTES} are read")
    return decode(find_topic(watch.topic).messages[0], sample.payload, sample.encoding)


def read_command(sample: Sample) -> Twist:
    """Read a velocity command; raises MalformedPayload."""
    return decode_twist(sample.payload, sample.encoding)


class ViewerDataSource:
    """Subscriptions to one world; open while a viewer client is connected."""

    def __init__(
        self, network: FollowingNetwork, world: str, clock: MonotonicClock, fetcher: MeshFetcher
    ) -> None:
        self._network, self._world, self._clock = network, world, clock
        self._fetcher = fetcher
        self._follower = WorldFollower(network, world, timeout_s=CALL_TIMEOUT_S, clock=clock)
        self._snapshots = read_topic(network, SNAPSHOT.key(world), Snapshot, clock=clock)
        self._stats = read_topic(network, STATS.key(world), Stats, clock=clock)
        self._fleet = RenderedFleet()
        self._fleet_inputs: _FleetInputs | None = None
        self._frame: tuple[RenderedFleet, bytes, bytes, RenderedFrame] | None = None
        """Frame of the last snapshot, with what it was made of."""
        self._shown: tuple[RenderedFrame, str] | None = None
        """Frame and state of the last view."""
        self._still_until = 0.0

        def subscribe(key: str) -> TopicReader[Sample]:
            return TopicReader(network.subscribe(key), keep_raw, clock=clock)

        def subscribe_to_commands(key: str) -> TopicReader[Twist]:
            return TopicReader(network.subscribe(key), read_command, clock=clock)

        self._commands: WantedTopics[str, TopicReader[Twist]] = WantedTopics(subscribe_to_commands)
        self._sensors = SensorMonitors(subscribe)
        self._watches = WatchMonitors(subscribe, world)

    @property
    def error_text(self) -> str:
        """Error of the last call for models; empty = success."""
        problem = self._follower.problem
        return problem and f"cannot get the models of the robots: {problem}"

    @property
    def is_silent(self) -> bool:
        """Whether the server has published nothing for `SERVER_TIMEOUT_S`."""
        return self._snapshots.is_silent(SERVER_TIMEOUT_S)

    def close(self) -> None:
        """Close all subscriptions."""
        for one in (self._follower, self._snapshots, self._stats, self._commands):
            one.close()
        self._sensors.close()
        self._watches.close()

    def newest(self, *, is_still_shown: bool = False) -> ViewState | None:
        """Return the newest valid snapshot, if there is one and the frame period has passed.

        Args:
            is_still_shown: Whether a world in which nothing moves is returned as often as another.
        """
        self._watch_server()
        if not self.is_silent:
            self._fetcher.fetch()
        snapshot = self._snapshots.newest(MIN_FRAME_PERIOD_S)
        if snapshot is None:
            return None
        try:
            view = self._view(snapshot)
            return None if view is None or self._is_repeated(view, is_still_shown) else view
        except (UnknownEntity, MismatchedSnapshot):
            return None

    def _is_repeated(self, view: ViewState, is_still_shown: bool) -> bool:  # noqa: FBT001
        """Whether nothing but the time differs from the last view, which is not long ago."""
        shown = view.frame, view.status.state
        is_same = self._shown is not None and self._shown[0] is shown[0]
        is_playing = self._shown is not None and self._shown[1] == shown[1] == "playing"
        now = self._snapshots.heard_s
        if is_same and is_playing and not is_still_shown and now < self._still_until:
            return True
        self._shown, self._still_until = shown, now + STILL_PERIOD_S
        return False

    def commands(self, entities: frozenset[str]) -> dict[str, LastCommand]:
        """Subscribe to the commands of those entities that have topics; return the last of each."""
        # A wall has no namespace, hence no topics.
        wanted = {
            entity: CMD_VEL.key(member.namespace)
            for entity, member in self._fleet.members.items()
            if entity in entities and member.namespace
        }
        self._commands.follow(wanted)
        commands = {}
        for entity, reader in self._commands:
            reader.newest()
            if (twist := reader.last) is not None:
                age_s = self._clock() - reader.heard_s
                commands[entity] = LastCommand(twist.linear.x, twist.angular.z, age_s=age_s)
        return commands

    def sense(self, choices: frozenset[SensorChoice], view: ViewState) -> SensedFrame:
        """Subscribe to exactly these sensors; return what is new of each at the poses of a view."""
        return self._sensors.receive(choices, view)

    def receive(self, watches: frozenset[WatchedTopic]) -> dict[WatchedTopic, msgspec.Struct]:
        """Subscribe to exactly these topics; return the newest message of each."""
        return self._watches.receive(watches, self._fleet)

    def _watch_server(self) -> None:
        for is_alive in self._follower.take().servers:
            self._snapshots.heard_s = self._clock() if is_alive else float("-inf")

    def _view(self, snapshot: Snapshot) -> ViewState | None:
        models = self._find_models(snapshot)
        if models is None:
            return None
        inputs = (snapshot.names, models, self._fetcher.meshes)
        if inputs != self._fleet_inputs:
            self._fleet = make_fleet(*inputs)
            self._fleet_inputs = inputs
        self._stats.newest()
        status = SimulationStatus(
            state=snapshot.state,
            sim_time_s=snapshot.time_ns / 1e9,
            real_time_factor=snapshot.real_time_factor,
            robots=len(self._fleet.robots),
            entities=len(snapshot.names),
            malformed=self._sensors.malformed + self._watches.malformed,
            stats=self._stats.last,
        )
        return ViewState(self._fleet, self._make_frame(snapshot), status)

    def _make_frame(self, snapshot: Snapshot) -> RenderedFrame:
        """Make the frame of a snapshot; the same object if nothing has moved."""
        made_of = self._fleet, snapshot.base, snapshot.joint_positions
        if (
            self._frame is None
            or self._frame[0] is not made_of[0]
            or self._frame[1:3] != made_of[1:]
        ):
            self._frame = *made_of, make_frame(self._fleet, snapshot)
        return self._frame[3]

    def _find_models(self, snapshot: Snapshot) -> GetModelsResponse | None:
        """Find the models; None before the server of the snapshot has sent them."""
        self._follower.note_roster(snapshot.roster)
        if self._follower.poll() and self._follower.models is not None:
            self._fetcher.set_models(self._follower.models.models)
        return self._follower.models if self._follower.is_current else None
