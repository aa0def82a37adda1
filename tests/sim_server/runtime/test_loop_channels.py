"""BusInbox takes each input once; BusWorldPublisher publishes topics that have subscribers."""

import pytest

from tests.fakes import MemoryBus, MemoryCall
from zensim.proto import keys
from zensim.proto.bus.bus_session import BusPublisher
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.memory_bus import MemoryPublisher
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.network_protocols import ServiceCall
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.topic_catalog import CLOCK, DRIVE_COMMAND, DRIVE_STATE, WORLD_TOPICS, TopicSpec
from zensim.proto.topic_endpoints import make_topic_factory
from zensim.sim_server.runtime.loop_channels import COMMAND_DEPTH, BusInbox, BusWorldPublisher


class NonBlockingBus(MemoryBus):
    """A memory bus whose callers do not wait for the reply."""

    def put_call(self, key: str) -> None:
        for queue in self.queues:
            queue.calls.append(MemoryCall(key, b"", "", b""))


def an_inbox(bus: MemoryBus) -> BusInbox:
    return BusInbox(bus, "w")


def names_of(calls: list[ServiceCall]) -> list[str]:
    return [call.name for call in calls]


def test_inbox_takes_requests_in_order_and_once() -> None:
    bus = NonBlockingBus()
    inbox = an_inbox(bus)

    bus.put_call("sim/w/info")
    bus.put_call("sim/w/get_entities")

    assert names_of(inbox.take_calls()) == ["info", "get_entities"]
    assert inbox.take_calls() == []


def test_inbox_serves_every_service_of_its_world_only() -> None:
    bus = MemoryBus()

    an_inbox(bus)

    assert bus.is_served(keys.service("w", "anything"))
    assert not bus.is_served(keys.service("other", "info"))
    assert not bus.is_served(DRIVE_STATE.key("w", "a"))


def test_inbox_takes_commands_of_all_agents_in_order_and_once() -> None:
    bus = MemoryBus()
    inbox = an_inbox(bus)

    bus.put(DRIVE_COMMAND.key("w", "a"), b"1")
    bus.put(DRIVE_COMMAND.key("w", "b"), b"2")
    bus.put(DRIVE_COMMAND.key("other", "a"), b"3")

    assert [sample.payload for sample in inbox.take_commands()] == [b"1", b"2"]
    assert inbox.take_commands() == []


def test_inbox_keeps_the_newest_commands_when_they_are_not_taken() -> None:
    bus = MemoryBus()
    inbox = an_inbox(bus)

    for i in range(COMMAND_DEPTH + 3):
        bus.put(DRIVE_COMMAND.key("w", "a"), str(i).encode())

    commands = inbox.take_commands()
    assert len(commands) == COMMAND_DEPTH
    assert commands[-1].payload == str(COMMAND_DEPTH + 2).encode()


def test_inbox_reports_agents_that_appear_and_disappear() -> None:
    bus = MemoryBus()
    inbox = an_inbox(bus)

    first = bus.token(keys.alive_agent("w", "a"))
    bus.token(keys.alive_agent("w", "b"))
    first.close()

    assert inbox.take_agents() == [("a", True), ("b", True), ("a", False)]
    assert inbox.take_agents() == []


def test_inbox_reports_agents_that_were_alive_before_the_server() -> None:
    bus = MemoryBus()
    bus.token(keys.alive_agent("w", "a"))
    bus.token(keys.alive_server("w"))

    assert an_inbox(bus).take_agents() == [("a", True)]


TOPIC_NAMES = [topic.name for topic in WORLD_TOPICS]
STATE = DriveState(1, 2, 3, b"", b"", b"", b"")


class CountingBus(MemoryBus):
    """A memory bus that counts its open publishers."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        self.open.append(key)
        publisher = super().advertise(key, encoding)
        publisher.close = lambda: self.open.remove(key)  # type: ignore[method-assign]
        return publisher


def make_publisher(bus: MemoryBus) -> BusWorldPublisher:
    return BusWorldPublisher(bus, "w")


@pytest.mark.parametrize("topic", WORLD_TOPICS, ids=TOPIC_NAMES)
def test_publisher_publishes_each_world_topic_on_its_key(topic: TopicSpec) -> None:
    message = make_sample_message(topic.messages[0])
    bus = MemoryBus()
    listener = bus.subscribe(f"sim/w/{topic.suffix}")

    make_publisher(bus).publish(topic, message)

    (sample,) = listener.take()
    assert sample.encoding == "application/msgpack"
    assert decode(type(message), sample.payload, sample.encoding) == message


def test_publisher_publishes_root_topics_of_ros_2_in_cdr() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings())
    publisher = BusWorldPublisher(bus, "w", make_topic_factory(bus, graph, "", "server"))
    subscription = bus.subscribe(graph.data_key(CLOCK.root()))
    message = make_sample_message(CLOCK.messages[0])

    publisher.publish(CLOCK, message)

    (sample,) = subscription.take()
    assert sample.payload == encode(message, Format.CDR)


@pytest.mark.parametrize("topic", WORLD_TOPICS, ids=TOPIC_NAMES)
def test_publisher_is_wanted_when_a_topic_is_subscribed(topic: TopicSpec) -> None:
    bus = MemoryBus()
    publisher = make_publisher(bus)
    before = publisher.is_wanted(topic)

    bus.subscribe(f"sim/*/{topic.suffix}")

    assert (before, publisher.is_wanted(topic)) == (False, True)


def test_publisher_publishes_drive_states_on_the_key_of_each_agent() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(DRIVE_STATE.key("w", "*"), 10)
    publisher = make_publisher(bus)

    for agent in ("a", "b", "a"):
        publisher.publish_drive_state(agent, STATE)

    samples = listener.take()
    assert [sample.key for sample in samples] == [
        DRIVE_STATE.key("w", agent) for agent in ("a", "b", "a")
    ]
    assert decode(DriveState, samples[0].payload) == STATE


def test_publisher_declares_one_publisher_for_each_agent_until_it_is_forgotten() -> None:
    bus = CountingBus()
    publisher = make_publisher(bus)
    before = len(bus.open)

    for _ in range(3):
        publisher.publish_drive_state("a", STATE)
        publisher.publish_drive_state("b", STATE)
    declared = len(bus.open)
    publisher.forget_agent("a")
    publisher.forget_agent("unknown")

    assert declared == before + 2
    assert bus.open[before:] == [DRIVE_STATE.key("w", "b")]


def test_publisher_publishes_again_for_an_agent_that_returns() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(DRIVE_STATE.key("w", "a"), 10)
    publisher = make_publisher(bus)
    publisher.publish_drive_state("a", STATE)
    publisher.forget_agent("a")

    publisher.publish_drive_state("a", STATE)

    assert len(listener.take()) == 2


def test_memory_publisher_has_the_methods_of_the_bus_publisher() -> None:
    assert {"send", "close", "is_matched"} <= set(dir(BusPublisher)) & set(dir(MemoryPublisher))
