"""Asking for entities, over and over."""

import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.stand_in_server import AGENT, WORLD, StandInServer
from zensim.proto import keys
from zensim.proto.bus import NoServer
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.result_messages import ClaimCode, ServiceError
from zensim.proto.topic_catalog import EVENTS
from zensim.robot_agent.claim_client import ClaimSettings, NamedClaimClient


def a_claimer(bus: MemoryBus, *entities: str, wait_s: float = 30.0) -> NamedClaimClient:
    bus.token(keys.alive_agent(WORLD, AGENT))
    wish = ClaimSettings(
        world=WORLD, agent=AGENT, entities=entities, on_release="keep", wait_s=wait_s
    )
    return NamedClaimClient(bus, wish)


def granted(claimer: NamedClaimClient, now_s: float) -> list[str]:
    return [claim.entity for claim in claimer.poll(now_s)]


def test_claimer_asks_for_all_at_once_and_says_what_becomes_of_them() -> None:
    bus = MemoryBus()
    server = StandInServer(bus, "r1", "r2")

    assert granted(a_claimer(bus, "r1", "r2"), 0.0) == ["r1", "r2"]

    (request,) = server.requests
    assert (request.agent, request.on_release) == (AGENT, "keep")


def test_claimer_asks_no_more_when_it_has_all() -> None:
    bus = MemoryBus()
    server = StandInServer(bus, "r1")
    claimer = a_claimer(bus, "r1")
    claimer.poll(0.0)

    claimer.poll(100.0)

    assert server.asked_for() == [("r1",)]
    assert not bus.is_heard(EVENTS.key(WORLD))


def test_claimer_asks_ever_less_often() -> None:
    bus = MemoryBus()
    server = StandInServer(bus)
    claimer = a_claimer(bus, "r1")

    asked_at = []
    for i in range(600):
        claimer.poll(i / 100)
        if server.asked_for():
            asked_at.append(i / 100)

    expected = [0.0, 0.05, 0.15, 0.35, 0.75, 1.55, 2.55, 3.55, 4.55, 5.55]
    assert asked_at == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("kind", ["spawned", "released"])
def test_claimer_asks_at_once_when_what_is_missing_appears(kind: str) -> None:
    bus = MemoryBus()
    server = StandInServer(bus)
    claimer = a_claimer(bus, "r1")
    claimer.poll(0.0)
    server.asked_for()

    server.entities |= StandInServer(MemoryBus(), "r1").entities
    server.tell("spawned" if kind == "spawned" else "released", "r1")

    assert granted(claimer, 0.001) == ["r1"]


def test_claimer_does_not_ask_when_something_else_appears_or_is_garbled() -> None:
    bus = MemoryBus()
    server = StandInServer(bus)
    claimer = a_claimer(bus, "r1")
    claimer.poll(0.0)
    server.asked_for()

    server.tell("spawned", "r2")
    server.tell("deleted", "r1")
    bus.put(EVENTS.key(WORLD), b"garbage")
    claimer.poll(0.001)

    assert server.asked_for() == []


def test_claimer_asks_at_once_when_hurried() -> None:
    bus = MemoryBus()
    server = StandInServer(bus)
    claimer = a_claimer(bus, "r1")
    claimer.poll(0.0)

    claimer.retry_soon()
    claimer.poll(0.001)

    assert len(server.requests) == 2


def test_claimer_waits_while_nobody_serves_the_world() -> None:
    bus = MemoryBus()
    claimer = a_claimer(bus, "r1")
    assert granted(claimer, 0.0) == []

    StandInServer(bus, "r1")

    assert granted(claimer, 1.0) == ["r1"]


def test_claimer_waits_while_another_agent_drives_the_entity() -> None:
    bus = MemoryBus()
    server = StandInServer(bus, "r1")
    server.drivers["r1"] = "dying"
    claimer = a_claimer(bus, "r1")
    assert granted(claimer, 0.0) == []

    server.drivers.clear()

    assert granted(claimer, 1.0) == ["r1"]


