"""A topic of many robots on ROS 2's keys: tokens and publishers, a few at a time."""

from dataclasses import dataclass

import pytest

from tests.fakes import MemoryBus
from zensim.proto.messages.standard_messages import String
from zensim.proto.ros2.liveliness_tokens import LATCHED, RELIABLE_10
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.robot_agent.pool.fleet_publisher import (
    MAX_CHECKED_AT_ONCE,
    MAX_ROS_DECLARED_AT_ONCE,
    AttachmentRows,
    FleetTopicPublisher,
    MatchedPublishers,
    RosFleetPublisher,
    TopicMember,
)

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


def test_attachments_of_who_came_for_another_begin_anew() -> None:
    many = AttachmentRows()
    row = many.add(GID)
    many.write_next([row], 1)

    many.remove(row)
    others = [many.add(bytes(16)), many.add(GID)]

    assert many.write_next(others, 2) == [
        write_attachment(Attachment(1, 2, gid)) for gid in (bytes(16), GID)
    ]


def an_audience(bus: MemoryBus, count: int) -> MatchedPublishers[int]:
    audience = MatchedPublishers[int]()
    for number in range(count):
        audience.add(number, bus.advertise(f"r{number}/odom", ""))
    return audience


def test_everybody_is_heard_until_asked_about() -> None:
    bus = MemoryBus()
    audience = an_audience(bus, 3)
    bus.subscribe("r1/odom")

    before = set(audience.matched)
    audience.check_some()

    assert (before, set(audience.matched)) == ({0, 1, 2}, {1})


def test_all_have_been_asked_about_after_a_round_and_are_again_in_the_next() -> None:
    bus = MemoryBus()
    audience = an_audience(bus, MAX_CHECKED_AT_ONCE + 1)

    audience.check_some()
    first = set(audience.matched)
    audience.check_some()
    second = set(audience.matched)
    bus.subscribe("r0/odom")
    audience.check_some()

    assert (first, second, set(audience.matched)) == ({MAX_CHECKED_AT_ONCE}, set(), {0})


def test_who_has_gone_is_heard_no_more() -> None:
    bus = MemoryBus()
    audience = an_audience(bus, MAX_CHECKED_AT_ONCE + 2)
    bus.subscribe("*/odom")
    audience.check_some()

    audience.remove(MAX_CHECKED_AT_ONCE)
    audience.check_some()

    assert set(audience.matched) == {*range(MAX_CHECKED_AT_ONCE), MAX_CHECKED_AT_ONCE + 1}


class Nothing:
    """Has no value of any row; see `outlet.Values`."""

    def payload(self, row: int) -> bytes | None:
        del row
        return None


class CountingBus(MemoryBus):
    """Keeps the keys of all that was put, heard or not."""

    def __init__(self) -> None:
        super().__init__()
        self.put_on: list[str] = []

    def put(self, key: str, payload: bytes, encoding: str = "", attachment: bytes = b"") -> None:
        self.put_on.append(key)
        super().put(key, payload, encoding, attachment)


def an_outlet(bus: MemoryBus, *names: str) -> tuple[FleetTopicPublisher, list[TopicMember]]:
    outlet = FleetTopicPublisher(bus, "*/text", String)
    lines = [TopicMember(f"{name}/text", Nothing()) for name in names]
    for line in lines:
        outlet.add(line)
    return outlet, lines


def test_only_robots_that_are_heard_are_put_on() -> None:
    bus = CountingBus()
    bus.subscribe("r2/text", 8)
    outlet, lines = an_outlet(bus, "r1", "r2", "r3")

    outlet.declare_some()
    outlet.put(lines, [b"1"] * 3)
    outlet.declare_some()
    outlet.put(lines, [b"2"] * 3)

    assert bus.put_on == ["r1/text", "r2/text", "r3/text", "r2/text"]


def test_nothing_is_put_once_all_have_ceased_to_listen() -> None:
    bus = CountingBus()
    heard = bus.subscribe("r1/text")
    outlet, lines = an_outlet(bus, "r1")

    outlet.declare_some()
    heard.close()
    outlet.put(lines, [b"1"])

    assert bus.put_on == []


def test_robot_is_heard_by_who_comes_while_others_listen() -> None:
    bus = CountingBus()
    bus.subscribe("r1/text", 8)
    outlet, lines = an_outlet(bus, "r1", "r2")
    outlet.declare_some()
    outlet.put(lines, [b"1"] * 2)
    outlet.declare_some()

    late = bus.subscribe("r2/text", 8)
    outlet.put(lines, [b"2"] * 2)
    outlet.declare_some()
    outlet.put(lines, [b"3"] * 2)

    assert [sample.payload for sample in late.take()] == [b"3"]


