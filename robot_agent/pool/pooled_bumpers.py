"""Contact sensors of the robots of a pool that are in groups, and their topics."""

from collections.abc import Callable

from zensim.proto import keys
from zensim.proto.fleet_publisher import FleetTopicPublisher, TopicMember
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.topic_catalog import BUMPER_STATES, TopicSpec
from zensim.robot_agent.bumpers import Bumper, ContactReport, make_bumpers

FindPatternPublisher = Callable[[str, TopicSpec], FleetTopicPublisher]
"""Finds the publisher of a key pattern and topic."""


class PooledBumpers:
    """Contact sensors by claim."""

    def __init__(self, find_publisher: FindPatternPublisher) -> None:
        self._find_publisher = find_publisher
        self._members: dict[int, list[tuple[Bumper, TopicMember]]] = {}

    @property
    def is_wanted(self) -> bool:
        """Whether any of them may have a subscriber."""
        publishers = {id(one): one for one, _, _ in self._list_members()}
        return any(publisher.is_wanted for publisher in publishers.values())

    def add(self, claim: Claim, node: RosNode | None) -> None:
        """Declare the topics of a robot; its node is in the ROS 2 graph."""
        for bumper in make_bumpers(claim):
            member = TopicMember(bumper.key, bumper, node=node)
            self._members.setdefault(claim.claim, []).append((bumper, member))
            self._find(member).add(member)

    def remove(self, claim: int) -> None:
        """Undeclare the topics of a robot."""
        for _, member in self._members.pop(claim, ()):
            self._find(member).remove(member)

    def reset(self) -> None:
        """Forget the last messages; time may have gone back."""
        for _, bumper, _ in self._list_members():
            bumper.reset()

    def publish(self, report: ContactReport) -> None:
        """Publish what is due on topics that may have subscribers."""
        for publisher, bumper, member in self._list_members():
            if publisher.is_wanted and (payload := bumper.take(report)) is not None:
                publisher.put((member,), (payload,))

    def _find(self, member: TopicMember) -> FleetTopicPublisher:
        return self._find_publisher(keys.make_pattern(member.key), BUMPER_STATES)

    def _list_members(self) -> list[tuple[FleetTopicPublisher, Bumper, TopicMember]]:
        return [
            (self._find(member), bumper, member)
            for members in self._members.values()
            for bumper, member in members
        ]
