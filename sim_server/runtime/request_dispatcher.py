"""Dispatch of requests: decode, execute once for all retries, and reply when the journal is durable."""

from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import msgspec

from zensim.proto.bus import MAX_REQUEST_BYTES
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    detect_format,
    encode,
    make_encoding,
)
from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.network_protocols import ServiceCall
from zensim.proto.service_catalog import CLAIM_ENTITY, CLAIM_SHARE, SERVICES, SPAWN_ENTITY
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal_protocol import ChangeJournal, JournaledResponse
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.runtime.world_telemetry import GETTABLE_TOPICS, WorldTelemetry
from zensim.sim_server.service_parts import DeferredResponse
from zensim.sim_server.services.service_registry import ServiceHandlers, make_refusal

MAX_CACHED_RESPONSES = 4096
MAX_CACHED_BYTES = 32 << 20
NOT_JOURNALED = frozenset({CLAIM_ENTITY.name, CLAIM_SHARE.name})
"""Services whose answers mean nothing to another server."""


@dataclass(frozen=True)
class CachedResponse:
    """A reply as it was sent."""

    payload: bytes
    encoding: str


class ResponseCache:
    """The newest answers of services that change something."""

    def __init__(self) -> None:
        self._responses: OrderedDict[tuple[str, bytes], CachedResponse] = OrderedDict()
        self._bytes = 0

    def find(self, call: ServiceCall) -> CachedResponse | None:
        """Find the answer that this very request has had."""
        return self._responses.get((call.name, call.request_id)) if call.request_id else None

    def keep(self, call: ServiceCall, answer: CachedResponse) -> tuple[tuple[str, bytes], ...]:
        """Remember an answer; forget the oldest when there are many, and say which."""
        if not call.request_id or not is_mutating(call.name):
            return ()
        self._add((call.name, call.request_id), answer)
        forgotten = []
        while len(self._responses) > MAX_CACHED_RESPONSES or (
            self._bytes > MAX_CACHED_BYTES and len(self._responses) > 1
        ):
            oldest = next(iter(self._responses))
            self._remove(oldest)
            forgotten.append(oldest)
        return tuple(forgotten)

    def forget(self, call: ServiceCall) -> None:
        """Forget an answer: what it told of has been taken back."""
        if (call.name, call.request_id) in self._responses:
            self._remove((call.name, call.request_id))

    def load(self, told: Iterable[JournaledResponse]) -> None:
        """Remember what another server answered, oldest first."""
        for one in told:
            self._add((one.service, one.request_id), CachedResponse(one.payload, one.encoding))

    def _add(self, key: tuple[str, bytes], answer: CachedResponse) -> None:
        if key in self._responses:
            self._remove(key)
        self._responses[key] = answer
        self._bytes += len(answer.payload)

    def _remove(self, key: tuple[str, bytes]) -> None:
        self._bytes -= len(self._responses.pop(key).payload)


def is_mutating(name: str) -> bool:
    """Whether a service changes something."""
    service = SERVICES.get(name)
    return service is not None and service.is_mutating


def make_journaled_response(call: ServiceCall, answer: CachedResponse) -> JournaledResponse | None:
    """Say what a journal keeps of an answer; nothing when no retry could ask for it."""
    if not call.request_id or not is_mutating(call.name) or call.name in NOT_JOURNALED:
        return None
    return JournaledResponse(call.name, call.request_id, answer.payload, answer.encoding)


@dataclass(frozen=True)
class QueuedReply:
    """A reply, and how far the journal must have come for it."""

    call: ServiceCall
    answer: CachedResponse
    position: int


