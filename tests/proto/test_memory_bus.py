"""MemoryBus: what a network in one process has beyond any other; see contract/test_network."""

import pytest

from zensim.proto.memory_bus import MemoryBus
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, DeleteEntityResponse
from zensim.proto.service_catalog import DELETE_ENTITY


def test_calls_go_to_the_function_of_the_process() -> None:
    seen: list[object] = []

    def handle(service: object, request: object) -> DeleteEntityResponse:
        seen.append((service, request))
        return DeleteEntityResponse()

    bus, request = MemoryBus(handle), DeleteEntityRequest("r1")
    found = bus.begin_call(DELETE_ENTITY, request, world="w").poll()

    assert found == DeleteEntityResponse()
    assert seen == [(DELETE_ENTITY, request)]


def test_a_call_that_nobody_answers_ends() -> None:
    bus = MemoryBus()
    bus.serve("sim/w/**")

    with pytest.raises(TimeoutError):
        bus.call(DELETE_ENTITY, DeleteEntityRequest("r1"), world="w")


def test_a_request_is_over_when_all_that_serve_its_key_have_replied() -> None:
    bus = MemoryBus()
    queues = [bus.serve("a/*"), bus.serve("a/b")]
    call = bus.query("a/b")

    is_over = []
    for number, queue in enumerate(queues):
        queue.take()[0].reply(bytes([number]), "")
        is_over.append(call.is_over)

    assert is_over == [False, True]
    assert [one.payload for one in call.answers] == [b"\0", b"\1"]
    assert [one.payload for one in call.samples] == [b"\1"]


def test_a_subscription_of_two_networks_hears_both_until_it_is_closed() -> None:
    one, other = MemoryBus(), MemoryBus()
    heard = one.subscribe("a", 9)
    other.add(heard)
    publishers = [bus.advertise("a", "") for bus in (one, other)]

    for publisher in publishers:
        publisher.send(b"x")
    assert len(heard.take()) == 2
    heard.close()

    assert not any(publisher.is_matched for publisher in publishers)


def test_all_subscriptions_and_queues_are_replaced() -> None:
    bus, other = MemoryBus(), MemoryBus()
    heard, queue = other.subscribe("a"), other.serve("q")
    publisher = bus.advertise("a", "")
    bus.subscribe("a").close()

    bus.replace([heard], [queue])
    publisher.send(b"x")

    assert heard.newest() is not None
    assert not bus.query("q").is_over
