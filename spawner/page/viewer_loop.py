"""Loop of the viewer; it subscribes only while a client has the page open."""

import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from hashlib import sha256
from typing import Final, Protocol

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.messages.model_messages import Model, Shape
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    ResetSimulationRequest,
    SetSimulationStateRequest,
    SimulationState,
    State,
    StepSimulationRequest,
)
from zensim.proto.messages.telemetry_messages import (
    GetModelsResponse,
    Snapshot,
    Stats,
)
from zensim.proto.network_protocols import (
    CallingNetwork,
    FollowingNetwork,
    Sample,
    SubscribingNetwork,
    Subscription,
)
from zensim.proto.se3 import transform_points
from zensim.proto.service_catalog import (
    DELETE_ENTITY,
    GET_ASSET,
    RESET_SIMULATION,
    SET_SIMULATION_STATE,
    STEP_SIMULATION,
    Request,
    Response,
    Service,
)
from zensim.proto.stl import read_corners, stl_size
from zensim.proto.topic_catalog import CMD_VEL, SNAPSHOT, STATS, find_topic
from zensim.spawner.client.world_follower import WorldFollower
from zensim.spawner.page.model_visuals import (
    NO_MESHES,
    TriangleMesh,
    TriangleMeshes,
    find_mesh_name,
    make_textured_mesh,
    weld_triangles,
)
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
from zensim.spawner.page.script_messages import HeadOrder
from zensim.spawner.page.sensor_views import (
    SensedFrame,
    SensorChoice,
    SensorView,
    read_picture,
    read_points,
)
from zensim.spawner.page.side_panel import Order, WatchedTopic, WorldCall
from zensim.spawner.page.world_calls import CALL_TIMEOUT_S, WorldCalls

MESH_CALL_TIMEOUT_S: Final = 0.8
MESH_RETRY_S: Final = 1.0
MAX_MESH_BYTES: Final = stl_size(60_000)
"""Limit of one mesh; servers send no larger ones."""
MESH_BUDGET_BYTES: Final = 128 << 20
"""Limit of all files; without its mesh a robot is drawn by its collision shapes."""
FETCH_BUDGET_S: Final = 0.03
"""Time for files between two frames."""
IMAGE_STARTS: Final = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")
"""First bytes of PNG and JPEG."""


class MeshFetcher:
    """Fetches the meshes and textures of models in chunks; call `fetch` periodically.

    Attributes:
        meshes: By `find_mesh_name`; replaced when all available files have been fetched.
    """

    def __init__(
        self,
        network: CallingNetwork,
        world: str,
        clock: Callable[[], float],
        budget_bytes: int = MESH_BUDGET_BYTES,
    ) -> None:
        self._network, self._world, self._clock = network, world, clock
        self._budget_bytes = budget_bytes
        self._pending: dict[str, bytearray] = {}
        self._next_call_at = 0.0
        self._found: dict[str, bytes] = {}
        self._shapes: dict[str, Shape] = {}
        self.meshes: TriangleMeshes = NO_MESHES

    def set_models(self, models: Iterable[Model]) -> None:
        """Set the models whose files are fetched; failed ones are retried."""
        self._shapes = list_visual_meshes(models)
        named = dict.fromkeys(name for s in self._shapes.values() for name in _list_files(s))
        self._found = {name: data for name, data in self._found.items() if name in named}
        self._pending = {
            name: self._pending.get(name, bytearray()) for name in named if name not in self._found
        }
        self._publish()

    def fetch(self) -> None:
        """Fetch pending files for a moment."""
        ends_at = self._clock() + FETCH_BUDGET_S
        while self._pending and self._next_call_at <= self._clock() < ends_at:
            self._fetch_chunk()

    def _fetch_chunk(self) -> None:
        name, data = next(iter(self._pending.items()))
        try:
            response = self._network.call(
                GET_ASSET,
                GetAssetRequest(name, len(data)),
                world=self._world,
                timeout_s=MESH_CALL_TIMEOUT_S,
            )
        except ServiceError:
            self._finish(name, None)
            return
        except (BusError, TimeoutError, MalformedPayload):
            self._next_call_at = self._clock() + MESH_RETRY_S
            return
        data += response.data
        if not self._has_room(response.total) or not response.data:
            self._finish(name, None)
        elif len(data) >= response.total:
            self._finish(name, bytes(data))

    def _has_room(self, total: int) -> bool:
        used = sum(map(len, self._found.values()))
        return total <= MAX_MESH_BYTES and used + total <= self._budget_bytes

    def _finish(self, name: str, data: bytes | None) -> None:
        del self._pending[name]
        if data is not None and sha256(data).hexdigest() == name:
            self._found[name] = data
        self._publish()

    def _publish(self) -> None:
        if self._pending:
            return
        meshes: dict[str, TriangleMesh] = {}
        for name, shape in self._shapes.items():
            mesh = self.meshes.get(name) or _make_mesh(shape, self._found)
            if mesh is not None:
                meshes[name] = mesh
            elif shape.texture is not None:
                plain = _make_mesh(msgspec.structs.replace(shape, texture=None), self._found)
                meshes |= {shape.mesh: plain} if plain is not None else {}
        if meshes.keys() != self.meshes.keys():
            self.meshes = meshes


