"""InputLog: publishes what changes a world while there is a subscriber, or from the start."""

import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from uuid import uuid4

import msgspec

from zensim.proto.messages.input_messages import Inputs, ServiceRequest
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.state_hash import hash_states
from zensim.sim_server.input_log.input_records import (
    FORMAT,
    MAX_MESSAGE_BYTES,
    AnyRecord,
    EngineRecipe,
    LogEnd,
    LoggedRoster,
    LogStart,
    Origin,
    PresentBody,
    RecordedState,
    StateSummer,
    StateSums,
    StoredMesh,
    find_versions,
    write_records,
)
from zensim.sim_server.parser_process.description_cache import list_collision_meshes
from zensim.sim_server.physics.engine import BodyStates
from zensim.sim_server.physics.engine_calls import UsedModel, write_floats
from zensim.sim_server.physics.engine_config import choose_engine, find_installed_engines
from zensim.sim_server.physics.engine_factory import limit_cores
from zensim.sim_server.physics.logged_engine import LoggedEngine
from zensim.sim_server.service_parts import ServerParts
from zensim.sim_server.world.entity import Entity, EntityIndex

LOG = logging.getLogger(__name__)
PERIOD_NS = 50_000_000
"""Wall time between messages, and between checks for subscribers."""
MAX_KEPT_BYTES = 64 << 20
"""Bytes of records and requests that wait for the first subscriber, or for those that subscribe."""
MAX_BURST_BYTES = 2 << 20
"""Bytes of records published in a period: the network drops what exceeds its queues."""
MAX_TEXT_BYTES = 64 << 10
"""Bytes of a request or refusal; the rest is cut, as records have all that a request did."""
REQUEST_BYTES = 256
"""Approximate bytes of the other fields of a request."""
FILE_SERVICES = frozenset({"put_asset"})
"""Services whose requests have the bytes of files."""


