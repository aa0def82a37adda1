"""One topic of many robots on plain and ROS 2 keys."""

from collections.abc import Iterable
from dataclasses import dataclass

import pytest

from tests.fakes import ManualClock, MemoryBus
from zensim.proto.codec import cdr
from zensim.proto.fleet_topics.attachment_rows import AttachmentRows
from zensim.proto.fleet_topics.fleet_publisher import FleetTopicPublisher
from zensim.proto.fleet_topics.matched_publishers import MAX_CHECKED_AT_ONCE, MatchedPublishers
from zensim.proto.fleet_topics.ros_fleet_publisher import (
    MAX_ANNOUNCED_CACHES,
    MAX_ROS_DECLARED_AT_ONCE,
    RosFleetPublisher,
)
from zensim.proto.fleet_topics.topic_members import NAMED, OTHERS, TopicMember
from zensim.proto.memory_bus import MemoryPublisher, MemorySubscriberWatch
from zensim.proto.messages.standard_messages import Range, String
from zensim.proto.network_protocols import Stamp
from zensim.proto.ros2 import ros_graph
from zensim.proto.ros2.liveliness_tokens import parse_endpoint_token
from zensim.proto.ros2.qos_profiles import LATCHED, RELIABLE_5, RELIABLE_10
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, RosTopic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.subscriber_search import MAX_PUBLISHERS, SEARCH_PERIOD_S, SubscriberWatches
from zensim.proto.topic_endpoints import REPEAT_AFTER_S

GID = bytes(range(16))


def test_attachments_of_many_are_those_of_each() -> None:
    gids = [bytes([number]) * 16 for number in range(5)]
    many = AttachmentRows()
    rows = [many.add(gid) for gid in gids]

    written = [many.write_next(rows, 7), many.write_next(rows[3:1:-1], 8), many.write_next(rows, 9)]

    assert written == [
        [write_attachment(Attachment(1, 7, gid)) for gid in gids],
        [write_attachment(Attachment(2, 8, gid)) for gid in gids[3:1:-1]],
        [
            write_attachment(Attachment(number, 9, gid))
            for number, gid in zip((2, 2, 3, 3, 2), gids, strict=True)
        ],
    ]


def test_attachments_of_a_reused_row_start_again() -> None:
    many = AttachmentRows()
    row = many.add(GID)
    many.write_next([row], 1)

    many.remove(row)
    others = [many.add(bytes(16)), many.add(GID)]

    assert many.write_next(others, 2) == [
        write_attachment(Attachment(1, 2, gid)) for gid in (bytes(16), GID)
    ]


def an_audience(bus: MemoryBus, count: int) -> MatchedPublishers[int]:
    publishers = MatchedPublishers[int]()
    for number in range(count):
        publishers.add(number, bus.advertise(f"r{number}/odom", ""))
    return publishers


def test_publishers_count_as_matched_until_checked() -> None:
    bus = MemoryBus()
    publishers = an_audience(bus, 3)
    bus.subscribe("r1/odom")

    before = set(publishers.matched)
    publishers.check_some()

    assert (before, set(publishers.matched)) == ({0, 1, 2}, {1})


def test_all_publishers_are_checked_in_each_round() -> None:
    bus = MemoryBus()
    publishers = an_audience(bus, MAX_CHECKED_AT_ONCE + 1)

    publishers.check_some()
    first = set(publishers.matched)
    publishers.check_some()
    second = set(publishers.matched)
    bus.subscribe("r0/odom")
    publishers.check_some()

    assert (first, second, set(publishers.matched)) == ({MAX_CHECKED_AT_ONCE}, set(), {0})


def test_removed_publisher_is_not_matched() -> None:
    bus = MemoryBus()
    publishers = an_audience(bus, MAX_CHECKED_AT_ONCE + 2)
    bus.subscribe("*/odom")
    publishers.check_some()

    publishers.remove(MAX_CHECKED_AT_ONCE)
    publishers.check_some()

    assert set(publishers.matched) == {*range(MAX_CHECKED_AT_ONCE), MAX_CHECKED_AT_ONCE + 1}


class NoValues:
    """No value for any row; see `LastValues`."""

    def payload(self, row: int) -> bytes | None:
        del row
        return None


class CountingBus(MemoryBus):
    """Keeps the keys of all that was published."""

    def __init__(self) -> None:
        super().__init__()
        self.published_keys: list[str] = []

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        publisher = super().advertise(key, encoding)
        send = publisher.send

        def record(payload: bytes, attachment: bytes = b"", stamp: Stamp | None = None) -> None:
            self.published_keys.append(key)
            send(payload, attachment, stamp)

        publisher.send = record  # type: ignore[method-assign]
        return publisher