def list_visual_meshes(models: Iterable[Model]) -> dict[str, Shape]:
    """List one visual for each mesh and texture, by `find_mesh_name`, in order."""
    links = (link for model in models for link in model.links)
    shapes = (shape for link in links for shape in link.visuals if shape.kind == "mesh")
    return {find_mesh_name(shape): shape for shape in shapes}


def _list_files(shape: Shape) -> list[str]:
    """List the sha256 of the files of a visual."""
    texture = shape.texture
    names = [shape.mesh, texture.image, texture.coordinates] if texture else [shape.mesh]
    return [name for name in names if name]


def _make_mesh(shape: Shape, files: Mapping[str, bytes]) -> TriangleMesh | None:
    """Make the mesh of a visual; None if a file is missing or malformed."""
    if not all(name in files for name in _list_files(shape)):
        return None
    try:
        corners = read_corners(files[shape.mesh])
    except ValueError:
        return None
    if not len(corners) or not np.isfinite(corners).all():
        return None
    if shape.texture is None:
        return weld_triangles(corners)
    image, written = files[shape.texture.image], files.get(shape.texture.coordinates, b"")
    if len(written) != 8 * len(corners) or not image.startswith(IMAGE_STARTS):
        return None
    coordinates = np.frombuffer(written, "<f4").reshape(-1, 2)
    return (
        make_textured_mesh(corners, coordinates, image) if np.isfinite(coordinates).all() else None
    )


MIN_FRAME_PERIOD_S: Final = 0.025
"""Minimum time between frames: 30 snapshots/s are all shown, of 60/s every other."""
STILL_PERIOD_S: Final = 0.1
"""Time between two views of a world that plays while nothing in it moves."""
SERVER_TIMEOUT_S: Final = 1.8
"""A server sends snapshots at 2 Hz even when paused."""

RESETS: Final[Mapping[str, int]] = {
    "Reset time and poses": ResetScope.TIME | ResetScope.STATE,
    "Reset poses": ResetScope.STATE,
    "Reset time": ResetScope.TIME,
    "Reset all": ResetScope.ALL,
}
"""Scopes of the orders that reset."""

MonotonicClock = Callable[[], float]
_FleetInputs = tuple[tuple[str, ...], GetModelsResponse, TriangleMeshes]
"""Arguments of `make_fleet`."""


class ViewState(msgspec.Struct, frozen=True, eq=False):
    """Everything to show at one step."""

    fleet: RenderedFleet
    frame: RenderedFrame
    status: SimulationStatus


class CommandMonitor:
    """Monitors the velocity commands of one robot."""

    def __init__(self, samples: Subscription) -> None:
        self._samples = samples
        self._command: tuple[float, float] | None = None
        self._received_at = 0.0

    def last(self, now: float) -> LastCommand | None:
        """Return the last valid command, if any."""
        sample = self._samples.newest()
        if sample is not None:
            self._receive(sample, now)
        return LastCommand(*self._command, age_s=now - self._received_at) if self._command else None

    def close(self) -> None:
        """Close all subscriptions."""
        self._samples.close()

    def _receive(self, sample: Sample, now: float) -> None:
        try:
            twist = decode_twist(sample.payload, sample.encoding)
        except MalformedPayload:
            return
        self._command, self._received_at = (twist.linear.x, twist.angular.z), now


