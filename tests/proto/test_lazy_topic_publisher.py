"""When a topic is put, and what it answers."""

from tests.fakes import MemoryBus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import String
from zensim.proto.ros2.ros_graph import Topic
from zensim.proto.topic_endpoints import LazyTopicPublisher, TopicFactory

KEY = "r1/robot_description"
ENCODING = "application/cdr;std_msgs/msg/String"


class Value:
    """Counts how often it is made."""

    def __init__(self, message: String | None) -> None:
        self.message = message
        self.made = 0

    def __call__(self) -> String | None:
        self.made += 1
        return self.message


def test_outlet_puts_its_value_when_somebody_listens() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(KEY)
    outlet = LazyTopicPublisher(TopicFactory(bus), Topic(KEY, String), Value(String("hello")))

    outlet.publish()

    (sample,) = listener.take()
    assert sample.encoding == ENCODING
    assert decode(String, sample.payload, sample.encoding) == String("hello")


def test_outlet_puts_bytes_as_they_are() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(KEY)

    LazyTopicPublisher(TopicFactory(bus), Topic(KEY, String), lambda: b"ready").publish()

    (sample,) = listener.take()
    assert (sample.payload, sample.encoding) == (b"ready", ENCODING)


def test_outlet_makes_no_value_when_nobody_listens() -> None:
    value = Value(String("hello"))

    LazyTopicPublisher(TopicFactory(MemoryBus()), Topic(KEY, String), value).publish()

    assert value.made == 0


def test_outlet_puts_nothing_when_there_is_no_value_yet() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(KEY)

    LazyTopicPublisher(TopicFactory(bus), Topic(KEY, String), Value(None)).publish()

    assert listener.take() == []


def test_outlet_announces_once_to_each_first_listener() -> None:
    bus = MemoryBus()
    outlet = LazyTopicPublisher(TopicFactory(bus), Topic(KEY, String), Value(String("hello")))
    outlet.announce()

    listener = bus.subscribe(KEY, 8)
    outlet.announce()
    outlet.announce()
    assert len(listener.take()) == 1

    listener.close()
    outlet.announce()
    later = bus.subscribe(KEY, 8)
    outlet.announce()
    assert len(later.take()) == 1


def test_outlet_answers_a_get_with_its_value() -> None:
    bus = MemoryBus()
    outlet = LazyTopicPublisher(TopicFactory(bus), Topic(KEY, String), Value(String("hello")))
    bus.pumps.append(outlet.answer)

    (sample,) = bus.get("r1/*")

    assert (sample.key, sample.encoding) == (KEY, ENCODING)
    assert decode(String, sample.payload) == String("hello")


def test_outlet_lets_an_asker_go_when_there_is_no_value_yet() -> None:
    bus = MemoryBus()
    outlet = LazyTopicPublisher(TopicFactory(bus), Topic(KEY, String), Value(None))
    bus.pumps.append(outlet.answer)

    assert bus.get(KEY) == []


def test_outlet_answers_nobody_when_it_is_closed() -> None:
    bus = MemoryBus()

    LazyTopicPublisher(TopicFactory(bus), Topic(KEY, String), Value(String("hello"))).close()

    assert not bus.is_served(KEY)