def make_publisher(bus: MemoryBus, *names: str) -> tuple[FleetTopicPublisher, list[TopicMember]]:
    publisher = FleetTopicPublisher(bus, "*/text", String)
    members = [TopicMember(f"{name}/text", NoValues()) for name in names]
    for member in members:
        publisher.add(member)
    return publisher, members


def test_messages_are_published_for_subscribed_robots_only() -> None:
    bus = CountingBus()
    bus.subscribe("r2/text", 8)
    publisher, members = make_publisher(bus, "r1", "r2", "r3")

    publisher.declare_some()
    publisher.put(members, [b"1"] * 3)
    publisher.declare_some()
    publisher.put(members, [b"2"] * 3)

    assert bus.published_keys == ["r1/text", "r2/text", "r3/text", "r2/text"]


def test_nothing_is_published_after_the_last_unsubscribe() -> None:
    bus = CountingBus()
    received = bus.subscribe("r1/text")
    publisher, members = make_publisher(bus, "r1")

    publisher.declare_some()
    received.close()
    publisher.put(members, [b"1"])

    assert bus.published_keys == []


def test_later_subscriber_receives_messages() -> None:
    bus = CountingBus()
    bus.subscribe("r1/text", 8)
    publisher, members = make_publisher(bus, "r1", "r2")
    publisher.declare_some()
    publisher.put(members, [b"1"] * 2)
    publisher.declare_some()

    late = bus.subscribe("r2/text", 8)
    publisher.put(members, [b"2"] * 2)
    publisher.declare_some()
    publisher.put(members, [b"3"] * 2)

    assert [sample.payload for sample in late.take()] == [b"3"]


KEY = (
    "0/{}/text/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
PUBLISHERS = "@ros2_lv/*/*/*/*/MP/**"


@dataclass
class ConstantValues:
    """One value for every row; see `LastValues`."""

    value: bytes | None = b"fixed"

    def payload(self, row: int) -> bytes | None:
        del row
        return self.value


def a_node(graph: RosGraph, name: str) -> RosNode:
    node = graph.add_node(name, "agent")
    assert node is not None
    return node


def make_ros_publisher(
    bus: MemoryBus, *names: str, is_latched: bool = True, values: ConstantValues | None = None
) -> tuple[RosFleetPublisher, list[TopicMember]]:
    graph = RosGraph(bus, RosSettings())
    publisher = RosFleetPublisher(
        bus, graph, RosTopic("*/text", String, LATCHED if is_latched else RELIABLE_10)
    )
    members = [
        TopicMember(f"{name}/text", values or ConstantValues(), node=a_node(graph, name))
        for name in names
    ]
    for member in members:
        publisher.add(member)
    return publisher, members


def test_endpoints_are_declared_in_parts() -> None:
    bus = MemoryBus()
    publisher, _ = make_ros_publisher(
        bus, *(f"r{number}" for number in range(MAX_ROS_DECLARED_AT_ONCE + 1))
    )

    publisher.declare_some()
    first = len(bus.list_tokens(PUBLISHERS))
    publisher.declare_some()

    assert (first, len(bus.list_tokens(PUBLISHERS))) == (
        MAX_ROS_DECLARED_AT_ONCE,
        MAX_ROS_DECLARED_AT_ONCE + 1,
    )


def test_subscriber_is_found_again_when_nothing_is_published_without_one() -> None:
    bus = MemoryBus()
    publisher = FleetTopicPublisher(bus, "*/text", String)
    member = TopicMember("r1/text", NoValues())
    publisher.add(member)
    bus.subscribe("r2/text")
    publisher.declare_some()
    publisher.put([member], [b"first"])
    publisher.declare_some()
    before = publisher.has_subscribers(member)

    bus.subscribe("r1/text")
    publisher.declare_some()

    assert (before, publisher.has_subscribers(member)) == (False, True)


def test_subscriber_of_one_robot_makes_the_topic_wanted() -> None:
    bus = MemoryBus()
    publisher, _ = make_ros_publisher(bus, "r1", "r2")
    assert not publisher.is_wanted

    bus.subscribe(KEY.format("r2"))

    assert publisher.is_wanted


def test_messages_are_published_once_there_are_subscribers() -> None:
    bus = MemoryBus()
    publisher, members = make_ros_publisher(bus, "r1", "r2", is_latched=False)
    received = bus.subscribe(KEY.format("*"), 8)

    publisher.put(members, [b"early", b"early"])
    publisher.declare_some()
    publisher.declare_some()
    publisher.put(members, [b"1", b"2"])
    publisher.put(members[1:], [b"3"])

    samples = received.take()
    read = [read_attachment(sample.attachment) for sample in samples]
    assert [sample.payload for sample in samples] == [b"1", b"2", b"3"]
    assert [one.sequence_number for one in read if one] == [1, 1, 2]
    assert len({one.gid for one in read if one}) == 2


@pytest.mark.parametrize("has_hashes", [True, False], ids=["iron", "humble"])
def test_range_ends_where_the_distribution_ends_it(*, has_hashes: bool) -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings(has_hashes=has_hashes))
    topic = RosTopic("*/range", Range, RELIABLE_5)
    publisher = RosFleetPublisher(bus, graph, topic)
    member = TopicMember("r1/range", NoValues(), node=a_node(graph, "r1"))
    received = bus.subscribe("0/r1/range/**")
    payload = cdr.encode(Range(range=1.5, variance=0.25))

    publisher.add(member)
    publisher.declare_some()
    publisher.declare_some()
    publisher.put([member], [payload])

    (sample,) = received.take()
    assert sample.payload == (payload if has_hashes else payload[:-4])


