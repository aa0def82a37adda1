"""A server without physics: grants claims, sends states and events, keeps commands."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tests.fakes import MemoryBus, MemoryToken
from tests.robot_agent.models import a_claim, two_wheeler
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import (
    ClaimEntityRequest,
    ClaimEntityResponse,
    DriveCommand,
    DriveState,
    make_grants,
)
from zensim.proto.messages.result_messages import ClaimCode, Result, ResultCode
from zensim.proto.messages.telemetry_messages import Event, EventKind
from zensim.proto.topic_catalog import DRIVE_COMMAND, DRIVE_STATE, EVENTS

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Model

WORLD = "default"
AGENT = "a1"


class FakeServer:
    """Entities and their agents."""

    def __init__(self, bus: MemoryBus, *entities: str) -> None:
        self.entities: dict[str, Model] = {name: two_wheeler() for name in entities}
        self.drivers: dict[str, str] = {}
        self.requests: list[ClaimEntityRequest] = []
        self.refusal: ClaimCode | None = None
        self._bus = bus
        self._next_claim = 1
        self._calls = bus.serve(keys.service(WORLD, "claim_entity"))
        self._commands = bus.subscribe(DRIVE_COMMAND.key(WORLD, "*"), 64)
        self._token: MemoryToken | None = None
        bus.pumps.append(self.poll)

    def come_up(self) -> None:
        self._token = self._bus.token(keys.alive_server(WORLD))

    def go_down(self) -> None:
        self.drivers.clear()
        if self._token is not None:
            self._token.close()

    def poll(self) -> None:
        for call in self._calls.take():
            request = decode(ClaimEntityRequest, call.payload, call.encoding)
            self.requests.append(request)
            response = self._answer(request)
            encoding = make_encoding(response, Format.MSGPACK)
            call.reply(encode(response, Format.MSGPACK), encoding)

    def send(self, state: DriveState, agent: str = AGENT) -> None:
        self._bus.put_message(DRIVE_STATE.key(WORLD, agent), state, Format.MSGPACK)

    def publish_event(self, kind: EventKind, entity: str) -> None:
        self._bus.put_message(EVENTS.key(WORLD), Event(kind, entity), Format.MSGPACK)

    def commands(self) -> list[DriveCommand]:
        return [
            decode(DriveCommand, sample.payload, sample.encoding)
            for sample in self._commands.take()
        ]

    def take_requests(self) -> list[Sequence[str]]:
        queried: list[Sequence[str]] = [request.entities for request in self.requests]
        self.requests.clear()
        return queried

    def _answer(self, request: ClaimEntityRequest) -> ClaimEntityResponse:
        if not self._bus.list_tokens(keys.alive_agent(WORLD, request.agent)):
            return refused(ResultCode.INCORRECT_STATE, "no token")
        if self.refusal is not None:
            return refused(self.refusal, "refused")
        for entity in request.entities:
            if entity not in self.entities:
                return refused(ResultCode.NOT_FOUND, f"entity '{entity}' does not exist")
            if self.drivers.get(entity, request.agent) != request.agent:
                return refused(ClaimCode.ALREADY_CLAIMED, f"entity '{entity}' is driven")
        claims = [
            a_claim(self._grant(entity, request.agent), entity, self.entities[entity])
            for entity in request.entities
        ]
        return ClaimEntityResponse(Result(), *make_grants(claims))

    def _grant(self, entity: str, agent: str) -> int:
        self.drivers[entity] = agent
        self._next_claim += 1
        return self._next_claim - 1


def refused(code: int, message: str) -> ClaimEntityResponse:
    return ClaimEntityResponse(Result(code, message))
