"""StepTopics takes published requests of steps, and publishes the responses."""

import pytest

from tests.fakes import MemoryBus
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, encode, make_encoding
from zensim.proto.messages.simulation_messages import SimulateStepsRequest
from zensim.sim_server.runtime.step_topics import MAX_CLIENTS, PublishedCall, StepTopics

ENCODING = make_encoding(SimulateStepsRequest, Format.MSGPACK)


def publish(bus: MemoryBus, client: str, request: SimulateStepsRequest) -> None:
    publisher = bus.advertise(keys.requested_steps("w", client), ENCODING)
    publisher.send(encode(request, Format.MSGPACK), b"id-1")


def take_one(topics: StepTopics) -> PublishedCall:
    (call,) = topics.take()
    return call


def test_request_is_read_and_its_response_has_the_same_id() -> None:
    bus = MemoryBus()
    topics = StepTopics(bus, "w")
    replies = bus.subscribe(keys.made_steps("w", "c1"), 4)

    publish(bus, "c1", SimulateStepsRequest(3, client="c1"))
    call = take_one(topics)

    assert (call.name, call.request_id) == ("simulate_steps", b"id-1")
    assert call.read(SimulateStepsRequest).steps == 3
    call.reply(b"done", "")
    (sample,) = replies.take()
    assert (sample.payload, sample.attachment) == (b"done", b"id-1")
    assert topics.take() == []


def test_request_in_the_name_of_another_client_is_malformed() -> None:
    bus = MemoryBus()
    topics = StepTopics(bus, "w")

    publish(bus, "c1", SimulateStepsRequest(3, client="c2"))

    with pytest.raises(MalformedPayload):
        take_one(topics).read(SimulateStepsRequest)


def test_publishers_of_many_clients_are_closed() -> None:
    bus = MemoryBus()
    topics = StepTopics(bus, "w")

    found = [topics.find_publisher(f"c{number}") for number in range(MAX_CLIENTS + 2)]

    assert topics.find_publisher(f"c{MAX_CLIENTS + 1}") is found[-1]
    assert topics.find_publisher("c0") is not found[0]