def test_earlier_subscriber_gets_the_latched_message() -> None:
    bus = MemoryBus()
    received = bus.subscribe(KEY.format("r1"), 8)
    publisher, _ = make_ros_publisher(bus, "r1")

    for _ in range(3):
        publisher.declare_some()

    assert [sample.payload for sample in received.take()] == [b"fixed"]


def test_latched_message_of_a_robot_is_repeated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, clock = MemoryBus(), ManualClock()
    monkeypatch.setattr("zensim.proto.topic_endpoints.time.monotonic", clock)
    received = bus.subscribe(KEY.format("r1"), 8)
    publisher, _ = make_ros_publisher(bus, "r1")
    for _ in range(3):
        publisher.declare_some()
    (first,) = received.take()

    clock.sleep(REPEAT_AFTER_S)
    for _ in range(3):
        publisher.declare_some()

    assert received.take() == [first]


def test_latched_topics_of_a_hundred_robots_have_tokens_of_their_caches() -> None:
    bus = MemoryBus()
    publisher, _ = make_ros_publisher(
        bus, *(f"r{number}" for number in range(MAX_ANNOUNCED_CACHES + 1))
    )
    bus.pumps.append(publisher.reply_to_queries)

    for _ in range(MAX_ANNOUNCED_CACHES):
        publisher.declare_some()

    found = bus.list_tokens(f"{KEY.format('*')}/@adv/pub/*/uhlc/_")
    assert len(found) == MAX_ANNOUNCED_CACHES
    assert [answer.key for answer in bus.get(found[1])] == [found[1].partition("/@adv/")[0]]


@pytest.mark.parametrize(("queried", "count"), [("r1", 1), ("*", 2), ("r3", 0)])
def test_late_joiner_gets_the_queried_robots(queried: str, count: int) -> None:
    bus = MemoryBus()
    publisher, _ = make_ros_publisher(bus, "r1", "r2")
    bus.pumps.append(publisher.reply_to_queries)

    answers = bus.get(f"{KEY.format(queried)}/@adv/**")

    assert len(answers) == count
    assert all(read_attachment(answer.attachment) for answer in answers)


def test_late_joiner_gets_nothing_without_a_value() -> None:
    bus = MemoryBus()
    publisher, _ = make_ros_publisher(bus, "r1", values=ConstantValues(None))
    bus.pumps.append(publisher.reply_to_queries)

    assert bus.get(f"{KEY.format('r1')}/@adv/**") == []


def test_removed_robot_is_not_published() -> None:
    bus = MemoryBus()
    publisher, members = make_ros_publisher(bus, "r1", "r2")
    bus.pumps.append(publisher.reply_to_queries)

    publisher.remove(members[0])
    publisher.declare_some()

    assert len(bus.get(f"{KEY.format('*')}/@adv/**")) == 1
    assert len(bus.list_tokens(PUBLISHERS)) == 1


def test_closed_publisher_does_not_reply() -> None:
    bus = MemoryBus()
    publisher, _ = make_ros_publisher(bus, "r1")

    publisher.close()

    assert not bus.is_served(f"{KEY.format('r1')}/@adv/**")


