"""TopicReader: all messages or the newest at a rate, and since when a topic is silent."""

from typing import TYPE_CHECKING, Final

from tests.fakes import ManualClock, MemoryBus
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.standard_messages import String
from zensim.spawner.client.topic_reader import (
    TopicReader,
    WantedTopics,
    keep_raw,
    read_as,
    read_topic,
)

if TYPE_CHECKING:
    from zensim.proto.memory_bus import MemorySubscription

KEY: Final = "r1/text"
DEPTH: Final = 8


class Setup:
    """A reader of texts, and the network on which they are published."""

    def __init__(self) -> None:
        self.bus, self.clock = MemoryBus(), ManualClock()
        self.reader = read_topic(self.bus, KEY, String, DEPTH, clock=self.clock)

    def publish(self, *texts: str) -> None:
        """Publish texts."""
        for text in texts:
            self.bus.put_message(KEY, String(text), Format.CDR)

    def take(self) -> list[str]:
        """Take the texts."""
        return [one.data for one in self.reader.take()]

    def newest(self, period_s: float = 0.0) -> str:
        """Read the newest text; empty if there is none."""
        message = self.reader.newest(period_s)
        return "" if message is None else message.data


def test_all_messages_are_taken_once() -> None:
    setup = Setup()
    setup.publish("a", "b")

    assert (setup.take(), setup.take()) == (["a", "b"], [])


def test_newest_message_replaces_those_before() -> None:
    setup = Setup()
    setup.publish("a", "b")

    assert (setup.newest(), setup.take()) == ("b", [])
    assert setup.reader.last == String("b")


def test_newest_message_waits_until_the_period_is_over() -> None:
    setup = Setup()
    found = []
    for number in range(6):
        setup.publish(str(number))
        found.append(setup.newest(0.2))
        setup.clock.sleep(0.1)

    assert found == ["0", "", "2", "", "4", ""]


def test_message_of_another_type_is_counted_and_keeps_a_topic_silent() -> None:
    setup = Setup()
    setup.publish("a")
    setup.take()
    setup.clock.sleep(2.0)
    setup.bus.put(KEY, b"\0\1\0\0\1", "application/cdr")

    assert setup.take() == []
    assert (setup.reader.malformed, setup.reader.last) == (1, String("a"))
    assert setup.reader.is_silent(1.0)


def test_topic_is_silent_from_its_last_message() -> None:
    setup = Setup()
    setup.clock.sleep(0.9)
    was_silent = setup.reader.is_silent(1.0)
    setup.publish("a")
    setup.newest()
    setup.clock.sleep(0.9)

    assert (was_silent, setup.reader.is_silent(1.0)) == (False, False)
    setup.clock.sleep(0.2)
    assert setup.reader.is_silent(1.0)


def test_messages_known_before_come_first() -> None:
    bus = MemoryBus()
    reader = TopicReader(bus.subscribe(KEY, DEPTH), read_as(String), first=[String("before")])
    bus.put_message(KEY, String("after"))

    assert [one.data for one in reader.take()] == ["before", "after"]
    assert reader.take() == []


def test_raw_message_keeps_its_key() -> None:
    bus = MemoryBus()
    reader = TopicReader(bus.subscribe("*/text", DEPTH), keep_raw)
    bus.put(KEY, b"bytes")

    assert [(one.key, one.payload) for one in reader.take()] == [(KEY, b"bytes")]
    reader.close()
    assert not bus.subscribed_keys


def test_exactly_the_wanted_topics_are_subscribed() -> None:
    bus = MemoryBus()
    topics: WantedTopics[str, MemorySubscription] = WantedTopics(bus.subscribe)
    topics.follow({"r1": "r1/odom", "r2": "r2/odom"})
    first = dict(topics)

    topics.follow({"r1": "r1/odom", "r2": "other/odom", "r3": "r3/odom"})

    assert bus.subscribed_keys == ["r1/odom", "other/odom", "r3/odom"]
    assert dict(topics)["r1"] is first["r1"]
    topics.close()
    assert not bus.subscribed_keys