def test_claimer_waits_while_the_server_has_not_seen_its_token() -> None:
    bus = MemoryBus()
    StandInServer(bus, "r1")
    wish = ClaimSettings(world=WORLD, agent=AGENT, entities=("r1",), on_release="stop", wait_s=30.0)
    claimer = NamedClaimClient(bus, wish)
    assert granted(claimer, 0.0) == []

    bus.token(keys.alive_agent(WORLD, AGENT))

    assert granted(claimer, 1.0) == ["r1"]


def test_claimer_gives_up_with_the_refusal_when_it_has_waited() -> None:
    bus = MemoryBus()
    StandInServer(bus)
    claimer = a_claimer(bus, "r1", wait_s=2.0)
    claimer.poll(0.0)
    claimer.poll(1.9)

    with pytest.raises(ServiceError) as caught:
        claimer.poll(5.0)

    assert str(caught.value) == "NOT_FOUND (2): entity 'r1' does not exist (waited 2.0 s)"


def test_claimer_gives_up_at_once_when_it_may_not_wait() -> None:
    with pytest.raises(NoServer, match=r"^nothing answers sim/default/claim_entity$"):
        a_claimer(MemoryBus(), "r1", wait_s=0.0).poll(0.0)


def test_claimer_gives_up_when_the_server_is_silent_for_as_long_as_it_waits() -> None:
    bus = MemoryBus()
    bus.serve(keys.service(WORLD, "claim_entity"))

    with pytest.raises(TimeoutError, match=r"within 0.5 s$"):
        a_claimer(bus, "r1", wait_s=0.0).poll(0.0)


def test_claimer_gives_up_at_once_when_waiting_would_not_help() -> None:
    bus = MemoryBus()
    StandInServer(bus, "r1").refusal = ClaimCode.NOT_DRIVABLE

    with pytest.raises(ServiceError, match="NOT_DRIVABLE"):
        a_claimer(bus, "r1").poll(0.0)


def test_claimer_gives_up_when_the_answer_is_none() -> None:
    bus = MemoryBus()
    queue = bus.serve(keys.service(WORLD, "claim_entity"))

    def answer() -> None:
        for call in queue.take():
            call.reply(b"garbage", "")

    bus.pumps.append(answer)

    with pytest.raises(MalformedPayload):
        a_claimer(bus, "r1").poll(0.0)


def test_claimer_never_gives_up_once_it_had_something() -> None:
    bus = MemoryBus()
    server = StandInServer(bus, "r1")
    claimer = a_claimer(bus, "r1", wait_s=0.0)
    claimer.poll(0.0)
    server.entities.clear()
    claimer.reclaim(("r1",))
    for now_s in (1.0, 100.0, 10_000.0):
        server.refusal = ClaimCode.NOT_DRIVABLE
        assert granted(claimer, now_s) == []

    server.refusal = None
    server.entities |= StandInServer(MemoryBus(), "r1").entities

    assert granted(claimer, 10_001.0) == ["r1"]


def test_claimer_takes_those_that_are_there_when_others_stay_away() -> None:
    bus = MemoryBus()
    server = StandInServer(bus, "r1", "r2", "r3")
    claimer = a_claimer(bus, "r1", "r2", "r3")
    claimer.poll(0.0)
    del server.entities["r2"]

    claimer.reclaim(("r1", "r2", "r3"))

    assert granted(claimer, 1.0) == []
    assert granted(claimer, 2.0) == ["r1", "r3"]


def test_claimer_asks_one_by_one_no_further_when_the_server_goes() -> None:
    bus = MemoryBus()
    server = StandInServer(bus, "r1", "r2")
    claimer = a_claimer(bus, "r1", "r2")
    claimer.poll(0.0)
    server.entities.clear()
    claimer.reclaim(("r1", "r2"))
    claimer.poll(1.0)

    bus.pumps.clear()

    assert granted(claimer, 2.0) == []


def test_claimer_says_once_what_it_waits_for(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bus = MemoryBus()
    StandInServer(bus)
    claimer = a_claimer(bus, "r1")

    for now_s in (0.0, 1.0, 2.0, 3.0):
        claimer.poll(now_s)

    (line,) = caplog.messages
    assert line.startswith("waiting agent=a1 reason=")