MANY = MAX_PUBLISHERS + 1
POLLS = 100
"""More than a search among them takes."""


class DeclaringBus(CountingBus):
    """Keeps the keys of the declared publishers."""

    def __init__(self) -> None:
        super().__init__()
        self.declared: list[str] = []

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        self.declared.append(key)
        return super().advertise(key, encoding)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> ManualClock:
    found = ManualClock(100.0)
    monkeypatch.setattr("zensim.proto.fleet_topics.topic_members.time.monotonic", found)
    return found


def make_large(bus: MemoryBus, values: ConstantValues | None = None) -> FleetTopicPublisher:
    publisher = FleetTopicPublisher(bus, "*/text", String, watches=SubscriberWatches(bus))
    for number in range(MANY):
        publisher.add(TopicMember(f"r{number}/text", values or ConstantValues()))
    return publisher


def members_of(publisher: FleetTopicPublisher, *names: str) -> list[TopicMember]:
    return [publisher.find_members(f"{name}/text")[0] for name in names]


def search(publisher: FleetTopicPublisher | RosFleetPublisher, clock: ManualClock) -> None:
    clock.sleep(SEARCH_PERIOD_S)
    for _ in range(POLLS):
        publisher.declare_some()


def test_many_robots_declare_no_publisher_and_reach_their_subscribers(clock: ManualClock) -> None:
    bus = DeclaringBus()
    received = bus.subscribe("r7/text", 8)
    publisher = make_large(bus)
    some = members_of(publisher, "r7", "r8")

    search(publisher, clock)
    publisher.put(some, [b"1", b"2"])

    assert bus.declared == ["*/text"]
    assert [sample.payload for sample in received.take()] == [b"1"]
    assert [publisher.list_demand().get(member) for member in some] == [NAMED, None]
    assert [publisher.has_subscribers(member) for member in some] == [True, False]


def test_later_subscriber_of_one_of_many_receives_messages(clock: ManualClock) -> None:
    bus = DeclaringBus()
    bus.subscribe("r7/text", 8)
    publisher = make_large(bus)
    search(publisher, clock)
    version = publisher.version

    late = bus.subscribe("r8/text", 8)
    search(publisher, clock)
    publisher.put(members_of(publisher, "r8"), [b"2"])

    assert publisher.version > version
    assert [sample.payload for sample in late.take()] == [b"2"]


def test_demand_is_listed_once_for_all_groups_until_it_changes(clock: ManualClock) -> None:
    bus = DeclaringBus()
    bus.subscribe("r7/text", 8)
    publisher = make_large(bus)
    search(publisher, clock)
    (one,) = members_of(publisher, "r8")

    first, again = publisher.list_demand(), publisher.list_demand()
    bus.subscribe("r8/text", 8)
    search(publisher, clock)

    assert again is first
    assert (one in first, publisher.list_demand()[one]) == (False, NAMED)


def test_wildcard_makes_all_of_many_wanted_within_a_budget(clock: ManualClock) -> None:
    bus = DeclaringBus()
    bus.subscribe("*/text", 8)
    publisher = make_large(bus)

    search(publisher, clock)

    (one,) = members_of(publisher, "r300")
    assert publisher.list_demand()[one] == OTHERS
    assert publisher.budget is not None
    assert bus.declared == ["*/text"]


def test_few_robots_have_no_budget() -> None:
    bus = DeclaringBus()
    publisher = FleetTopicPublisher(bus, "*/text", String, watches=SubscriberWatches(bus))
    publisher.add(TopicMember("r1/text", ConstantValues()))
    bus.subscribe("*/text")

    publisher.declare_some()

    assert (publisher.budget, bus.declared) == (None, ["*/text", "r1/text"])


def test_growing_fleet_closes_its_declared_publishers(clock: ManualClock) -> None:
    bus = DeclaringBus()
    received = bus.subscribe("r7/text", 8)
    publisher = FleetTopicPublisher(bus, "*/text", String, watches=SubscriberWatches(bus))
    members = [TopicMember(f"r{number}/text", ConstantValues()) for number in range(MANY)]
    for member in members[:-1]:
        publisher.add(member)
    search(publisher, clock)
    publisher.put(members[7:8], [b"1"])
    publisher.add(members[-1])
    publisher.put(members[7:8], [b"2"])
    search(publisher, clock)
    publisher.put(members[7:8], [b"3"])

    assert [sample.payload for sample in received.take()] == [b"1", b"2", b"3"]
    assert [publisher.has_subscribers(member) for member in members[6:9]] == [False, True, False]


