"""Dispatch of requests: decode, handle once for all retries, reply when the journal is durable."""

import logging
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.json_logs import CONTEXT
from zensim.proto.messages.result_messages import Result, ResultCode, SpawnCode
from zensim.proto.network_protocols import MAX_REQUEST_BYTES, MAX_REQUEST_ID_BYTES, ServiceCall
from zensim.proto.service_catalog import (
    CLAIM_ENTITY,
    CLAIM_SHARE,
    SERVICES,
    SIMULATE_STEPS,
    SPAWN_ENTITY,
    STEP_SIMULATION,
)
from zensim.sim_server.errors import SimError
from zensim.sim_server.input_log.log_writer import InputLog
from zensim.sim_server.journal_protocol import ChangeJournal, JournaledResponse
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.physics.engine import EngineLost, describe_fault
from zensim.sim_server.runtime.request_authorization import RequestAuthorization
from zensim.sim_server.runtime.request_counts import RequestCounts
from zensim.sim_server.runtime.request_queue import MAX_WAITING, RequestBudget, RequestBusy
from zensim.sim_server.runtime.response_encoding import CachedResponse, encode_response
from zensim.sim_server.runtime.world_telemetry import GETTABLE_TOPICS, WorldTelemetry
from zensim.sim_server.service_parts import DeferredResponse
from zensim.sim_server.services.service_registry import ServiceHandlers, make_refusal

LOG = logging.getLogger(__name__)
MAX_CACHED_RESPONSES = 4096
MAX_CACHED_BYTES = 32 << 20
NOT_JOURNALED = frozenset({CLAIM_ENTITY.name, CLAIM_SHARE.name})
"""Services whose responses are useless after a restart."""


class ResponseCache:
    """Newest responses of mutating services, by service and request id."""

    def __init__(self) -> None:
        self._responses: OrderedDict[tuple[str, bytes], CachedResponse] = OrderedDict()
        self._bytes = 0

    def find(self, call: ServiceCall) -> CachedResponse | None:
        """Find the response to an earlier call with the same request id."""
        return self._responses.get((call.name, call.request_id)) if call.request_id else None

    def keep(self, call: ServiceCall, cached: CachedResponse) -> tuple[tuple[str, bytes], ...]:
        """Cache a response; return the keys of the responses that were dropped to make room."""
        if not call.request_id or not is_mutating(call.name):
            return ()
        self._add((call.name, call.request_id), cached)
        forgotten = []
        while len(self._responses) > MAX_CACHED_RESPONSES or (
            self._bytes > MAX_CACHED_BYTES and len(self._responses) > 1
        ):
            oldest = next(iter(self._responses))
            self._remove(oldest)
            forgotten.append(oldest)
        return tuple(forgotten)

    def forget(self, call: ServiceCall) -> None:
        """Drop a response whose changes have been undone."""
        if (call.name, call.request_id) in self._responses:
            self._remove((call.name, call.request_id))

    def load(self, earlier: Iterable[JournaledResponse]) -> None:
        """Cache the responses of an earlier server, oldest first."""
        for one in earlier:
            self._add((one.service, one.request_id), CachedResponse(one.payload, one.encoding))

    def _add(self, key: tuple[str, bytes], cached: CachedResponse) -> None:
        if key in self._responses:
            self._remove(key)
        self._responses[key] = cached
        self._bytes += len(cached.payload)

    def _remove(self, key: tuple[str, bytes]) -> None:
        self._bytes -= len(self._responses.pop(key).payload)


def is_mutating(name: str) -> bool:
    """Whether a service changes the simulation."""
    service = SERVICES.get(name)
    return service is not None and service.is_mutating


def make_journaled_response(call: ServiceCall, cached: CachedResponse) -> JournaledResponse | None:
    """Make the journal's record of a response; None if no retry can use it."""
    if not call.request_id or not is_mutating(call.name) or call.name in NOT_JOURNALED:
        return None
    return JournaledResponse(call.name, call.request_id, cached.payload, cached.encoding)


