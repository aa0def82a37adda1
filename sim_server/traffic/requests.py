"""Requests: each is decoded, carried out once however often it is repeated, and answered.

With a journal a reply leaves once all that it could tell is on the disk.
"""

from dataclasses import dataclass

import msgspec

from zensim.proto.bus import MAX_REQUEST_BYTES
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    detect_format,
    encode,
    make_encoding,
)
from zensim.proto.keys import service as service_key
from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.service_catalog import SERVICES, SPAWN_ENTITY
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import SimError
from zensim.sim_server.handlers.table import handle, refusal
from zensim.sim_server.later import Later
from zensim.sim_server.traffic.answers import Answer, Answers, is_mutating, told
from zensim.sim_server.traffic.calls import Call
from zensim.sim_server.traffic.replies import Replies, Waiting
from zensim.sim_server.traffic.telemetry import TOPICS, Telemetry

LASTING = frozenset(
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
class _Pending:
    """A request that has begun and cannot be answered yet."""

    call: Call
    later: Later


class Requests:
    """All that was asked of one world."""

    def __init__(self, desk: Desk, telemetry: Telemetry) -> None:
        self._desk = desk
        self._telemetry = telemetry
        self._answers = Answers()
        self._answers.load(desk.told)
        self._pending: list[_Pending] = []
        self._parked: list[tuple[Call, int]] = []
        self._replies = Replies(lambda name: service_key(desk.world.name, name))
        self._reason = ""

    @property
    def has_replies(self) -> bool:
        """Whether a reply has not gone out yet."""
        return len(self._replies) > 0

    def take(self, call: Call) -> None:
        """Carry a request out and answer it, or begin to."""
        self._desk.meter.requests += 1
        self._take(call)

    def carry_on(self) -> None:
        """Answer what has become ready meanwhile, in the order of asking."""
        for pending in self._pending[:]:
            if pending.later.is_ready():
                self._pending.remove(pending)
                self._reply(pending.call, self._outcome(pending))
        self._settle()

    def _take(self, call: Call) -> None:
        if call.name in TOPICS:
            self._reply(call, self._telemetry.message(call.name))
        elif (answer := self._answers.known(call)) is not None:
            self._send(call, answer)
        elif not (self._joins_pending(call) or self._is_parked(call)):
            self._carry_out(call)

    def _joins_pending(self, call: Call) -> bool:
        """Let a retry take the place of a request that is still being carried out."""
        this = (call.name, call.request_id)
        for pending in self._pending:
            if call.request_id and (pending.call.name, pending.call.request_id) == this:
                pending.call = call
                return True
        return False

    def _is_parked(self, call: Call) -> bool:
        """Put a request off while the disk takes nothing, and see whether it does again."""
        journal = self._desk.journal
        if journal is None or call.name not in LASTING or not journal.is_failing:
            return False
        self._parked.append((call, journal.retry()))
        return True

    def _carry_out(self, call: Call) -> None:
        self._note_the_unasked()
        try:
            _check_size(call)
            request = call.read(_request_type(call.name))
            response = handle(self._desk, request)
        except SimError as error:
            response = refusal(call.name, error.code, str(error))
        except MalformedPayload as error:
            response = refusal(
                call.name, ResultCode.OPERATION_FAILED, f"malformed request: {error}"
            )
        if isinstance(response, Later):
            self._pending.append(_Pending(call, response))
        else:
            self._reply(call, response)

    def _outcome(self, pending: _Pending) -> msgspec.Struct:
        self._note_the_unasked()
        try:
            return pending.later.outcome()
        except SimError as error:
            return refusal(pending.call.name, error.code, str(error))

    def _note_the_unasked(self) -> None:
        """What a request did not do is not taken back with it."""
        if self._desk.journal is not None:
            self._desk.journal.note()

    def _reply(self, call: Call, response: msgspec.Struct) -> None:
        answer = _encoded(call, response)
        forgotten = self._answers.keep(call, answer)
        if self._desk.journal is not None:
            is_asked = is_mutating(call.name)
            self._desk.journal.note(told(call, answer), forgotten, is_asked=is_asked)
        self._send(call, answer)

    def _send(self, call: Call, answer: Answer) -> None:
        journal = self._desk.journal
        position = 0 if journal is None else journal.position
        self._replies.add(Waiting(call, answer, position))
        self._replies.let_go(0 if journal is None else journal.durable)

    def _settle(self) -> None:
        """Let replies go as far as the journal has come; take back what it could not keep."""
        if (journal := self._desk.journal) is None:
            return
        if reason := journal.poll():
            self._reason = reason
            for waiting in self._replies.take_back():
                self._answer_anew(waiting)
        self._replies.let_go(journal.durable)
        for call, attempt in self._parked[:]:
            if journal.is_decided(attempt):
                self._parked.remove((call, attempt))
                if journal.is_failing:
                    self._refuse(call)
                else:
                    self._take(call)

    def _answer_anew(self, waiting: Waiting) -> None:
        call = waiting.call
        if call.name in LASTING:
            self._answers.forget(call)
            self._refuse(call)
        elif self._answers.known(call) is not None:
            self._replies.send(waiting)  # what it did stands, and is kept as soon as can be
        else:
            self._take(call)

    def _refuse(self, call: Call) -> None:
        response = refusal(
            call.name,
            ResultCode.OPERATION_FAILED,
            f"the journal could not be written ({self._reason}), so it cannot be kept; "
            "make room on its disk, and try again",
        )
        journal = self._desk.journal
        position = 0 if journal is None else journal.durable
        self._replies.add(Waiting(call, _encoded(call, response), position))


def _encoded(call: Call, response: msgspec.Struct) -> Answer:
    wanted = _reply_format(call)
    try:
        payload = encode(response, wanted)
    except TypeError:
        # A response that CDR cannot express, such as a claim with its model.
        wanted = Format.MSGPACK
        payload = encode(response, wanted)
    return Answer(payload, make_encoding(response, wanted))


def _request_type(name: str) -> type[msgspec.Struct]:
    if (service := SERVICES.get(name)) is None:
        raise SimUnknown(name)
    return service.request


def _check_size(call: Call) -> None:
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


class SimUnknown(SimError):
    """A service that no server offers."""

    code = ResultCode.FEATURE_UNSUPPORTED

    def __init__(self, name: str) -> None:
        super().__init__(f"service {name[:80]!r} is unknown; there are {', '.join(SERVICES)}")


def _reply_format(call: Call) -> Format:
    try:
        return detect_format(call.payload, call.encoding)
    except MalformedPayload:
        return Format.JSON if "json" in call.encoding else Format.MSGPACK