class InputLog:
    """The log of one world.

    Without a subscriber the engine has no layer for it, and nothing is logged.
    """

    def __init__(
        self, parts: ServerParts, is_wanted: Callable[[], bool], publish: Callable[[Inputs], None]
    ) -> None:
        """Begin at once if the world was made with a logged engine.

        Args:
            parts: Of the server.
            is_wanted: Whether there is a subscriber.
            publish: Publishes a message.
        """
        self._parts, self._world = parts, parts.world
        self._is_wanted, self._publish = is_wanted, publish
        self._engine: LoggedEngine | None = None
        """The engine that is logged; None while nothing is."""
        self._waiting: deque[Inputs] = deque()
        self._waiting_bytes = 0
        self._start_bytes: int | None = None
        """Bytes of the first messages of the log, which have all bodies; None before them."""
        self._is_kept = False
        """Whether messages since the start wait for the first subscriber."""
        self._name, self._sequence, self._epoch = "", 0, 0
        self._records: list[AnyRecord] = []
        self._requests: list[ServiceRequest] = []
        self._stored: set[str] = set()
        self._index: EntityIndex | None = None
        self._frozen: tuple[str, ...] = ()
        self._summer: StateSummer | None = None
        self._second = -1
        self._due_ns = 0
        if isinstance(self._world.engine, LoggedEngine):
            self._is_kept = True
            self._begin()

    @property
    def is_active(self) -> bool:
        """Whether inputs are logged."""
        return self._engine is not None

    def poll(self, now_ns: int) -> None:
        """Begin or end the log with its subscribers; publish what was logged."""
        is_reset = self.is_active and self._epoch != self._world.clock.epoch
        if now_ns < self._due_ns and not is_reset:
            return
        self._due_ns = now_ns + PERIOD_NS
        is_wanted = self._is_wanted()
        self._is_kept &= not is_wanted
        if is_wanted and not self.is_active:
            self._begin()
        elif not is_wanted and self.is_active and not self._is_kept:
            self._end()
        if self.is_active:
            self._follow_world()
            self._flush()
            self._publish_waiting(MAX_BURST_BYTES)
        elif isinstance(engine := self._world.engine, LoggedEngine):
            self._world.engine = engine.inner  # of a world that was loaded

    def note_request(
        self, service: str, client: str, request: msgspec.Struct, code: int, message: str
    ) -> None:
        """Note a request that changed the world, or was refused."""
        if self.is_active:  # a request that ends an epoch is noted in the next, as its step is
            self._follow_world()
        step = self._world.clock.steps
        self._requests.append(make_noted_request(step, service, client, request, code, message))

    def note_control_step(self) -> None:
        """Note the states after a control step."""
        states = self._world.states()  # may freeze entities
        self._follow_world()
        self._take_calls()
        self._follow_roster()
        if self._summer is None:
            return
        clock = self._world.clock
        self._records.append(StateSums(clock.steps, self._summer.sum(states).tobytes()))
        if (second := clock.time_ns // NANOSECONDS) != self._second:
            self._second = second
            self._records.append(self._record_state(states))

    def close(self) -> None:
        """Publish what was logged, with the end of the log, if there has been a subscriber."""
        if self.is_active:
            self._finish()
            self._publish_waiting(MAX_KEPT_BYTES)

    def _begin(self) -> None:
        """Begin a log: with an engine that has no bodies yet, or with those of this moment."""
        self._name, self._sequence = uuid4().hex, 0
        self._records, self._requests = [], []
        self._start_bytes = None
        if isinstance(engine := self._world.engine, LoggedEngine):
            self._follow_engine(engine)
            return
        self._engine = self._world.engine = LoggedEngine(engine)
        self._note_present()

    def _finish(self) -> None:
        """Make messages of what was logged, with the end of the log."""
        self._take_calls()
        self._records.append(LogEnd())
        self._flush()

    def _end(self) -> None:
        if self._engine is not None and self._world.engine is self._engine:
            self._world.engine = self._engine.inner
        self._engine = None
        self._waiting.clear()
        self._waiting_bytes = 0

    def _follow_world(self) -> None:
        """Note that a world was loaded or reset: readers may begin there, too.

        Messages have records of one epoch, as a recorder keeps those of each in a file.
        """
        engine = self._world.engine
        is_same = engine is self._engine
        if is_same and self._epoch == self._world.clock.epoch:
            return
        self._due_ns = 0  # what was before is published before the clock
        if not isinstance(engine, LoggedEngine):
            self._finish()
            self._begin()
            return
        self._flush()
        if not self.is_active:  # too much waited: the next poll begins anew
            return
        if is_same:
            self._note_present()
        else:
            self._follow_engine(engine)

    def _follow_engine(self, engine: LoggedEngine) -> None:
        """Note an engine that was logged from its first call on."""
        self._engine = engine
        self._note_start("fresh", self._world.clock.steps - engine.steps)
        self._take_calls()

    def _note_present(self) -> None:
        """Note the bodies of this moment."""
        engine, entities = self._engine, self._world.entities
        assert engine is not None
        engine.note_again()
        self._note_start("bodies", self._world.clock.steps)
        bodies = [self._make_present(engine, entity, is_hidden=False) for entity in entities] + [
            self._make_present(engine, entity, is_hidden=True) for entity in entities.staged
        ]
        self._take_calls()  # the models
        self._records += bodies

    def _make_present(
        self, engine: LoggedEngine, entity: Entity, *, is_hidden: bool
    ) -> PresentBody:
        states = engine.read((entity.body,))
        return PresentBody(
            entity.body,
            engine.number_of(entity.model),
            write_floats(states.base[0]),
            write_floats(states.joint_positions),
            write_floats(states.joint_velocities),
            is_hidden,
        )

    def _note_start(self, origin: Origin, step: int) -> None:
        world, current = self._world, self._parts.current_world
        options = current.physics
        name = choose_engine(options, find_installed_engines())
        options = msgspec.structs.replace(options, engine=name, cores=limit_cores(options))
        recipe = EngineRecipe(
            options,
            world.control_steps,
            world.clock.step_ns,
            current.model.gravity,
            current.model.ground_plane,
            current.model.ground_friction,
        )
        self._epoch, self._index, self._second = world.clock.epoch, None, -1
        self._stored.clear()
        self._records.append(
            LogStart(FORMAT, find_versions(name), recipe, origin, world.name, self._epoch, step)
        )

    def _take_calls(self) -> None:
        if self._engine is None:
            return
        for call in self._engine.take_calls():
            if isinstance(call, UsedModel):
                self._records += self._read_meshes(list_collision_meshes(call.model))
            self._records.append(call)

    def _read_meshes(self, names: Iterable[str]) -> list[StoredMesh]:
        """Read the files of a model that the log does not have."""
        folder = Path(self._parts.store.folder)
        found = []
        for name in sorted(set(names) - self._stored):
            self._stored.add(name)
            found += [StoredMesh(file.name, file.read_bytes()) for file in folder.glob(f"{name}*")]
        return found

    def _follow_roster(self) -> None:
        index, names = self._world.entities.index, self._world.divergence_guard.frozen
        if index is self._index and names == self._frozen:
            return
        self._index, self._frozen = index, names
        frozen = tuple(index.row[name] for name in names if name in index.row)
        counts = index.joint_count.copy()
        self._summer = StateSummer(counts, frozen)
        self._records.append(
            LoggedRoster(index.names, index.bodies, tuple(counts.tolist()), frozen)
        )

    def _record_state(self, states: BodyStates) -> RecordedState:
        clock, names = self._world.clock, self._world.entities.index.names
        base, positions = write_floats(states.base), write_floats(states.joint_positions)
        digest = hash_states(clock.time_ns, names, base, positions)
        return RecordedState(
            clock.epoch,
            clock.steps,
            clock.time_ns,
            digest,
            base,
            positions,
            write_floats(states.joint_velocities),
        )

    def _flush(self) -> None:
        """Make messages of the records."""
        self._take_calls()
        records, self._records = self._records, []
        requests, self._requests = self._requests, []
        clock, before = self._world.clock, self._waiting_bytes
        # Apart from records: both together may exceed the greatest message.
        contents: list[tuple[tuple[ServiceRequest, ...], bytes]] = [
            *((part, b"") for part in split_requests(requests)),
            *(((), part) for part in write_records(records)),
        ]
        for part, data in contents:
            message = Inputs(self._name, self._sequence, self._epoch, clock.steps, part, data)
            self._sequence += 1
            self._waiting.append(message)
            self._waiting_bytes += measure_message(message)
        if self._start_bytes is None:
            self._start_bytes = self._waiting_bytes - before
        self._limit_waiting()

    def _limit_waiting(self) -> None:
        """Drop the log if too much waits; with subscribers a new one begins at the next poll."""
        if self._is_kept and self._waiting_bytes > MAX_KEPT_BYTES:
            LOG.warning("input log dropped: no subscriber within %d bytes", MAX_KEPT_BYTES)
            self._is_kept = False
            self._end()
        elif self._waiting_bytes > MAX_KEPT_BYTES + (self._start_bytes or 0):
            LOG.warning("input log begins anew: it grows faster than it is published")
            self._end()

    def _publish_waiting(self, most_bytes: int) -> None:
        """Publish messages of some bytes, at least one, unless they wait for a subscriber."""
        published = 0
        while self._waiting and not self._is_kept and published < most_bytes:
            message = self._waiting.popleft()
            published += measure_message(message)
            self._publish(message)
        self._waiting_bytes -= published


def make_noted_request(
    step: int, service: str, client: str, request: msgspec.Struct, code: int, message: str
) -> ServiceRequest:
    """Make the note of a request that changed the world, or was refused."""
    text = "" if service in FILE_SERVICES else cut_text(msgspec.json.encode(request))
    refusal = "" if code == ResultCode.OK else cut_text(message.encode())
    return ServiceRequest(step, service, client, text, code, refusal)


def cut_text(text: bytes) -> str:
    """Decode the first `MAX_TEXT_BYTES` of a text."""
    return text[:MAX_TEXT_BYTES].decode(errors="ignore")


def measure_request(request: ServiceRequest) -> int:
    """Count the bytes of a request, about: characters of other scripts have more."""
    return REQUEST_BYTES + len(request.request) + len(request.message) + len(request.client)


def measure_message(message: Inputs) -> int:
    """Count the bytes of a message, about."""
    return len(message.records) + sum(map(measure_request, message.requests))


def split_requests(requests: Iterable[ServiceRequest]) -> Iterator[tuple[ServiceRequest, ...]]:
    """Split requests into parts of about `MAX_MESSAGE_BYTES` at most."""
    part: list[ServiceRequest] = []
    size = 0
    for request in requests:
        more = measure_request(request)
        if part and size + more > MAX_MESSAGE_BYTES:
            yield tuple(part)
            part, size = [], 0
        part.append(request)
        size += more
    if part:
        yield tuple(part)
