"""A topic of many robots on ROS 2's keys: tokens and publishers, a few at a time."""

from dataclasses import dataclass

import pytest

from tests.fakes import MemoryBus
from zensim.proto.messages.standard_messages import String
from zensim.proto.ros2.rmw_attachment import read_attachment
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.robot_agent.pool.outlet import Line
from zensim.robot_agent.pool.ros_face import AT_ONCE, RosFace

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
    node = graph.node(name, "agent")
    assert node is not None
    return node


def a_face(
    bus: MemoryBus, *names: str, is_latched: bool = True, values: Same | None = None
) -> tuple[RosFace, list[Line]]:
    graph = RosGraph(bus, RosSettings())
    face = RosFace(bus, graph, Topic("*/text", String, is_latched))
    lines = [Line(f"{name}/text", values or Same(), node=a_node(graph, name)) for name in names]
    for line in lines:
        face.add(line)
    return face, lines


def test_robots_are_announced_a_few_at_a_time() -> None:
    bus = MemoryBus()
    face, _ = a_face(bus, *(f"r{number}" for number in range(AT_ONCE + 1)))

    face.declare_some()
    first = len(bus.list_tokens(PUBLISHERS))
    face.declare_some()

    assert (first, len(bus.list_tokens(PUBLISHERS))) == (AT_ONCE, AT_ONCE + 1)


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
