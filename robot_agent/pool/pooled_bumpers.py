"""Contact sensors of the robots of a pool that are in groups, and their topics."""

from collections.abc import Callable
from typing import NamedTuple

from zensim.proto import keys
from zensim.proto.fleet_topics.fleet_publisher import FleetTopicPublisher
from zensim.proto.fleet_topics.topic_members import TopicMember
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.topic_catalog import BUMPER_STATES, TopicSpec
from zensim.robot_agent.bumpers import Bumper, ContactReport, make_bumpers

FindPatternPublisher = Callable[[str, TopicSpec], FleetTopicPublisher]
"""Finds the publisher of a key pattern and topic."""


class _BumperTopic(NamedTuple):
    """The contact sensors whose topics have one publisher."""

    publisher: FleetTopicPublisher
    bumpers: list[tuple[Bumper, TopicMember]]


class PooledBumpers:
    """Contact sensors by claim."""

    def __init__(self, find_publisher: FindPatternPublisher) -> None:
        self._find_publisher = find_publisher
        self._members: dict[int, list[tuple[Bumper, TopicMember]]] = {}
        self._topics: list[_BumperTopic] | None = None
        """All of them by topic; None when they have changed."""

    @property
    def is_wanted(self) -> bool:
        """Whether any of them may have a subscriber."""
        return any(topic.publisher.is_wanted for topic in self._list_topics())

    @property
    def has_members(self) -> bool:
        """Whether a robot has contact sensors."""
        return bool(self._members)

    def add(self, claim: Claim, node: RosNode | None) -> None:
        """Declare the topics of a robot; its node is in the ROS 2 graph."""
        self._topics = None
        for bumper in make_bumpers(claim):
            member = TopicMember(bumper.key, bumper, node=node)
            self._members.setdefault(claim.claim, []).append((bumper, member))
            self._find(member).add(member)

    def remove(self, claim: int) -> None:
        """Undeclare the topics of a robot."""
        self._topics = None
        for _, member in self._members.pop(claim, ()):
            self._find(member).remove(member)

    def reset(self) -> None:
        """Forget the last messages; time may have gone back."""
        for bumper, _ in (one for members in self._members.values() for one in members):
            bumper.reset()

    def publish(self, report: ContactReport) -> None:
        """Publish what is due on topics that may have subscribers."""
        for topic in self._list_topics():
            if not topic.publisher.is_wanted:
                continue
            taken = [(member, bumper.take(report)) for bumper, member in topic.bumpers]
            due = [(member, payload) for member, payload in taken if payload is not None]
            if due:
                topic.publisher.put([one for one, _ in due], [payload for _, payload in due])

    def _find(self, member: TopicMember) -> FleetTopicPublisher:
        return self._find_publisher(keys.make_pattern(member.key), BUMPER_STATES)

    def _list_topics(self) -> list[_BumperTopic]:
        if self._topics is None:
            topics: dict[int, _BumperTopic] = {}
            for bumper, member in (one for members in self._members.values() for one in members):
                publisher = self._find(member)
                topic = topics.setdefault(id(publisher), _BumperTopic(publisher, []))
                topic.bumpers.append((bumper, member))
            self._topics = list(topics.values())
        return self._topics