def test_latched_topic_of_one_of_many_is_published_once_to_its_subscriber(
    clock: ManualClock,
) -> None:
    bus = DeclaringBus()
    publisher = make_large(bus)
    received = bus.subscribe("r7/text", 8)

    for _ in range(2):
        search(publisher, clock)
        publisher.announce()
        for _ in range(POLLS):
            publisher.announce_some()

    assert [sample.payload for sample in received.take()] == [b"fixed"]


class WatchCountingBus(DeclaringBus):
    """Counts the watches that were opened."""

    def __init__(self) -> None:
        super().__init__()
        self.opened_watches = 0

    def watch_subscribers(self, patterns: Iterable[str]) -> MemorySubscriberWatch:
        self.opened_watches += 1
        return super().watch_subscribers(patterns)


def make_large_ros(bus: MemoryBus, values: ConstantValues) -> RosFleetPublisher:
    graph = RosGraph(bus, RosSettings())
    topic = RosTopic("*/text", String, LATCHED)
    publisher = RosFleetPublisher(bus, graph, topic, SubscriberWatches(bus))
    for number in range(MANY):
        node = a_node(graph, f"r{number}")
        publisher.add(TopicMember(f"r{number}/text", values, node=node))
    return publisher


def test_ros_topic_of_many_opens_no_watch_before_a_subscriber_comes(clock: ManualClock) -> None:
    bus = WatchCountingBus()
    publisher = make_large_ros(bus, ConstantValues())

    search(publisher, clock)
    before = bus.opened_watches
    bus.subscribe(KEY.format("r7"), 8)
    search(publisher, clock)

    assert (before, bus.opened_watches) == (0, 1)


def test_queried_robot_of_many_declares_no_publisher() -> None:
    bus = WatchCountingBus()
    publisher = make_large_ros(bus, ConstantValues())
    bus.pumps.append(publisher.reply_to_queries)

    answers = bus.get(f"{KEY.format('r7')}/@adv/**")

    assert [answer.payload for answer in answers] == [b"fixed"]
    assert bus.declared == [KEY.format("*")]


@pytest.mark.parametrize("is_latched", [False, True])
def test_ros_topic_of_many_reaches_its_subscriber(clock: ManualClock, *, is_latched: bool) -> None:
    bus = DeclaringBus()
    graph = RosGraph(bus, RosSettings())
    kind = RosTopic("*/text", String, LATCHED if is_latched else RELIABLE_10)
    publisher = RosFleetPublisher(bus, graph, kind, SubscriberWatches(bus))
    members = [
        TopicMember(f"r{number}/text", ConstantValues(), node=a_node(graph, f"r{number}"))
        for number in range(MANY)
    ]
    for member in members:
        publisher.add(member)
    received = bus.subscribe(KEY.format("r7"), 8)

    search(publisher, clock)
    if not is_latched:
        publisher.put(members, [b"fixed"] * MANY)

    (sample,) = received.take()
    assert (sample.payload, bus.declared) == (b"fixed", [KEY.format("*")])
    attachment = read_attachment(sample.attachment)
    assert attachment is not None
    assert attachment.sequence_number == 1
    graph.close()


def test_robot_of_many_is_announced_with_its_endpoints_when_it_has_a_subscriber(
    clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_graph, "MAX_ROBOTS_ANNOUNCED", 2)
    bus = DeclaringBus()
    graph = RosGraph(bus, RosSettings())
    topics = [RosTopic(f"*/{name}", String) for name in ("text", "other")]
    watches = SubscriberWatches(bus)
    publishers = [RosFleetPublisher(bus, graph, topic, watches) for topic in topics]
    for number in range(MANY):
        node = graph.add_robot(f"r{number}", "agent")
        for publisher, topic in zip(publishers, ("text", "other"), strict=True):
            publisher.add(TopicMember(f"r{number}/{topic}", ConstantValues(), node=node))
    for publisher in publishers:
        search(publisher, clock)
    before = len(bus.list_tokens(PUBLISHERS))

    bus.subscribe(KEY.format("r7"), 8)
    search(publishers[0], clock)
    search(publishers[1], clock)

    found = [parse_endpoint_token(token) for token in bus.list_tokens(PUBLISHERS)[before:]]
    assert before == 4
    assert sorted(one.key for one in found if one is not None) == ["r7/other", "r7/text"]