class ReplyQueue:
    """First in, first out."""

    def __init__(self, key_of: Callable[[str], str]) -> None:
        self._key_of = key_of
        self._waiting: deque[QueuedReply] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, waiting: QueuedReply) -> None:
        """Take a reply in."""
        self._waiting.append(waiting)

    def send_durable(self, durable: int) -> None:
        """Send what may be known."""
        while self._waiting and self._waiting[0].position <= durable:
            self.send(self._waiting.popleft())

    def take_unsent(self) -> list[QueuedReply]:
        """Take all that nobody has been told yet."""
        taken, self._waiting = list(self._waiting), deque()
        return taken

    def send(self, waiting: QueuedReply) -> None:
        """Send one at once."""
        call, answer = waiting.call, waiting.answer
        call.reply(answer.payload, answer.encoding, self._key_of(call.name))


JOURNALED_SERVICES = frozenset(
    {
        "spawn_entity",
        "spawn_entities",
        "delete_entity",
        "set_entity_info",
        "load_world",
        "unload_world",
        "reset_simulation",
    }
)
"""Services that wait for a disk that takes nothing, and are refused if it stays so."""


@dataclass
class _PendingRequest:
    """A request that has begun and cannot be answered yet."""

    call: ServiceCall
    deferred: DeferredResponse[Any]


class RequestDispatcher:
    """All that was asked of one world."""

    def __init__(
        self,
        handlers: ServiceHandlers,
        telemetry: WorldTelemetry,
        loop_stats: LoopStats,
        key_of: Callable[[str], str],
        journal: ChangeJournal | None,
    ) -> None:
        self._handlers = handlers
        self._telemetry = telemetry
        self._loop_stats = loop_stats
        self._journal = journal
        self._responses = ResponseCache()
        if journal is not None:
            self._responses.load(journal.earlier_responses)
        self._pending: list[_PendingRequest] = []
        self._parked: list[tuple[ServiceCall, int]] = []
        self._reply_queue = ReplyQueue(key_of)
        self._reason = ""

    @property
    def has_unsent_replies(self) -> bool:
        """Whether a reply has not gone out yet."""
        return len(self._reply_queue) > 0

    def take(self, call: ServiceCall) -> None:
        """Carry a request out and answer it, or begin to."""
        self._loop_stats.requests += 1
        self._take(call)

    def reply_to_ready(self) -> None:
        """Answer what has become ready meanwhile, in the order of asking."""
        for pending in self._pending[:]:
            if pending.deferred.is_ready():
                self._pending.remove(pending)
                self._reply(pending.call, self._outcome(pending))
        self._settle()

    def _take(self, call: ServiceCall) -> None:
        if (topic := GETTABLE_TOPICS.get(call.name)) is not None:
            self._reply(call, self._telemetry.message(topic))
        elif (answer := self._responses.find(call)) is not None:
            self._send(call, answer)
        elif not (self._attach_to_pending(call) or self._defer_until_writable(call)):
            self._execute(call)

    def _attach_to_pending(self, call: ServiceCall) -> bool:
        """Let a retry take the place of a request that is still being carried out."""
        this = (call.name, call.request_id)
        for pending in self._pending:
            if call.request_id and (pending.call.name, pending.call.request_id) == this:
                pending.call = call
                return True
        return False

    def _defer_until_writable(self, call: ServiceCall) -> bool:
        """Put a request off while the disk takes nothing, and see whether it does again."""
        journal = self._journal
        if journal is None or call.name not in JOURNALED_SERVICES or not journal.is_failing:
            return False
        self._parked.append((call, journal.retry()))
        return True

    def _execute(self, call: ServiceCall) -> None:
        self._flush_unrelated_changes()
        try:
            _check_size(call)
            request = call.read(_request_type(call.name))
            response = self._handlers.handle(request)
        except SimError as error:
            response = make_refusal(call.name, error.code, str(error))
        except MalformedPayload as error:
            response = make_refusal(
                call.name, ResultCode.OPERATION_FAILED, f"malformed request: {error}"
            )
        if isinstance(response, DeferredResponse):
            self._pending.append(_PendingRequest(call, response))
        else:
            self._reply(call, response)

    def _outcome(self, pending: _PendingRequest) -> msgspec.Struct:
        self._flush_unrelated_changes()
        try:
            response: msgspec.Struct = pending.deferred.outcome()
        except SimError as error:
            response = make_refusal(pending.call.name, error.code, str(error))
        return response

    def _flush_unrelated_changes(self) -> None:
        """What a request did not do is not taken back with it."""
        if self._journal is not None:
            self._journal.note()

    def _reply(self, call: ServiceCall, response: msgspec.Struct) -> None:
        answer = _encode_response(call, response)
        forgotten = self._responses.keep(call, answer)
        if self._journal is not None:
            is_asked = is_mutating(call.name)
            self._journal.note(make_journaled_response(call, answer), forgotten, is_asked=is_asked)
        self._send(call, answer)

    def _send(self, call: ServiceCall, answer: CachedResponse) -> None:
        journal = self._journal
        position = 0 if journal is None else journal.position
        self._reply_queue.add(QueuedReply(call, answer, position))
        self._reply_queue.send_durable(0 if journal is None else journal.durable)

    def _settle(self) -> None:
        """Let replies go as far as the journal has come; take back what it could not keep."""
        if (journal := self._journal) is None:
            return
        if reason := journal.poll():
            self._reason = reason
            for waiting in self._reply_queue.take_unsent():
                self._answer_again(waiting)
        self._reply_queue.send_durable(journal.durable)
        for call, attempt in self._parked[:]:
            if journal.is_decided(attempt):
                self._parked.remove((call, attempt))
                if journal.is_failing:
                    self._refuse(call)
                else:
                    self._take(call)

    def _answer_again(self, waiting: QueuedReply) -> None:
        call = waiting.call
        if call.name in JOURNALED_SERVICES:
            self._responses.forget(call)
            self._refuse(call)
        elif self._responses.find(call) is not None:
            self._reply_queue.send(waiting)  # what it did stands, and is kept as soon as can be
        else:
            self._take(call)

    def _refuse(self, call: ServiceCall) -> None:
        response = make_refusal(
            call.name,
            ResultCode.OPERATION_FAILED,
            f"the journal could not be written ({self._reason}), so it cannot be kept; "
            "make room on its disk, and try again",
        )
        journal = self._journal
        position = 0 if journal is None else journal.durable
        self._reply_queue.add(QueuedReply(call, _encode_response(call, response), position))


