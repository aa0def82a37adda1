"""What the viewer asks of the network while somebody looks: snapshots, models, commands."""

from collections.abc import Callable
from typing import Final, Protocol

import msgspec

from zensim.proto import keys
from zensim.proto.bus import BusError, Sample
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import GetModelsRequest, GetModelsResponse, Snapshot
from zensim.proto.service_catalog import GET_MODELS, Request, Response, Service
from zensim.spawner.viewer.fetching import MeshFetcher
from zensim.spawner.viewer.scene import (
    Fleet,
    Frame,
    LastCommand,
    MismatchedSnapshot,
    Status,
    UnknownEntity,
    arrange,
    draw,
)
from zensim.spawner.viewer.triangles import Meshes

CALL_TIMEOUT_S: Final = 0.8
"""Short, so that Ctrl-C is heeded within a second."""
FRAME_S: Final = 0.025
"""Least time between two frames: of 30 a second none is left out, of more every other."""
ASK_AGAIN_S: Final = 0.2
SILENCE_S: Final = 3.0
"""A server sends snapshots at 2 Hz even when paused."""

Clock = Callable[[], float]
_Source = tuple[tuple[str, ...], GetModelsResponse, Meshes]
"""What a fleet is arranged from."""


class Samples(Protocol):
    """A subscription."""

    def newest(self) -> Sample | None:
        """Take all and keep the last."""

    def close(self) -> None:
        """Stop listening."""


class Tokens(Protocol):
    """Comings and goings of tokens."""

    def take(self) -> list[tuple[str, bool]]:
        """Take all changes."""

    def close(self) -> None:
        """Stop watching."""


class Network(Protocol):
    """What the viewer needs of a bus."""

    def subscribe(self, key: str) -> Samples:
        """Listen to a key, keeping the newest message."""

    def watch_tokens(self, key: str) -> Tokens:
        """Watch tokens."""

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float,
    ) -> Response:
        """Call a service."""


class View(msgspec.Struct, frozen=True, eq=False):
    """Everything to be shown at one step."""

    fleet: Fleet
    frame: Frame
    status: Status


class Ear:
    """Hears what one robot is told."""

    def __init__(self, samples: Samples) -> None:
        self._samples = samples
        self._told: tuple[float, float] | None = None
        self._told_at = 0.0

    def last(self, now: float) -> LastCommand | None:
        """Tell the last command that made sense, if any."""
        sample = self._samples.newest()
        if sample is not None:
            self._hear(sample, now)
        return LastCommand(*self._told, age_s=now - self._told_at) if self._told else None

    def close(self) -> None:
        """Stop listening."""
        self._samples.close()

    def _hear(self, sample: Sample, now: float) -> None:
        try:
            twist = decode_twist(sample.payload, sample.encoding)
        except MalformedPayload:
            return
        self._told, self._told_at = (twist.linear.x, twist.angular.z), now


class Feed:
    """One subscription to a world, from the moment when somebody looks until nobody does."""

    def __init__(self, network: Network, world: str, clock: Clock, fetcher: MeshFetcher) -> None:
        self._network, self._world, self._clock = network, world, clock
        self._fetcher = fetcher
        self._tokens = network.watch_tokens(keys.alive_server(world))
        self._snapshots = network.subscribe(keys.snapshot(world))
        self._models: GetModelsResponse | None = None
        self._ask_at = self._frame_at = clock()
        self._heard_at = clock()
        self._fleet = Fleet()
        self._arranged_from: _Source | None = None
        self._ears: dict[str, Ear] = {}
        self.trouble = ""
        """Why the last answer about models was none; empty when all is well."""

    @property
    def is_silent(self) -> bool:
        """Whether the server seems to be gone."""
        return self._clock() - self._heard_at > SILENCE_S

    def close(self) -> None:
        """Stop listening."""
        self._tokens.close()
        self._snapshots.close()
        for ear in self._ears.values():
            ear.close()

    def newest(self) -> View | None:
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
        self._frame_at = self._heard_at + FRAME_S
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
            samples = self._network.subscribe(keys.robot(wanted[entity], keys.CMD_VEL))
            self._ears[entity] = Ear(samples)
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

    def _view(self, snapshot: Snapshot) -> View | None:
        if self._models is None or snapshot.roster != self._models.roster:
            self._ask()
        if self._models is None:
            return None
        source = (snapshot.names, self._models, self._fetcher.meshes)
        if source != self._arranged_from:
            self._fleet = arrange(*source)
            self._arranged_from = source
        status = Status(
            state=snapshot.state,
            sim_time_s=snapshot.time_ns / 1e9,
            real_time_factor=snapshot.real_time_factor,
            robots=len(self._fleet.robots),
            entities=len(snapshot.names),
        )
        return View(self._fleet, draw(self._fleet, snapshot), status)

    def _ask(self) -> None:
        if self._clock() < self._ask_at:
            return
        try:
            self._models = self._network.call(
                GET_MODELS, GetModelsRequest(), world=self._world, timeout_s=CALL_TIMEOUT_S
            )
            self._fetcher.want(self._models.models)
            self.trouble = ""
        except (BusError, ServiceError, TimeoutError, MalformedPayload) as error:
            self.trouble = f"the models of the robots are missing: {error}"
        self._ask_at = self._clock() + ASK_AGAIN_S
