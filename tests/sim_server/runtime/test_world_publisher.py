"""BusOutlet: telemetry on its keys, in MessagePack, only when it is wanted."""

import pytest

from tests.fakes import MemoryBus, MemoryPublisher
from zensim.proto.bus import BusPublisher
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.topic_catalog import DRIVE_STATE, WORLD_TOPICS, TopicSpec
from zensim.sim_server.runtime.world_publisher import BusWorldPublisher

TOPIC_NAMES = [topic.name for topic in WORLD_TOPICS]
STATE = DriveState(1, 2, 3, b"", b"", b"", b"")


class CountingBus(MemoryBus):
    """A memory bus that knows which publishers are open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        self.open.append(key)
        publisher = super().advertise(key, encoding)
        publisher.close = lambda: self.open.remove(key)  # type: ignore[method-assign]
        return publisher


def an_outlet(bus: MemoryBus) -> BusWorldPublisher:
    return BusWorldPublisher(bus, "w")


@pytest.mark.parametrize("topic", WORLD_TOPICS, ids=TOPIC_NAMES)
def test_publisher_publishes_each_world_topic_on_its_key(topic: TopicSpec) -> None:
    message = make_sample_message(topic.messages[0])
    bus = MemoryBus()
    listener = bus.subscribe(f"sim/w/{topic.suffix}")

    an_outlet(bus).publish(topic, message)

    (sample,) = listener.take()
    assert sample.encoding == "application/msgpack"
    assert decode(type(message), sample.payload, sample.encoding) == message


@pytest.mark.parametrize("topic", WORLD_TOPICS, ids=TOPIC_NAMES)
def test_publisher_is_wanted_when_a_topic_is_subscribed(topic: TopicSpec) -> None:
    bus = MemoryBus()
    outlet = an_outlet(bus)
    before = outlet.is_wanted(topic)

    bus.subscribe(f"sim/*/{topic.suffix}")

    assert (before, outlet.is_wanted(topic)) == (False, True)


def test_outlet_tells_each_agent_on_its_own_key() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(DRIVE_STATE.key("w", "*"), 10)
    outlet = an_outlet(bus)

    for agent in ("a", "b", "a"):
        outlet.publish_drive_state(agent, STATE)

    samples = listener.take()
    assert [sample.key for sample in samples] == [
        DRIVE_STATE.key("w", agent) for agent in ("a", "b", "a")
    ]
    assert decode(DriveState, samples[0].payload) == STATE


def test_outlet_keeps_one_publisher_for_each_agent_until_it_is_forgotten() -> None:
    bus = CountingBus()
    outlet = an_outlet(bus)
    before = len(bus.open)

    for _ in range(3):
        outlet.publish_drive_state("a", STATE)
        outlet.publish_drive_state("b", STATE)
    while_told = len(bus.open)
    outlet.forget_agent("a")
    outlet.forget_agent("nobody")

    assert while_told == before + 2
    assert bus.open[before:] == [DRIVE_STATE.key("w", "b")]


def test_outlet_tells_an_agent_again_that_was_forgotten_and_came_back() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(DRIVE_STATE.key("w", "a"), 10)
    outlet = an_outlet(bus)
    outlet.publish_drive_state("a", STATE)
    outlet.forget_agent("a")

    outlet.publish_drive_state("a", STATE)

    assert len(listener.take()) == 2


def test_outlet_publishes_as_a_publisher_of_the_bus_does() -> None:
    assert {"send", "close", "is_matched"} <= set(dir(BusPublisher)) & set(dir(MemoryPublisher))