def _encode_response(call: ServiceCall, response: msgspec.Struct) -> CachedResponse:
    wanted = _reply_format(call)
    try:
        payload = encode(response, wanted)
    except TypeError:
        # A response that CDR cannot express, such as a claim with its model.
        wanted = Format.MSGPACK
        payload = encode(response, wanted)
    return CachedResponse(payload, make_encoding(response, wanted))


def _request_type(name: str) -> type[msgspec.Struct]:
    if (service := SERVICES.get(name)) is None:
        raise UnknownService(name)
    return service.request


def _check_size(call: ServiceCall) -> None:
    if call.size > MAX_REQUEST_BYTES:
        raise RequestTooLarge(call.name, call.size)


class RequestTooLarge(SimError):
    """A request that is not even decoded."""

    slug = "request.size"

    def __init__(self, name: str, size: int) -> None:
        super().__init__(
            f"a request of {size} bytes; send {MAX_REQUEST_BYTES} at most, and meshes as files"
        )
        if name == SPAWN_ENTITY.name:
            self.code = SpawnCode.RESOURCE_PARSE_ERROR


class UnknownService(SimError):
    """A service that no server offers."""

    code = ResultCode.FEATURE_UNSUPPORTED

    def __init__(self, name: str) -> None:
        super().__init__(f"service {name[:80]!r} is unknown; there are {', '.join(SERVICES)}")


def _reply_format(call: ServiceCall) -> Format:
    try:
        return detect_format(call.payload, call.encoding)
    except MalformedPayload:
        return Format.JSON if "json" in call.encoding else Format.MSGPACK