KEY = (
    "0/{}/text/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
PUBLISHERS = "@ros2_lv/*/*/*/*/MP/**"


@dataclass
class Same:
    """Says one thing of each row; see `outlet.Values`."""

    value: bytes | None = b"fixed"

    def payload(self, row: int) -> bytes | None:
        del row
        return self.value


def a_node(graph: RosGraph, name: str) -> RosNode:
    node = graph.add_node(name, "agent")
    assert node is not None
    return node


def a_face(
    bus: MemoryBus, *names: str, is_latched: bool = True, values: Same | None = None
) -> tuple[RosFleetPublisher, list[TopicMember]]:
    graph = RosGraph(bus, RosSettings())
    face = RosFleetPublisher(
        bus, graph, Topic("*/text", String, LATCHED if is_latched else RELIABLE_10)
    )
    lines = [
        TopicMember(f"{name}/text", values or Same(), node=a_node(graph, name)) for name in names
    ]
    for line in lines:
        face.add(line)
    return face, lines


def test_robots_are_announced_a_few_at_a_time() -> None:
    bus = MemoryBus()
    face, _ = a_face(bus, *(f"r{number}" for number in range(MAX_ROS_DECLARED_AT_ONCE + 1)))

    face.declare_some()
    first = len(bus.list_tokens(PUBLISHERS))
    face.declare_some()

    assert (first, len(bus.list_tokens(PUBLISHERS))) == (
        MAX_ROS_DECLARED_AT_ONCE,
        MAX_ROS_DECLARED_AT_ONCE + 1,
    )


def test_anybody_who_listens_to_one_robot_is_seen() -> None:
    bus = MemoryBus()
    face, _ = a_face(bus, "r1", "r2")
    assert not face.is_wanted

    bus.subscribe(KEY.format("r2"))

    assert face.is_wanted


def test_messages_are_put_once_somebody_listens() -> None:
    bus = MemoryBus()
    face, lines = a_face(bus, "r1", "r2", is_latched=False)
    heard = bus.subscribe(KEY.format("*"), 8)

    face.put(lines, [b"early", b"early"])
    face.declare_some()
    face.declare_some()
    face.put(lines, [b"1", b"2"])
    face.put(lines[1:], [b"3"])

    samples = heard.take()
    read = [read_attachment(sample.attachment) for sample in samples]
    assert [sample.payload for sample in samples] == [b"1", b"2", b"3"]
    assert [one.sequence_number for one in read if one] == [1, 1, 2]
    assert len({one.gid for one in read if one}) == 2


def test_who_listened_before_is_told_what_never_changes() -> None:
    bus = MemoryBus()
    heard = bus.subscribe(KEY.format("r1"), 8)
    face, _ = a_face(bus, "r1")

    for _ in range(3):
        face.declare_some()

    assert [sample.payload for sample in heard.take()] == [b"fixed"]


@pytest.mark.parametrize(("asked", "told"), [("r1", 1), ("*", 2), ("r3", 0)])
def test_late_joiner_is_told_of_the_robots_it_asks_for(asked: str, told: int) -> None:
    bus = MemoryBus()
    face, _ = a_face(bus, "r1", "r2")
    bus.pumps.append(face.answer)

    answers = bus.get(f"{KEY.format(asked)}/@adv/**")

    assert len(answers) == told
    assert all(read_attachment(answer.attachment) for answer in answers)


def test_late_joiner_is_told_nothing_while_there_is_nothing() -> None:
    bus = MemoryBus()
    face, _ = a_face(bus, "r1", values=Same(None))
    bus.pumps.append(face.answer)

    assert bus.get(f"{KEY.format('r1')}/@adv/**") == []


def test_robot_that_has_gone_is_told_of_no_more() -> None:
    bus = MemoryBus()
    face, lines = a_face(bus, "r1", "r2")
    bus.pumps.append(face.answer)

    face.remove(lines[0])
    face.declare_some()

    assert len(bus.get(f"{KEY.format('*')}/@adv/**")) == 1
    assert len(bus.list_tokens(PUBLISHERS)) == 1


def test_closed_face_answers_nobody() -> None:
    bus = MemoryBus()
    face, _ = a_face(bus, "r1")

    face.close()

    assert not bus.is_served(f"{KEY.format('r1')}/@adv/**")
