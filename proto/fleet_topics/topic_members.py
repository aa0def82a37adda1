"""Robots of a topic, their last values, and which of them have subscribers."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from zensim.proto.network_protocols import Publisher
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.subscriber_search import SubscriberSearch

QUERY_DEPTH = 256
UNWANTED, NAMED, OTHERS = range(3)
"""No subscriber; one of its own; one by wildcard, within the budget. See `SubscribedKeys`."""


class LastValues(Protocol):
    """The last values of a topic, by row."""

    def payload(self, row: int) -> bytes | None:
        """Write the last value of a row as CDR; None if there is none yet."""


@dataclass(eq=False, slots=True)
class TopicMember:
    """One robot's part in a topic.

    Attributes:
        key: The plain key.
        values: Last values of the topic.
        row: Of the robot in `values`.
        node: Of the robot in the ROS 2 graph.
        was_matched: As of the last announcement.
    """

    key: str
    values: LastValues
    row: int = 0
    node: RosNode | None = None
    publisher: Publisher | None = None
    was_matched: bool = False


class SearchedMembers:
    """The members of a topic of many robots that have subscribers; they declare no publishers."""

    def __init__(self, search: SubscriberSearch) -> None:
        self.search = search
        self.named: frozenset[TopicMember] = frozenset()
        """Members with subscribers of their own; see `SubscribedKeys`."""
        self.others: frozenset[TopicMember] = frozenset()

    @property
    def all(self) -> frozenset[TopicMember]:
        """All that have subscribers."""
        return self.named | self.others

    def poll(self, list_members: Callable[[], Mapping[str, Sequence[TopicMember]]]) -> bool:
        """Continue the search; whether the result has changed.

        Args:
            list_members: Lists all members by key, when the result has changed.
        """
        if not self.search.poll(time.monotonic()):
            return False
        found, members = self.search.found, list_members()
        self.named = frozenset(one for key in found.named for one in members.get(key, ()))
        self.others = frozenset(one for key in found.others for one in members.get(key, ()))
        return True