@dataclass(frozen=True)
class QueuedReply:
    """A response that is sent when the journal is durable up to a position."""

    call: ServiceCall
    cached: CachedResponse
    position: int


class ReplyQueue:
    """Responses in the order in which they are sent."""

    def __init__(self, key_of: Callable[[str, str], str]) -> None:
        self._key_of = key_of
        self._waiting: deque[QueuedReply] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, queued: QueuedReply) -> None:
        """Append a response."""
        self._waiting.append(queued)

    def send_durable(self, durable: int) -> None:
        """Send the responses up to a durable position of the journal."""
        while self._waiting and self._waiting[0].position <= durable:
            self.send(self._waiting.popleft())

    def take_unsent(self) -> list[QueuedReply]:
        """Remove and return all responses."""
        taken, self._waiting = list(self._waiting), deque()
        return taken

    def send(self, queued: QueuedReply) -> None:
        """Send a response now."""
        call, cached = queued.call, queued.cached
        call.reply(cached.payload, cached.encoding, self._key_of(call.name, call.user))


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
"""Services that wait while the journal cannot be written, and are refused if it stays so."""
REFUSED_AT_END = frozenset({*JOURNALED_SERVICES, STEP_SIMULATION.name, SIMULATE_STEPS.name})
"""Services that are refused while the server ends."""


@dataclass
class _PendingRequest:
    """A request whose response is deferred."""

    call: ServiceCall
    deferred: DeferredResponse[Any]
    began_ns: int
    """Wall time at which its handling began."""

    def is_ready(self) -> bool:
        """Whether the response can be made; also if that failed."""
        try:
            return self.deferred.is_ready()
        except EngineLost:
            raise
        except Exception as error:  # noqa: BLE001  the outcome refuses the request
            self.deferred = DeferredResponse(lambda: True, partial(_raise, error))
            return True


def _raise(error: Exception) -> msgspec.Struct:
    raise error