SCAN_PERIOD_S: Final = 0.1
"""Minimum time between two drawings of a lidar."""
PICTURE_PERIOD_S: Final = 0.2
"""Minimum time between two pictures of a camera."""


class SensorMonitor:
    """Receives the newest message of a topic of a sensor, at most once per period."""

    def __init__(self, key: str, view: SensorView, samples: Subscription) -> None:
        self.key, self.view = key, view
        self._samples = samples
        self._next_at = 0.0

    def newest(self, now: float) -> Sample | None:
        """Return the newest message, if there is one and the period has passed."""
        sample = self._samples.newest() if now >= self._next_at else None
        if sample is not None:
            period_s = PICTURE_PERIOD_S if self.view.is_picture else SCAN_PERIOD_S
            # From when it was due, as views come at times of their own; unless that is long ago.
            due = self._next_at + period_s
            self._next_at = due if due > now else now + period_s
        return sample

    def close(self) -> None:
        """Close the subscription."""
        self._samples.close()


class SensorMonitors:
    """Subscriptions to exactly the sensors that clients show.

    Attributes:
        malformed: Messages that could not be read.
    """

    def __init__(self, network: SubscribingNetwork) -> None:
        self._network = network
        self._monitors: dict[SensorChoice, SensorMonitor] = {}
        self.malformed = 0

    def receive(self, choices: frozenset[SensorChoice], view: ViewState, now: float) -> SensedFrame:
        """Subscribe to exactly these sensors; return what is new of each.

        Args:
            choices: Those of unknown entities or topics are not shown.
            view: Of the poses at which points are drawn.
            now: Monotonic time [s].
        """
        self._subscribe(choices, view.fleet)
        sensed = SensedFrame()
        for choice, monitor in self._monitors.items():
            sample = monitor.newest(now)
            if sample is None:
                continue
            try:
                self._read(choice, monitor.view, sample, view, sensed)
            except MalformedPayload:
                self.malformed += 1
        return sensed

    def close(self) -> None:
        """Close all subscriptions."""
        for monitor in self._monitors.values():
            monitor.close()
        self._monitors = {}

    def _subscribe(self, choices: frozenset[SensorChoice], fleet: RenderedFleet) -> None:
        wanted = {
            choice: (keys.robot(fleet.members[choice.entity].namespace, choice.topic), view)
            for choice in choices
            if (view := fleet.sensors.get(choice)) is not None
        }
        for choice, monitor in [*self._monitors.items()]:
            if wanted.get(choice) != (monitor.key, monitor.view):
                self._monitors.pop(choice).close()
        for choice in wanted.keys() - self._monitors.keys():
            key, view = wanted[choice]
            self._monitors[choice] = SensorMonitor(key, view, self._network.subscribe(key))

    @staticmethod
    def _read(
        choice: SensorChoice, view: SensorView, sample: Sample, at: ViewState, sensed: SensedFrame
    ) -> None:
        if view.is_picture:
            sensed.pictures[choice] = read_picture(sample.payload, sample.encoding)
            return
        points = read_points(view, sample.payload, sample.encoding)
        pose = find_sensor_pose(at.fleet, at.frame, choice)
        sensed.points[choice] = transform_points(pose, points)


WATCH_PERIOD_S: Final = 0.1
"""Minimum time between two messages of a watched topic."""
MAX_WATCHED_BYTES: Final = 512 << 10
"""Largest message of a watched topic: 100,000 rays, decoded while nothing is drawn."""


class WatchMonitor:
    """Subscription to a watched topic."""

    def __init__(self, key: str, samples: Subscription) -> None:
        self.key, self.samples, self.next_at = key, samples, 0.0


