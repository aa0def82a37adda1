"""When a pool asks for its share."""

import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import a_claim
from zensim.proto import keys
from zensim.proto.bus import NoServer
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import (
    Claim,
    ClaimShareRequest,
    ClaimShareResponse,
    make_grants,
)
from zensim.proto.messages.result_messages import Result, ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import Event, EventKind
from zensim.proto.topic_catalog import EVENTS
from zensim.robot_agent.claim_client import (
    MAX_SHARE_PERIOD_S,
    MIN_SHARE_PERIOD_S,
    ShareClaimClient,
    ShareSettings,
)

WORLD = "default"


class Sharer:
    """Answers every request for a share with what it is told to."""

    def __init__(self, bus: MemoryBus) -> None:
        self.requests: list[ClaimShareRequest] = []
        self.grants: list[tuple[Claim, ...]] = []
        self.refusal: int = ResultCode.OK
        self.is_more = False
        self._bus = bus
        self._calls = bus.serve(keys.service(WORLD, "claim_share"))
        bus.pumps.append(self._poll)

    def tell(self, kind: EventKind) -> None:
        self._bus.put_message(EVENTS.key(WORLD), Event(kind, "r1"), Format.MSGPACK)

    def asked(self) -> int:
        count = len(self.requests)
        self.requests.clear()
        return count

    def _poll(self) -> None:
        for call in self._calls.take():
            self.requests.append(decode(ClaimShareRequest, call.payload, call.encoding))
            claims = self.grants.pop(0) if self.grants else ()
            result = Result(self.refusal, "no" if self.refusal != ResultCode.OK else "")
            response = ClaimShareResponse(result, *make_grants(claims), is_more=self.is_more)
            encoding = make_encoding(response, Format.MSGPACK)
            call.reply(encode(response, Format.MSGPACK), encoding)


def a_claimer(bus: MemoryBus, wait_s: float = 30.0) -> ShareClaimClient:
    wish = ShareSettings(world=WORLD, agent="p", limit=7, on_release="keep", wait_s=wait_s)
    return ShareClaimClient(bus, wish)


def test_pool_asks_at_once_with_its_limit() -> None:
    bus = MemoryBus()
    sharer = Sharer(bus)
    sharer.grants = [(a_claim(1, "r1"), a_claim(2, "r2"))]

    assert [claim.entity for claim in a_claimer(bus).poll(0.0)] == ["r1", "r2"]

    (request,) = sharer.requests
    assert (request.agent, request.limit, request.on_release) == ("p", 7, "keep")


def test_pool_asks_now_and_then() -> None:
    bus = MemoryBus()
    sharer, claimer = Sharer(bus), a_claimer(bus)

    for i in range(350):
        claimer.poll(i / 100)

    assert sharer.asked() == 1 + int(3.49 / MAX_SHARE_PERIOD_S)


@pytest.mark.parametrize("kind", ["spawned", "deleted", "released"])
def test_pool_asks_soon_after_a_change_and_once_for_many(kind: EventKind) -> None:
    bus = MemoryBus()
    sharer, claimer = Sharer(bus), a_claimer(bus)
    claimer.poll(0.0)
    sharer.asked()
    for _ in range(100):
        sharer.tell(kind)

    claimer.poll(0.01)
    assert sharer.asked() == 0
    claimer.poll(MIN_SHARE_PERIOD_S)
    claimer.poll(MIN_SHARE_PERIOD_S + 0.01)

    assert sharer.asked() == 1


def test_pool_asks_for_nothing_when_others_claim() -> None:
    bus = MemoryBus()
    sharer, claimer = Sharer(bus), a_claimer(bus)
    claimer.poll(0.0)
    sharer.asked()
    sharer.tell("claimed")
    bus.put(EVENTS.key(WORLD), b"garbage")

    claimer.poll(0.5)

    assert sharer.asked() == 0


def test_pool_asks_on_while_there_is_more() -> None:
    bus = MemoryBus()
    sharer, claimer = Sharer(bus), a_claimer(bus)
    sharer.is_more = True

    for i in range(5):
        claimer.poll(i / 1000)

    assert sharer.asked() == 5


def test_pool_waits_for_a_server_as_long_as_it_was_told_to() -> None:
    claimer = a_claimer(MemoryBus(), wait_s=1.0)
    for i in range(100):
        claimer.poll(i / 100)

    with pytest.raises(NoServer, match=r"waited 1\.0 s"):
        claimer.poll(2.0)


def test_pool_that_has_had_an_answer_waits_for_ever() -> None:
    bus = MemoryBus()
    sharer, claimer = Sharer(bus), a_claimer(bus, wait_s=1.0)
    claimer.poll(0.0)
    sharer.refusal = ResultCode.INCORRECT_STATE

    for i in range(1000):
        assert claimer.poll(i / 100) == ()


def test_pool_gives_up_at_once_when_it_is_refused_for_good() -> None:
    bus = MemoryBus()
    Sharer(bus).refusal = 102

    with pytest.raises(ServiceError, match="no"):
        a_claimer(bus).poll(0.0)