def _refuse_failures(call: ServiceCall, handle: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Handle a request; whatever fails is a refusal, but the loss of the engine."""
    try:
        return handle()
    except SimError as error:
        return make_refusal(call.name, error.code, str(error))
    except MalformedPayload as error:
        return make_refusal(call.name, ResultCode.OPERATION_FAILED, f"malformed request: {error}")
    except EngineLost:
        raise
    except Exception as error:
        LOG.exception("request failed service=%s", call.name)
        return make_refusal(call.name, ResultCode.OPERATION_FAILED, str(HandlerFailed(error)))


class RequestDispatcher:
    """Requests to one world, from receipt to reply."""

    def __init__(
        self,
        handlers: ServiceHandlers,
        telemetry: WorldTelemetry,
        loop_stats: LoopStats,
        key_of: Callable[[str, str], str],
        journal: ChangeJournal | None,
        authorization: RequestAuthorization | None = None,
    ) -> None:
        self.counts = RequestCounts()
        self.is_draining = False
        """Whether the server ends: what it has accepted is finished, and nothing new is changed."""
        self.inputs: InputLog | None = None
        """Notes requests that change the world."""
        self._handlers = handlers
        self._telemetry = telemetry
        self._loop_stats = loop_stats
        self._journal = journal
        self._authorization = authorization
        self._responses = ResponseCache()
        if journal is not None:
            self._responses.load(journal.earlier_responses)
        self._pending: list[_PendingRequest] = []
        self._parked: list[tuple[ServiceCall, int]] = []
        self._reply_queue = ReplyQueue(key_of)
        self._reason = ""

    @property
    def has_open_requests(self) -> bool:
        """Whether a request is not finished, or its reply waits for the journal."""
        return bool(self._pending or self._parked or len(self._reply_queue))

    @property
    def has_unsent_replies(self) -> bool:
        """Whether a reply waits for the journal."""
        return len(self._reply_queue) > 0

    def take(self, call: ServiceCall) -> None:
        """Handle a request; reply now, or when its response is ready and durable."""
        self._loop_stats.requests += 1
        with _logged_with_id(call):
            if len(call.request_id) > MAX_REQUEST_ID_BYTES:
                self.refuse(call, RequestIdTooLong())
            else:
                self._take(call)

    def refuse(self, call: ServiceCall, error: SimError) -> None:
        """Refuse a request now, unread; it has changed nothing."""
        response = make_refusal(call.name, error.code, str(error))
        self._reply_queue.send(QueuedReply(call, encode_response(call, response), 0))

    def reply_to_ready(self, budget: RequestBudget) -> bool:
        """Reply to the pending requests that are ready, in the order of receipt.

        Returns:
            Whether all were looked at; the others wait for the budget of their clients.
        """
        is_complete = True
        for pending in self._pending[:]:
            # To measure 16 waiting ones in each turn took a twentieth of the loop.
            if not pending.deferred.is_due():
                continue
            client = pending.call.client
            if not budget.may_finish(client):
                is_complete = False
                continue
            with budget.charge(client, is_begun=True), _logged_with_id(pending.call):
                if pending.is_ready():
                    self._pending.remove(pending)
                    self._reply(pending.call, self._outcome(pending), pending.began_ns)
        self._settle()
        return is_complete

    def _take(self, call: ServiceCall) -> None:
        if (topic := GETTABLE_TOPICS.get(call.name)) is not None:
            self._execute(call, lambda: self._telemetry.reply(topic))
        elif (cached := self._responses.find(call)) is not None:
            self._send(call, cached)
        elif self._attach_to_pending(call):
            return
        elif self.is_draining and call.name in REFUSED_AT_END:
            # Not kept in the journal: a retry is for the next server.
            self.refuse(call, ServerEnds(call.name))
        elif not self._defer_until_writable(call):
            self._execute(call, lambda: self._handle(call))

    def _attach_to_pending(self, call: ServiceCall) -> bool:
        """Replace the call of a pending request by its retry."""
        this = (call.name, call.request_id)
        for pending in self._pending:
            if call.request_id and (pending.call.name, pending.call.request_id) == this:
                pending.call = call
                return True
        return False

    def _defer_until_writable(self, call: ServiceCall) -> bool:
        """Park a request while the journal cannot be written, and try to write."""
        journal = self._journal
        if journal is None or call.name not in JOURNALED_SERVICES or not journal.is_failing:
            return False
        self._parked.append((call, journal.retry()))
        return True

    def _handle(self, call: ServiceCall) -> msgspec.Struct | DeferredResponse[Any]:
        _check_size(call)
        self._check_pending(call)
        request = call.read(_request_type(call.name))
        if self._authorization is not None:
            self._authorization.check(call, request)
        return self._handlers.handle(request)

    def _check_pending(self, call: ServiceCall) -> None:
        if len(self._pending) < MAX_WAITING:
            return
        if sum(one.call.client == call.client for one in self._pending) >= MAX_WAITING:
            raise RequestBusy(
                f"{MAX_WAITING} requests of this client are not finished, which is the limit; "
                "send more when these have replies"
            )

    def _execute(
        self, call: ServiceCall, handle: Callable[[], msgspec.Struct | DeferredResponse[Any]]
    ) -> None:
        began_ns = time.monotonic_ns()
        self._flush_unrelated_changes()
        response = _refuse_failures(call, handle)
        if isinstance(response, DeferredResponse):
            self._pending.append(_PendingRequest(call, response, began_ns))
        else:
            self._reply(call, response, began_ns)

    def _outcome(self, pending: _PendingRequest) -> msgspec.Struct:
        self._flush_unrelated_changes()
        response: msgspec.Struct = _refuse_failures(pending.call, pending.deferred.outcome)
        return response

    def _flush_unrelated_changes(self) -> None:
        """Flush unrelated changes first, so that a rollback cannot undo them."""
        if self._journal is not None:
            self._journal.record()

    def _reply(self, call: ServiceCall, response: msgspec.Struct, began_ns: int) -> None:
        self.counts.add(call.name, response, time.monotonic_ns() - began_ns)
        if self._authorization is not None:
            response = self._authorization.add_role(call, response)
            self._authorization.note_response(call, response)
        if self.inputs is not None and self.inputs.is_active and is_mutating(call.name):
            _note_request(self.inputs, call, response)
        cached = encode_response(call, response)
        forgotten = self._responses.keep(call, cached)
        if self._journal is not None:
            self._journal.record(
                make_journaled_response(call, cached),
                forgotten,
                is_requested=is_mutating(call.name),
            )
        self._send(call, cached)

    def _send(self, call: ServiceCall, cached: CachedResponse) -> None:
        journal = self._journal
        position = 0 if journal is None else journal.position
        self._reply_queue.add(QueuedReply(call, cached, position))
        self._reply_queue.send_durable(0 if journal is None else journal.durable)

    def _settle(self) -> None:
        """Send durable responses; refuse the requests whose changes were not written."""
        if (journal := self._journal) is None:
            return
        if reason := journal.poll():
            self._reason = reason
            for queued in self._reply_queue.take_unsent():
                self._reply_again(queued)
        self._reply_queue.send_durable(journal.durable)
        for call, attempt in self._parked[:]:
            if journal.is_decided(attempt):
                self._parked.remove((call, attempt))
                with _logged_with_id(call):
                    if journal.is_failing:
                        self._refuse(call)
                    else:
                        self._take(call)

    def _reply_again(self, queued: QueuedReply) -> None:
        call = queued.call
        if call.name in JOURNALED_SERVICES:
            self._responses.forget(call)
            self._refuse(call)
        elif self._responses.find(call) is not None:
            self._reply_queue.send(queued)  # its changes stand and are written later
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
        self._reply_queue.add(QueuedReply(call, encode_response(call, response), position))


@contextmanager
def _logged_with_id(call: ServiceCall) -> Iterator[None]:
    """Give what is logged in the block the id of a request."""
    CONTEXT.request = call.request_id
    try:
        yield
    finally:
        CONTEXT.request = b""


def _note_request(inputs: InputLog, call: ServiceCall, response: msgspec.Struct) -> None:
    """Note a request in the log of inputs; one that could not be read has changed nothing."""
    result = getattr(response, "result", None) or Result()
    with suppress(MalformedPayload):
        request = call.read(_request_type(call.name))
        inputs.note_request(call.name, call.client, request, result.result, result.error_message)


def _request_type(name: str) -> type[msgspec.Struct]:
    if (service := SERVICES.get(name)) is None:
        raise UnknownService(name)
    return service.request


def _check_size(call: ServiceCall) -> None:
    if call.size > MAX_REQUEST_BYTES:
        raise RequestTooLarge(call.name, call.size)


class RequestTooLarge(SimError):
    """The request is too large to be decoded."""

    slug = "request.size"

    def __init__(self, name: str, size: int) -> None:
        super().__init__(
            f"a request of {size} bytes; send {MAX_REQUEST_BYTES} at most, and meshes as files"
        )
        if name == SPAWN_ENTITY.name:
            self.code = SpawnCode.RESOURCE_PARSE_ERROR


class ServerEnds(SimError):
    """The server ends, and accepts no further changes."""

    code = ResultCode.INCORRECT_STATE
    slug = "server.ends"

    def __init__(self, name: str) -> None:
        super().__init__(f"the server ends and accepts no {name}; call the next one")


class RequestIdTooLong(SimError):
    """The request id has too many bytes to be kept."""

    slug = "request.id"

    def __init__(self) -> None:
        super().__init__(f"the request id has more than {MAX_REQUEST_ID_BYTES} bytes; use a UUID")


class HandlerFailed(SimError):
    """A handler failed for no reason that it knows, such as an error of the operating system."""

    slug = "server.fault"

    def __init__(self, error: Exception) -> None:
        super().__init__(f"the server could not do it: {describe_fault(error)}; its log has more")


class UnknownService(SimError):
    """The service does not exist."""

    code = ResultCode.FEATURE_UNSUPPORTED

    def __init__(self, name: str) -> None:
        super().__init__(f"service {name[:80]!r} is unknown; there are {', '.join(SERVICES)}")
