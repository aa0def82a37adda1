"""Requests: each is decoded, carried out once however often it is repeated, and answered."""

from dataclasses import dataclass

import msgspec

from proto.bus import Call
from proto.catalog import SERVICES, SPAWN_ENTITY
from proto.codec import Format, MalformedPayload, decode, encode, encoding_of, format_of
from proto.keys import service as service_key
from proto.result import ResultCode, SpawnCode
from proto.services import MAX_REQUEST_BYTES
from sim_server.answers import Answer, Answers
from sim_server.desk import Desk
from sim_server.errors import SimError
from sim_server.handlers.table import handle, refusal
from sim_server.later import Later
from sim_server.telemetry import TOPICS, Telemetry


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
        self._pending: list[_Pending] = []

    def take(self, call: Call) -> None:
        """Carry a request out and answer it, or begin to."""
        self._desk.meter.requests += 1
        if call.name in TOPICS:
            self._reply(call, self._telemetry.message(call.name))
        elif (answer := self._answers.known(call)) is not None:
            self._send(call, answer)
        elif not self._joins_pending(call):
            self._carry_out(call)

    def carry_on(self) -> None:
        """Answer what has become ready meanwhile, in the order of asking."""
        if not self._pending:
            return
        for pending in self._pending[:]:
            if pending.later.is_ready():
                self._pending.remove(pending)
                self._reply(pending.call, self._outcome(pending))

    def _joins_pending(self, call: Call) -> bool:
        """Let a retry take the place of a request that is still being carried out."""
        for pending in self._pending:
            if call.request_id and pending.call.request_id == call.request_id:
                pending.call = call
                return True
        return False

    def _carry_out(self, call: Call) -> None:
        try:
            _check_size(call)
            request = decode(_request_type(call.name), call.payload, call.encoding)
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
        try:
            return pending.later.outcome()
        except SimError as error:
            return refusal(pending.call.name, error.code, str(error))

    def _reply(self, call: Call, response: msgspec.Struct) -> None:
        wanted = _reply_format(call)
        try:
            payload = encode(response, wanted)
        except TypeError:
            # A response that CDR cannot express, such as a claim with its model.
            wanted = Format.MSGPACK
            payload = encode(response, wanted)
        answer = Answer(payload, encoding_of(response, wanted))
        self._answers.keep(call, answer)
        self._send(call, answer)

    def _send(self, call: Call, answer: Answer) -> None:
        call.reply(answer.payload, answer.encoding, service_key(self._desk.world.name, call.name))


def _check_size(call: Call) -> None:
    if len(call.payload) > MAX_REQUEST_BYTES:
        raise RequestTooLarge(call.name, len(call.payload))


def _request_type(name: str) -> type[msgspec.Struct]:
    if (service := SERVICES.get(name)) is None:
        raise SimUnknown(name)
    return service.request


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
        return format_of(call.payload, call.encoding)
    except MalformedPayload:
        return Format.JSON if "json" in call.encoding else Format.MSGPACK