class WatchMonitors:
    """Subscriptions to exactly the topics that clients watch.

    Attributes:
        malformed: Messages that could not be read.
    """

    def __init__(self, network: SubscribingNetwork, world: str) -> None:
        self._network, self._world = network, world
        self._monitors: dict[WatchedTopic, WatchMonitor] = {}
        self.malformed = 0

    def receive(
        self, watches: frozenset[WatchedTopic], fleet: RenderedFleet, now: float
    ) -> dict[WatchedTopic, msgspec.Struct]:
        """Subscribe to exactly these topics; return the newest message of each.

        Args:
            watches: Those of unknown entities are not received.
            fleet: All entities.
            now: Monotonic time [s].
        """
        self._subscribe(watches, fleet)
        found: dict[WatchedTopic, msgspec.Struct] = {}
        for watch, monitor in self._monitors.items():
            sample = monitor.samples.newest() if now >= monitor.next_at else None
            if sample is None:
                continue
            monitor.next_at = now + WATCH_PERIOD_S
            try:
                found[watch] = read_watched(watch, sample)
            except MalformedPayload:
                self.malformed += 1
        return found

    def close(self) -> None:
        """Close all subscriptions."""
        for monitor in self._monitors.values():
            monitor.samples.close()
        self._monitors = {}

    def _subscribe(self, watches: frozenset[WatchedTopic], fleet: RenderedFleet) -> None:
        wanted = {watch: key for watch in watches if (key := self._find_key(watch, fleet))}
        for watch, monitor in [*self._monitors.items()]:
            if wanted.get(watch) != monitor.key:
                self._monitors.pop(watch).samples.close()
        for watch in wanted.keys() - self._monitors.keys():
            samples = self._network.subscribe(wanted[watch])
            self._monitors[watch] = WatchMonitor(wanted[watch], samples)

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


