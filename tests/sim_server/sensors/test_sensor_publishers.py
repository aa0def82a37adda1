"""Topics of the sensors of many robots."""

from tests.fakes import MemoryBus
from zensim.proto.memory_bus import MemoryPublisher
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import NO_ROS
from zensim.proto.subscriber_search import (
    MAX_PUBLISHERS,
    MAX_PUBLISHERS_AMONG_MANY,
    SubscriberWatches,
)
from zensim.proto.topic_catalog import SCAN
from zensim.sim_server.sensors.sensor_publishers import SensorAddress, SensorTopics

POLLS = 40
"""Enough for a search among a few hundred robots."""


class DeclaringBus(MemoryBus):
    """Keeps the keys of the declared publishers."""

    def __init__(self) -> None:
        super().__init__()
        self.declared: list[str] = []

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        self.declared.append(key)
        return super().advertise(key, encoding)


def make_addresses(count: int) -> list[SensorAddress]:
    return [SensorAddress(SCAN, f"r{number}/scan", f"r{number}") for number in range(count)]


def test_sensors_of_many_robots_declare_no_publishers_and_reach_their_subscribers() -> None:
    bus = DeclaringBus()
    topics = SensorTopics(bus, RosGraph(bus, NO_ROS), SubscriberWatches(bus))
    addresses = make_addresses(MAX_PUBLISHERS + 1)
    received = bus.subscribe("r7/scan", 8)

    topics.set_addresses(addresses, addresses)
    for _ in range(POLLS):
        topics.poll()
    topics.put(addresses[7:9], [b"7", b"8"])

    assert "*/scan" in bus.declared
    assert not {address.key for address in addresses} & set(bus.declared)
    assert [topics.has_subscribers(address) for address in addresses[7:9]] == [True, False]
    assert [sample.payload for sample in received.take()] == [b"7"]
    topics.close()


def test_sensors_of_some_of_many_robots_declare_no_publishers() -> None:
    bus = DeclaringBus()
    watches = SubscriberWatches(bus)
    topics = SensorTopics(bus, RosGraph(bus, NO_ROS), watches)
    addresses = make_addresses(MAX_PUBLISHERS_AMONG_MANY + 1)
    received = bus.subscribe("*/scan", 8)

    watches.set_world_robots(MAX_PUBLISHERS + 1)
    topics.set_addresses(addresses, addresses)
    for _ in range(POLLS):
        topics.poll()
    topics.put(addresses[:1], [b"0"])

    assert not {address.key for address in addresses} & set(bus.declared)
    assert [sample.payload for sample in received.take()] == [b"0"]
    topics.close()


def test_sensors_of_few_robots_declare_their_publishers_once_there_is_a_subscriber() -> None:
    bus = DeclaringBus()
    topics = SensorTopics(bus, RosGraph(bus, NO_ROS), SubscriberWatches(bus))
    addresses = make_addresses(3)

    topics.set_addresses(addresses, addresses)
    before = set(bus.declared)
    bus.subscribe("r1/scan", 8)
    topics.poll()

    assert set(bus.declared) - before == {"r0/scan", "r1/scan", "r2/scan"}
    topics.close()
