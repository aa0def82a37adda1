"""Claims by name and by share."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, cast

import pytest

from tests.fakes import MemoryBus, MemoryPendingCall
from tests.robot_agent.fake_server import AGENT, WORLD, FakeServer
from tests.robot_agent.models import a_claim
from zensim.proto import keys
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import (
    Claim,
    ClaimShareRequest,
    ClaimShareResponse,
    make_grants,
)
from zensim.proto.messages.result_messages import ClaimCode, Result, ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import Event, EventKind
from zensim.proto.service_catalog import Request, Response, Service
from zensim.proto.topic_catalog import EVENTS
from zensim.robot_agent.claim_client import (
    MAX_SHARE_PERIOD_S,
    MIN_SHARE_PERIOD_S,
    ClaimSettings,
    NamedClaimClient,
    ShareClaimClient,
    ShareSettings,
)


def make_client(bus: MemoryBus, *entities: str, wait_s: float = 30.0) -> NamedClaimClient:
    bus.token(keys.alive_agent(WORLD, AGENT))
    settings = ClaimSettings(
        world=WORLD, agent=AGENT, entities=entities, on_release="keep", wait_s=wait_s
    )
    return NamedClaimClient(bus, settings)


def granted(client: NamedClaimClient, now_s: float) -> list[str]:
    return [claim.entity for claim in client.poll(now_s)]


def test_client_claims_all_at_once_with_their_release_action() -> None:
    bus = MemoryBus()
    server = FakeServer(bus, "r1", "r2")

    assert granted(make_client(bus, "r1", "r2"), 0.0) == ["r1", "r2"]

    (request,) = server.requests
    assert (request.agent, request.on_release) == (AGENT, "keep")


def test_client_stops_calling_when_it_has_all() -> None:
    bus = MemoryBus()
    server = FakeServer(bus, "r1")
    client = make_client(bus, "r1")
    client.poll(0.0)

    client.poll(100.0)

    assert server.take_requests() == [("r1",)]
    assert not bus.has_subscriber(EVENTS.key(WORLD))


def test_client_backs_off() -> None:
    bus = MemoryBus()
    server = FakeServer(bus)
    client = make_client(bus, "r1")

    asked_at = []
    for i in range(600):
        client.poll(i / 100)
        if server.take_requests():
            asked_at.append(i / 100)

    expected = [0.0, 0.05, 0.15, 0.35, 0.75, 1.55, 2.55, 3.55, 4.55, 5.55]
    assert asked_at == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("kind", ["spawned", "released"])
def test_client_calls_at_once_when_a_missing_entity_appears(kind: str) -> None:
    bus = MemoryBus()
    server = FakeServer(bus)
    client = make_client(bus, "r1")
    client.poll(0.0)
    server.take_requests()

    server.entities |= FakeServer(MemoryBus(), "r1").entities
    server.publish_event("spawned" if kind == "spawned" else "released", "r1")

    assert granted(client, 0.001) == ["r1"]


def test_client_ignores_events_of_others_and_malformed_ones() -> None:
    bus = MemoryBus()
    server = FakeServer(bus)
    client = make_client(bus, "r1")
    client.poll(0.0)
    server.take_requests()

    server.publish_event("spawned", "r2")
    server.publish_event("deleted", "r1")
    bus.put(EVENTS.key(WORLD), b"garbage")
    client.poll(0.001)

    assert server.take_requests() == []


def test_client_calls_at_once_after_retry_soon() -> None:
    bus = MemoryBus()
    server = FakeServer(bus)
    client = make_client(bus, "r1")
    client.poll(0.0)

    client.retry_soon()
    client.poll(0.001)

    assert len(server.requests) == 2


def test_client_waits_while_there_is_no_server() -> None:
    bus = MemoryBus()
    client = make_client(bus, "r1")
    assert granted(client, 0.0) == []

    FakeServer(bus, "r1")

    assert granted(client, 1.0) == ["r1"]


def test_client_waits_while_another_agent_drives_the_entity() -> None:
    bus = MemoryBus()
    server = FakeServer(bus, "r1")
    server.drivers["r1"] = "dying"
    client = make_client(bus, "r1")
    assert granted(client, 0.0) == []

    server.drivers.clear()

    assert granted(client, 1.0) == ["r1"]


def test_client_waits_while_the_server_lacks_its_token() -> None:
    bus = MemoryBus()
    FakeServer(bus, "r1")
    settings = ClaimSettings(
        world=WORLD, agent=AGENT, entities=("r1",), on_release="stop", wait_s=30.0
    )
    client = NamedClaimClient(bus, settings)
    assert granted(client, 0.0) == []

    bus.token(keys.alive_agent(WORLD, AGENT))

    assert granted(client, 1.0) == ["r1"]


def test_client_raises_the_refusal_at_its_deadline() -> None:
    bus = MemoryBus()
    FakeServer(bus)
    client = make_client(bus, "r1", wait_s=2.0)
    client.poll(0.0)
    client.poll(1.9)

    with pytest.raises(ServiceError) as caught:
        client.poll(5.0)

    assert str(caught.value) == "NOT_FOUND (2): entity 'r1' does not exist (waited 2.0 s)"


def test_client_raises_at_once_without_a_wait() -> None:
    with pytest.raises(NoServer):
        make_client(MemoryBus(), "r1", wait_s=0.0).poll(0.0)


def test_client_raises_when_the_server_does_not_reply_until_the_deadline() -> None:
    bus = MemoryBus()
    bus.serve(keys.service(WORLD, "claim_entity"))

    with pytest.raises(TimeoutError, match=r"0\.5 s"):
        make_client(bus, "r1", wait_s=0.0).poll(0.0)


def test_client_raises_at_once_on_a_final_refusal() -> None:
    bus = MemoryBus()
    FakeServer(bus, "r1").refusal = ClaimCode.NOT_DRIVABLE

    with pytest.raises(ServiceError) as refusal:
        make_client(bus, "r1").poll(0.0)

    assert refusal.value.code == ClaimCode.NOT_DRIVABLE


def test_client_raises_when_the_reply_is_malformed() -> None:
    bus = MemoryBus()
    queue = bus.serve(keys.service(WORLD, "claim_entity"))

    def answer() -> None:
        for call in queue.take():
            call.reply(b"garbage", "")

    bus.pumps.append(answer)

    with pytest.raises(MalformedPayload):
        make_client(bus, "r1").poll(0.0)


def test_client_never_raises_after_a_first_claim() -> None:
    bus = MemoryBus()
    server = FakeServer(bus, "r1")
    client = make_client(bus, "r1", wait_s=0.0)
    client.poll(0.0)
    server.entities.clear()
    client.reclaim(("r1",))
    for now_s in (1.0, 100.0, 10_000.0):
        server.refusal = ClaimCode.NOT_DRIVABLE
        assert granted(client, now_s) == []

    server.refusal = None
    server.entities |= FakeServer(MemoryBus(), "r1").entities

    assert granted(client, 10_001.0) == ["r1"]


def test_client_claims_existing_entities_while_others_are_missing() -> None:
    bus = MemoryBus()
    server = FakeServer(bus, "r1", "r2", "r3")
    client = make_client(bus, "r1", "r2", "r3")
    client.poll(0.0)
    del server.entities["r2"]

    client.reclaim(("r1", "r2", "r3"))

    assert granted(client, 1.0) == []
    assert granted(client, 2.0) == ["r1", "r3"]


def test_client_stops_a_round_of_calls_when_the_server_is_gone() -> None:
    bus = MemoryBus()
    server = FakeServer(bus, "r1", "r2")
    client = make_client(bus, "r1", "r2")
    client.poll(0.0)
    server.entities.clear()
    client.reclaim(("r1", "r2"))
    client.poll(1.0)

    bus.pumps.clear()

    assert granted(client, 2.0) == []


def test_client_logs_a_reason_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bus = MemoryBus()
    FakeServer(bus)
    client = make_client(bus, "r1")

    for now_s in (0.0, 1.0, 2.0, 3.0):
        client.poll(now_s)

    (record,) = caplog.messages
    assert record.startswith("waiting agent=a1 reason=")


class FakeShareServer:
    """Answers every request for a share with what it is told to."""

    def __init__(self, bus: MemoryBus) -> None:
        self.requests: list[ClaimShareRequest] = []
        self.ids: list[bytes] = []
        self.loses_replies = False
        self.replies_by_id: dict[bytes, bytes] = {}
        self.grants: list[tuple[Claim, ...]] = []
        self.refusal: int = ResultCode.OK
        self.is_more = False
        self._bus = bus
        self._calls = bus.serve(keys.service(WORLD, "claim_share"))
        bus.pumps.append(self._poll)

    def publish_event(self, kind: EventKind) -> None:
        self._bus.put_message(EVENTS.key(WORLD), Event(kind, "r1"), Format.MSGPACK)

    def take_request_count(self) -> int:
        count = len(self.requests)
        self.requests.clear()
        return count

    def _poll(self) -> None:
        for call in self._calls.take():
            self.requests.append(decode(ClaimShareRequest, call.payload, call.encoding))
            self.ids.append(call.request_id)
            if self.loses_replies:
                self._find_reply(call.request_id)
                call.drop()
            else:
                payload = self._find_reply(call.request_id)
                call.reply(payload, make_encoding(ClaimShareResponse, Format.MSGPACK))

    def _find_reply(self, request_id: bytes) -> bytes:
        """Find the reply to a request as a server does: a repeated one gets the first."""
        if not request_id or request_id not in self.replies_by_id:
            claims = self.grants.pop(0) if self.grants else ()
            result = Result(self.refusal, "no" if self.refusal != ResultCode.OK else "")
            response = ClaimShareResponse(result, *make_grants(claims), is_more=self.is_more)
            self.replies_by_id[request_id] = encode(response, Format.MSGPACK)
        return self.replies_by_id[request_id]


def make_share_client(bus: MemoryBus, wait_s: float = 30.0) -> ShareClaimClient:
    settings = ShareSettings(world=WORLD, agent="p", limit=7, on_release="keep", wait_s=wait_s)
    return ShareClaimClient(bus, settings)


def test_share_client_calls_at_once_with_its_limit() -> None:
    bus = MemoryBus()
    server = FakeShareServer(bus)
    server.grants = [(a_claim(1, "r1"), a_claim(2, "r2"))]

    assert [claim.entity for claim in make_share_client(bus).poll(0.0)] == ["r1", "r2"]

    (request,) = server.requests
    assert (request.agent, request.limit, request.on_release) == ("p", 7, "keep")


def test_share_client_calls_periodically() -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus)

    for i in range(350):
        client.poll(i / 100)

    assert server.take_request_count() == 1 + int(3.49 / MAX_SHARE_PERIOD_S)


@pytest.mark.parametrize("kind", ["spawned", "deleted", "released"])
def test_share_client_calls_once_soon_after_many_changes(kind: EventKind) -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    client.poll(0.0)
    server.take_request_count()
    for _ in range(100):
        server.publish_event(kind)

    client.poll(0.01)
    assert server.take_request_count() == 0
    client.poll(MIN_SHARE_PERIOD_S)
    client.poll(MIN_SHARE_PERIOD_S + 0.01)

    assert server.take_request_count() == 1


def test_share_client_ignores_claims_of_others() -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    client.poll(0.0)
    server.take_request_count()
    server.publish_event("claimed")
    bus.put(EVENTS.key(WORLD), b"garbage")

    client.poll(0.5)

    assert server.take_request_count() == 0


def test_share_client_calls_on_while_there_is_more() -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    server.is_more = True

    for i in range(5):
        client.poll(i / 1000)

    assert server.take_request_count() == 5


def test_share_client_raises_at_its_deadline_without_a_server() -> None:
    client = make_share_client(MemoryBus(), wait_s=1.0)
    for i in range(100):
        client.poll(i / 100)

    with pytest.raises(NoServer, match=r"1\.0 s"):
        client.poll(2.0)


def test_share_client_never_raises_after_a_first_reply() -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus, wait_s=1.0)
    client.poll(0.0)
    server.refusal = ResultCode.INCORRECT_STATE

    for i in range(1000):
        assert client.poll(i / 100) == ()


def test_share_client_raises_at_once_on_a_final_refusal() -> None:
    bus = MemoryBus()
    FakeShareServer(bus).refusal = 102

    with pytest.raises(ServiceError) as refusal:
        make_share_client(bus).poll(0.0)

    assert refusal.value.code == 102


def test_share_client_gets_the_claims_of_a_reply_that_was_lost() -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    server.grants = [(a_claim(1, "r1"),)]
    server.loses_replies = True
    client.poll(0.0)
    server.loses_replies = False

    assert [claim.entity for claim in client.poll(1.0)] == ["r1"]


def test_share_client_makes_a_new_request_after_each_reply_and_refusal() -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    client.poll(0.0)
    server.refusal = ResultCode.INCORRECT_STATE
    client.poll(2.0)
    client.poll(4.0)

    assert len(set(server.ids)) == 3
    assert b"" not in server.ids


def test_share_client_makes_a_new_request_to_a_new_server() -> None:
    bus = MemoryBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    server.loses_replies = True
    client.poll(0.0)

    client.forget_call()
    client.poll(1.0)

    assert len(set(server.ids)) == 2


class PendingCallBus(MemoryBus):
    """Makes calls whose reply comes when it may."""

    def __init__(self) -> None:
        super().__init__()
        self.may_reply = False

    def begin_call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> MemoryPendingCall[Response]:
        made = super().begin_call(
            service, request, world=world, timeout_s=timeout_s, request_id=request_id
        )
        return cast("MemoryPendingCall[Response]", HeldCall(self, made.make))


@dataclass
class HeldCall(Generic[Response]):
    bus: PendingCallBus
    make: Callable[[], Response]

    def poll(self) -> Response | None:
        return self.make() if self.bus.may_reply else None


def test_share_client_does_not_wait_for_the_reply() -> None:
    bus = PendingCallBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    server.grants.append((a_claim(1, "r1"),))

    early = [client.poll(now_s) for now_s in (0.0, 0.5, 2.5)]
    bus.may_reply = True
    late = client.poll(3.0)

    assert early == [(), (), ()]
    assert [claim.entity for claim in late] == ["r1"]
    assert server.take_request_count() == 1


def test_share_client_calls_again_for_a_change_during_a_call() -> None:
    bus = PendingCallBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    client.poll(0.0)
    server.publish_event("spawned")
    client.poll(0.1)
    bus.may_reply = True

    client.poll(0.2)
    client.poll(0.21)

    assert server.take_request_count() == 2


def test_share_client_forgets_a_call_to_a_server_that_is_gone() -> None:
    bus = PendingCallBus()
    server, client = FakeShareServer(bus), make_share_client(bus)
    server.grants.append((a_claim(1, "r1"),))
    client.poll(0.0)

    client.forget_call()
    bus.may_reply = True

    assert client.poll(0.1) == ()
    assert server.take_request_count() == 0
