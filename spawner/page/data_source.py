"""What the viewer subscribes to and fetches: snapshots, models, velocity commands and meshes."""

from collections.abc import Callable, Iterable
from hashlib import sha256
from typing import Final

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.bus import BusError
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import GetModelsRequest, GetModelsResponse, Snapshot
from zensim.proto.network_protocols import CallingNetwork, Sample, Subscription, ViewerNetwork
from zensim.proto.service_catalog import GET_ASSET, GET_MODELS
from zensim.proto.stl import read_corners, stl_size
from zensim.proto.topic_catalog import CMD_VEL, SNAPSHOT
from zensim.spawner.page.model_visuals import (
    NO_MESHES,
    TriangleMesh,
    TriangleMeshes,
    weld_triangles,
)
from zensim.spawner.page.render_state import (
    LastCommand,
    MismatchedSnapshot,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
    UnknownEntity,
    make_fleet,
    make_frame,
)

MESH_CALL_TIMEOUT_S: Final = 0.8
MESH_RETRY_S: Final = 1.0
MAX_MESH_BYTES: Final = stl_size(60_000)
"""What a server sends at most of one."""
MESH_BUDGET_BYTES: Final = 128 << 20
"""Of all that are drawn; beyond, robots look like their collisions."""


class MeshFetcher:
    """Keeps the meshes that models name; call `fetch` over and over.

    Attributes:
        meshes: By sha256; another mapping whenever all that can be had have come.
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
        self._wanted: dict[str, bytearray] = {}
        self._sizes: dict[str, int] = {}
        self._ask_at = 0.0
        self._found: dict[str, TriangleMesh] = {}
        self.meshes: TriangleMeshes = NO_MESHES

    def want(self, models: Iterable[Model]) -> None:
        """Say whose meshes are needed from now on; what could not be had is asked for again."""
        named = list_visual_meshes(models)
        self._found = {name: mesh for name, mesh in self._found.items() if name in named}
        self._sizes = {name: size for name, size in self._sizes.items() if name in self._found}
        begun = self._wanted
        self._wanted = {
            name: begun.get(name, bytearray()) for name in named if name not in self._found
        }
        self._publish()

    def fetch(self) -> None:
        """Fetch one piece if any is wanted."""
        if not self._wanted or self._clock() < self._ask_at:
            return
        name, data = next(iter(self._wanted.items()))
        try:
            answer = self._network.call(
                GET_ASSET,
                GetAssetRequest(name, len(data)),
                world=self._world,
                timeout_s=MESH_CALL_TIMEOUT_S,
            )
        except ServiceError:
            self._finish(name, None)
            return
        except (BusError, TimeoutError, MalformedPayload):
            self._ask_at = self._clock() + MESH_RETRY_S
            return
        data += answer.data
        if not self._has_room(answer.total) or not answer.data:
            self._finish(name, None)
        elif len(data) >= answer.total:
            self._finish(name, _read_mesh(name, bytes(data)))

    def _has_room(self, total: int) -> bool:
        return total <= MAX_MESH_BYTES and sum(self._sizes.values()) + total <= self._budget_bytes

    def _finish(self, name: str, mesh: TriangleMesh | None) -> None:
        data = self._wanted.pop(name)
        if mesh is not None:
            self._found[name], self._sizes[name] = mesh, len(data)
        self._publish()

    def _publish(self) -> None:
        if not self._wanted and self._found.keys() != self.meshes.keys():
            self.meshes = dict(self._found)


def list_visual_meshes(models: Iterable[Model]) -> dict[str, None]:
    """List the sha256 of all meshes that are drawn, in order."""
    links = (link for model in models for link in model.links)
    shapes = (shape for link in links for shape in link.visuals if shape.kind == "mesh")
    return dict.fromkeys(shape.mesh for shape in shapes)


def _read_mesh(name: str, data: bytes) -> TriangleMesh | None:
    """Read what came; None when it is not what was asked for, or no mesh."""
    if sha256(data).hexdigest() != name:
        return None
    try:
        corners = read_corners(data)
    except ValueError:
        return None
    return weld_triangles(corners) if len(corners) and bool(np.isfinite(corners).all()) else None


CALL_TIMEOUT_S: Final = 0.8
"""Short, so that Ctrl-C is heeded within a second."""
MIN_FRAME_PERIOD_S: Final = 0.025
"""Least time between two frames: of 30 a second none is left out, of more every other."""
MODELS_RETRY_S: Final = 0.2
SERVER_TIMEOUT_S: Final = 3.0
"""A server sends snapshots at 2 Hz even when paused."""

MonotonicClock = Callable[[], float]
_FleetInputs = tuple[tuple[str, ...], GetModelsResponse, TriangleMeshes]
"""What a fleet is arranged from."""


class ViewState(msgspec.Struct, frozen=True, eq=False):
    """Everything to be shown at one step."""

    fleet: RenderedFleet
    frame: RenderedFrame
    status: SimulationStatus


class CommandMonitor:
    """Hears what one robot is told."""

    def __init__(self, samples: Subscription) -> None:
        self._samples = samples
        self._told: tuple[float, float] | None = None
        self._told_at = 0.0

    def last(self, now: float) -> LastCommand | None:
        """Tell the last command that made sense, if any."""
        sample = self._samples.newest()
        if sample is not None:
            self._receive(sample, now)
        return LastCommand(*self._told, age_s=now - self._told_at) if self._told else None

    def close(self) -> None:
        """Stop listening."""
        self._samples.close()

    def _receive(self, sample: Sample, now: float) -> None:
        try:
            twist = decode_twist(sample.payload, sample.encoding)
        except MalformedPayload:
            return
        self._told, self._told_at = (twist.linear.x, twist.angular.z), now


class ViewerDataSource:
    """One subscription to a world, from the moment when somebody looks until nobody does."""

    def __init__(
        self, network: ViewerNetwork, world: str, clock: MonotonicClock, fetcher: MeshFetcher
    ) -> None:
        self._network, self._world, self._clock = network, world, clock
        self._fetcher = fetcher
        self._tokens = network.watch_tokens(keys.alive_server(world))
        self._snapshots = network.subscribe(SNAPSHOT.key(world))
        self._models: GetModelsResponse | None = None
        self._ask_at = self._frame_at = clock()
        self._heard_at = clock()
        self._fleet = RenderedFleet()
        self._arranged_from: _FleetInputs | None = None
        self._ears: dict[str, CommandMonitor] = {}
        self.error_text = ""
        """Why the last answer about models was none; empty when all is well."""

    @property
    def is_silent(self) -> bool:
        """Whether the server seems to be gone."""
        return self._clock() - self._heard_at > SERVER_TIMEOUT_S

    def close(self) -> None:
        """Stop listening."""
        self._tokens.close()
        self._snapshots.close()
        for ear in self._ears.values():
            ear.close()

    def newest(self) -> ViewState | None:
        """Take the newest snapshot that can be drawn, if one has come and it is time for it."""
        self._watch_server()
        if not self.is_silent:
            self._fetcher.fetch()
        if self._clock() < self._frame_at:
            return None
        sample = self._snapshots.newest()
        if sample is None:
            return None
        self._heard_at = self._clock()
        self._frame_at = self._heard_at + MIN_FRAME_PERIOD_S
        try:
            snapshot = decode(Snapshot, sample.payload, sample.encoding)
            return self._view(snapshot)
        except (MalformedPayload, UnknownEntity, MismatchedSnapshot):
            return None

    def commands(self, entities: frozenset[str]) -> dict[str, LastCommand]:
        """Listen to these entities and no others; tell what each was told last."""
        wanted = {e: m.namespace for e, m in self._fleet.members.items() if e in entities}
        for gone in self._ears.keys() - wanted.keys():
            self._ears.pop(gone).close()
        for entity in wanted.keys() - self._ears.keys():
            samples = self._network.subscribe(CMD_VEL.key(wanted[entity]))
            self._ears[entity] = CommandMonitor(samples)
        now = self._clock()
        heard = {entity: ear.last(now) for entity, ear in self._ears.items()}
        return {entity: command for entity, command in heard.items() if command is not None}

    def _watch_server(self) -> None:
        for _, is_alive in self._tokens.take():
            if is_alive:
                self._models = None
                self._heard_at = self._clock()
            else:
                self._heard_at = float("-inf")

    def _view(self, snapshot: Snapshot) -> ViewState | None:
        if self._models is None or snapshot.roster != self._models.roster:
            self._request_models()
        if self._models is None:
            return None
        source = (snapshot.names, self._models, self._fetcher.meshes)
        if source != self._arranged_from:
            self._fleet = make_fleet(*source)
            self._arranged_from = source
        status = SimulationStatus(
            state=snapshot.state,
            sim_time_s=snapshot.time_ns / 1e9,
            real_time_factor=snapshot.real_time_factor,
            robots=len(self._fleet.robots),
            entities=len(snapshot.names),
        )
        return ViewState(self._fleet, make_frame(self._fleet, snapshot), status)

    def _request_models(self) -> None:
        if self._clock() < self._ask_at:
            return
        try:
            self._models = self._network.call(
                GET_MODELS, GetModelsRequest(), world=self._world, timeout_s=CALL_TIMEOUT_S
            )
            self._fetcher.want(self._models.models)
            self.error_text = ""
        except (BusError, ServiceError, TimeoutError, MalformedPayload) as error:
            self.error_text = f"the models of the robots are missing: {error}"
        self._ask_at = self._clock() + MODELS_RETRY_S
