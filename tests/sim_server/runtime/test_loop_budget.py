"""Loop: requests leave most of the time to steps, and none waits for ever."""

from typing import Any

import pytest

from tests.engines import STEP_NS
from tests.fakes import MemoryCall
from tests.sim_server.fakes import InlineParser, ServerFixture, a_server, answer_of
from zensim.proto.messages.entity_messages import GetEntitiesRequest
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    DeleteEntityResponse,
    SpawnEntityOrder,
)
from zensim.proto.network_protocols import MAX_REQUEST_ID_BYTES
from zensim.sim_server.runtime import loop
from zensim.sim_server.runtime.loop import MAX_TURN_REFUSALS, SETTLE_S
from zensim.sim_server.runtime.request_queue import MAX_WAITING

COST_NS = 1_000_000


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> ServerFixture:
    """A running world whose requests take a millisecond each."""
    server = a_server("r0")
    dispatcher = server.loop._dispatcher  # noqa: SLF001
    take = dispatcher.take

    def take_slowly(call: Any) -> None:  # noqa: ANN401
        server.wall.ns += COST_NS
        server.wall.used += COST_NS
        take(call)

    monkeypatch.setattr(dispatcher, "take", take_slowly)
    return server


def refused_slug(call: MemoryCall) -> str:
    response = answer_of(call, DeleteEntityResponse)
    assert isinstance(response, DeleteEntityResponse)
    return response.result.error_message.partition(":")[0]


def test_loop_gives_a_quarter_of_its_time_to_requests(server: ServerFixture) -> None:
    calls = [server.request("get_entities", GetEntitiesRequest()) for _ in range(100)]

    server.turn_for(0.2)

    late_ns = server.wall.ns - server.world.clock.steps * STEP_NS
    assert sum(call.is_over for call in calls) == pytest.approx(0.2e9 / COST_NS / 4, rel=0.1)
    assert server.world.clock.steps == pytest.approx(0.2e9 / STEP_NS, rel=0.02)
    assert late_ns > 0


def test_loop_replies_to_another_client_before_the_rest_of_the_first(server: ServerFixture) -> None:
    first = [server.request("get_entities", GetEntitiesRequest()) for _ in range(100)]
    other = server.request("get_entities", GetEntitiesRequest())
    other.client = "other"

    server.turn_for(0.01)

    assert other.is_over
    assert sum(call.is_over for call in first) <= 3


def test_loop_refuses_what_exceeds_the_bound_of_a_client_at_once(server: ServerFixture) -> None:
    calls = [
        server.request("delete_entity", DeleteEntityRequest("r9")) for _ in range(MAX_WAITING + 1)
    ]

    server.loop.turn()

    assert refused_slug(calls[-1]) == "request.busy"
    assert not calls[-2].is_over


def test_loop_handles_all_while_paused(server: ServerFixture) -> None:
    server.world.clock.pause()
    calls = [server.request("get_entities", GetEntitiesRequest()) for _ in range(100)]

    server.turn_for(0.105)

    assert all(call.is_over for call in calls)


def test_loop_refuses_a_request_id_that_is_too_long() -> None:
    server = a_server("r0")
    call = server.request("delete_entity", DeleteEntityRequest("r0"))
    call.request_id = bytes(MAX_REQUEST_ID_BYTES + 1)
    longest = server.request("delete_entity", DeleteEntityRequest("r9"))
    longest.request_id = bytes(MAX_REQUEST_ID_BYTES)

    server.loop.turn()

    assert refused_slug(call) == "request.id"
    assert refused_slug(longest) != "request.id"


def test_loop_refuses_more_unfinished_requests_of_a_client_than_may_wait() -> None:
    server = a_server("r0")
    server.world.clock.pause()
    provider = server.parts.descriptions.provider
    assert isinstance(provider, InlineParser)
    provider.is_slow = True
    for _ in range(MAX_WAITING):
        server.request("spawn_entity", SpawnEntityOrder(name="r1"))
        server.loop.serve()

    call = server.request("spawn_entity", SpawnEntityOrder(name="r1"))
    server.loop.serve()

    assert refused_slug(call) == "request.busy"


def test_loop_ends_excess_requests_without_a_refusal_when_there_are_many(
    server: ServerFixture,
) -> None:
    excess = MAX_TURN_REFUSALS + 2
    calls = [
        server.request("delete_entity", DeleteEntityRequest("r9"))
        for _ in range(MAX_WAITING + excess)
    ]

    server.loop.turn()

    refused, ended = calls[MAX_WAITING:-2], calls[-2:]
    assert {refused_slug(call) for call in refused} == {"request.busy"}
    assert [(call.is_over, call.answers) for call in ended] == [(True, [])] * 2


def test_loop_refuses_no_more_than_its_share_in_a_second(
    server: ServerFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "MAX_BUSY_REFUSALS", 3)
    server.inbox.backlogged.add("")
    for _ in range(MAX_WAITING):
        server.request("delete_entity", DeleteEntityRequest("r9"))
    refused = 0
    for _ in range(4):
        calls = [server.request("delete_entity", DeleteEntityRequest("r9")) for _ in range(2)]
        server.loop.turn()
        assert all(call.is_over for call in calls)
        refused += sum(bool(call.answers) for call in calls)

    assert refused == 3


def test_loop_does_not_wait_for_replies_when_a_step_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    server = a_server("r0")
    waits: list[float] = []
    monkeypatch.setattr(server.inbox, "settle_replies", waits.append)
    server.wall.ns += STEP_NS

    server.loop.serve()
    server.world.clock.pause()
    server.loop.serve()

    assert waits == [SETTLE_S]


def test_paused_loop_sleeps_while_the_only_waiting_client_does_not_read(
    server: ServerFixture,
) -> None:
    server.world.clock.pause()
    call = server.request("get_entities", GetEntitiesRequest())
    server.inbox.backlogged.add(call.client)
    began_ns = server.wall.ns

    server.loop.turn()

    assert not call.is_over
    assert server.wall.ns > began_ns
    server.inbox.backlogged.clear()
    server.loop.turn()
    assert call.is_over