class ViewerDataSource:
    """Subscriptions to one world; open while a viewer client is connected."""

    def __init__(
        self, network: FollowingNetwork, world: str, clock: MonotonicClock, fetcher: MeshFetcher
    ) -> None:
        self._network, self._world, self._clock = network, world, clock
        self._fetcher = fetcher
        self._follower = WorldFollower(network, world, timeout_s=CALL_TIMEOUT_S, clock=clock)
        self._snapshots = network.subscribe(SNAPSHOT.key(world))
        self._stats_samples = network.subscribe(STATS.key(world))
        self._stats: Stats | None = None
        self._next_frame_at = clock()
        self._received_at = clock()
        self._fleet = RenderedFleet()
        self._fleet_inputs: _FleetInputs | None = None
        self._frame: tuple[RenderedFleet, bytes, bytes, RenderedFrame] | None = None
        """Frame of the last snapshot, with what it was made of."""
        self._shown: tuple[RenderedFrame, str] | None = None
        """Frame and state of the last view."""
        self._still_until = 0.0
        self._monitors: dict[str, CommandMonitor] = {}
        self._sensors = SensorMonitors(network)
        self._watches = WatchMonitors(network, world)

    @property
    def error_text(self) -> str:
        """Error of the last call for models; empty = success."""
        problem = self._follower.problem
        return problem and f"cannot get the models of the robots: {problem}"

    @property
    def is_silent(self) -> bool:
        """Whether the server has published nothing for `SERVER_TIMEOUT_S`."""
        return self._clock() - self._received_at > SERVER_TIMEOUT_S

    def close(self) -> None:
        """Close all subscriptions."""
        self._follower.close()
        self._snapshots.close()
        self._stats_samples.close()
        self._sensors.close()
        self._watches.close()
        for monitor in self._monitors.values():
            monitor.close()

    def newest(self, *, is_still_shown: bool = False) -> ViewState | None:
        """Return the newest valid snapshot, if there is one and the frame period has passed.

        Args:
            is_still_shown: Whether a world in which nothing moves is returned as often as another.
        """
        self._watch_server()
        if not self.is_silent:
            self._fetcher.fetch()
        if self._clock() < self._next_frame_at:
            return None
        sample = self._snapshots.newest()
        if sample is None:
            return None
        self._received_at = self._clock()
        self._next_frame_at = self._received_at + MIN_FRAME_PERIOD_S
        try:
            snapshot = decode(Snapshot, sample.payload, sample.encoding)
            view = self._view(snapshot)
            return None if view is None or self._is_repeated(view, is_still_shown) else view
        except (MalformedPayload, UnknownEntity, MismatchedSnapshot):
            return None

    def _is_repeated(self, view: ViewState, is_still_shown: bool) -> bool:  # noqa: FBT001
        """Whether nothing but the time differs from the last view, which is not long ago."""
        shown = view.frame, view.status.state
        is_same = self._shown is not None and self._shown[0] is shown[0]
        is_playing = self._shown is not None and self._shown[1] == shown[1] == "playing"
        if is_same and is_playing and not is_still_shown and self._received_at < self._still_until:
            return True
        self._shown, self._still_until = shown, self._received_at + STILL_PERIOD_S
        return False

    def commands(self, entities: frozenset[str]) -> dict[str, LastCommand]:
        """Subscribe to the commands of those entities that have topics; return the last of each."""
        # A wall has no namespace, hence no topics.
        namespaces = {
            entity: member.namespace
            for entity, member in self._fleet.members.items()
            if entity in entities and member.namespace
        }
        for gone in self._monitors.keys() - namespaces.keys():
            self._monitors.pop(gone).close()
        for entity in namespaces.keys() - self._monitors.keys():
            samples = self._network.subscribe(CMD_VEL.key(namespaces[entity]))
            self._monitors[entity] = CommandMonitor(samples)
        now = self._clock()
        commands = {entity: monitor.last(now) for entity, monitor in self._monitors.items()}
        return {entity: command for entity, command in commands.items() if command is not None}

    def sense(self, choices: frozenset[SensorChoice], view: ViewState) -> SensedFrame:
        """Subscribe to exactly these sensors; return what is new of each at the poses of a view."""
        return self._sensors.receive(choices, view, self._clock())

    def receive(self, watches: frozenset[WatchedTopic]) -> dict[WatchedTopic, msgspec.Struct]:
        """Subscribe to exactly these topics; return the newest message of each."""
        return self._watches.receive(watches, self._fleet, self._clock())

    def _watch_server(self) -> None:
        for is_alive in self._follower.take().servers:
            self._received_at = self._clock() if is_alive else float("-inf")

    def _take_stats(self) -> Stats | None:
        """Take the newest statistics, published once a second."""
        sample = self._stats_samples.newest()
        if sample is not None:
            with suppress(MalformedPayload):
                self._stats = decode(Stats, sample.payload, sample.encoding)
        return self._stats

    def _view(self, snapshot: Snapshot) -> ViewState | None:
        models = self._find_models(snapshot)
        if models is None:
            return None
        inputs = (snapshot.names, models, self._fetcher.meshes)
        if inputs != self._fleet_inputs:
            self._fleet = make_fleet(*inputs)
            self._fleet_inputs = inputs
        status = SimulationStatus(
            state=snapshot.state,
            sim_time_s=snapshot.time_ns / 1e9,
            real_time_factor=snapshot.real_time_factor,
            robots=len(self._fleet.robots),
            entities=len(snapshot.names),
            malformed=self._sensors.malformed + self._watches.malformed,
            stats=self._take_stats(),
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


IDLE_S: Final = 0.1
"""Period of the loop without clients."""
POLL_S: Final = 1.0 / 60.0
MAX_CALLS_S: Final = 0.5
"""Time after which no further short call is made before the next frame is drawn."""
LATE: Final = "the server replies too late, so this was not requested; try again"


class PageProtocol(Protocol):
    """Page as the loop uses it."""

    @property
    def is_watched(self) -> bool:
        """Whether a client has the page open."""

    @property
    def selected(self) -> frozenset[str]:
        """Entities that a client has selected."""

    @property
    def shown_sensors(self) -> frozenset[SensorChoice]:
        """Sensors that a client shows."""

    @property
    def watched(self) -> frozenset[WatchedTopic]:
        """Topics that a client watches."""

    def wait_for_input(self, timeout_s: float) -> list[Order]:
        """Wait for events of clients, and return their orders."""

    def show(
        self,
        fleet: RenderedFleet,
        frame: RenderedFrame,
        status: SimulationStatus,
        commands: Mapping[str, LastCommand],
    ) -> None:
        """Draw one snapshot."""

    def show_sensors(self, sensed: SensedFrame) -> None:
        """Draw what is new of the shown sensors."""

    def show_messages(self, messages: Mapping[WatchedTopic, msgspec.Struct]) -> None:
        """Show new messages of watched topics."""

    def move_cameras(self) -> None:
        """Move each camera towards the robot that it follows."""

    def end_visits(self) -> list[Order]:
        """End what clients have begun, and return their last orders."""

    def show_disconnected(self) -> None:
        """Show that no server replies."""

    def warn(self, text: str) -> None:
        """Notify all clients."""


class Viewer:
    """Updates a page; call `tick` periodically."""

    def __init__(
        self,
        network: FollowingNetwork,
        page: PageProtocol,
        world: str,
        *,
        clock: MonotonicClock = time.monotonic,
    ) -> None:
        self._network, self._page, self._world, self._clock = network, page, world, clock
        self._fetcher = MeshFetcher(network, world, clock)
        self._calls = WorldCalls(network, world)
        self._data_source: ViewerDataSource | None = None
        self._error_text = ""
        self._state = ""

    def tick(self) -> None:
        """Handle events of clients, and show new data if there are clients."""
        is_watched = self._page.is_watched
        orders = self._page.wait_for_input(POLL_S if is_watched else IDLE_S)
        end_s = self._clock() + MAX_CALLS_S
        for order in orders:
            is_late = self._clock() >= end_s
            if isinstance(order, WorldCall):
                self._make(order, is_late=is_late)
            elif is_late:
                self._page.warn(LATE)
            else:
                self._handle_button(order)
        self._calls.settle()
        if self._page.is_watched:
            self._update(self._data_source or self._open_data_source())
        else:
            self.close()

    def _make(self, call: WorldCall, *, is_late: bool) -> None:
        # A long call has a thread of its own.
        if is_late and not call.timeout_s:
            call.on_error(LATE)
        else:
            self._calls.make(call)

    def end(self) -> None:
        """Request the deletions that clients can no longer undo, and close all subscriptions."""
        calls = [one for one in self._page.end_visits() if isinstance(one, WorldCall)]
        # What else was ordered a moment ago would act on a world that the client no longer sees.
        self._calls.make_last(call for call in calls if call.service is DELETE_ENTITY)
        self.close()

    def close(self) -> None:
        """Close all subscriptions."""
        if self._data_source is not None:
            self._data_source.close()
            self._data_source, self._error_text = None, ""

    def _open_data_source(self) -> ViewerDataSource:
        self._data_source = ViewerDataSource(self._network, self._world, self._clock, self._fetcher)
        return self._data_source

    def _update(self, source: ViewerDataSource) -> None:
        # Sensors and watched topics are drawn with the views.
        is_sensing = bool(self._page.shown_sensors or self._page.watched)
        view = source.newest(is_still_shown=is_sensing)
        if view is not None:
            self._state = view.status.state
            commands = source.commands(self._page.selected)
            self._page.show(view.fleet, view.frame, view.status, commands)
            self._page.show_sensors(source.sense(self._page.shown_sensors, view))
            self._page.show_messages(source.receive(self._page.watched))
        elif source.is_silent:
            self._page.show_disconnected()
        self._page.move_cameras()
        if source.error_text != self._error_text:
            self._error_text = source.error_text
            self._page.warn(source.error_text or "the models of the robots are available again")

    def _handle_button(self, button: HeadOrder) -> None:
        if button == "Play":
            self._set_state(State.PLAYING)
        elif button == "Pause":
            self._set_state(State.PAUSED)
        elif button == "Step":
            if self._state == "playing":
                self._set_state(State.PAUSED)
            self._call(STEP_SIMULATION, StepSimulationRequest(steps=1))
        else:
            self._call(RESET_SIMULATION, ResetSimulationRequest(scope=RESETS[button]))

    def _set_state(self, state: State) -> None:
        self._call(
            SET_SIMULATION_STATE, SetSimulationStateRequest(state=SimulationState(state=state))
        )

    def _call(self, service: Service[Request, Response], request: Request) -> None:
        self._calls.make(WorldCall(service, request, on_error=self._page.warn))
