"""One topic of many robots on ROS 2 keys; publishers are declared lazily."""

import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

import msgspec

from zensim.proto.fleet_topics.attachment_rows import AttachmentRows
from zensim.proto.fleet_topics.matched_publishers import MatchedPublishers
from zensim.proto.fleet_topics.topic_members import QUERY_DEPTH, SearchedMembers, TopicMember
from zensim.proto.network_protocols import AgentNetwork, Query, SubscriberWatch, TopicNetwork
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint
from zensim.proto.ros2.ros_graph import RosGraph, RosTopic, gid_from_endpoint
from zensim.proto.subscriber_search import SubscriberSearch, SubscriberWatches
from zensim.proto.topic_endpoints import CACHE_SUFFIX, KeyPublisher, make_cache_key

MAX_ROS_DECLARED_AT_ONCE = 16
"""Tokens or publishers declared in one call: 1 to 2 ms."""
MAX_ROS_FOUND_AT_ONCE = 32
"""Publishers made in one call that declare nothing; a latched topic publishes once on each."""
MAX_ANNOUNCED_CACHES: Final = 100
"""Robots of a process whose latched topics are queried again after a cut link: a token each."""


class RosFleetPublisher:
    """One topic of many robots on the ROS 2 keys of one pattern."""

    def __init__(
        self,
        network: AgentNetwork,
        graph: RosGraph,
        topic: RosTopic,
        watches: SubscriberWatches | None = None,
    ) -> None:
        """Declare the topic.

        Args:
            network: Session of the publishers.
            graph: ROS 2 graph of the members' nodes.
            topic: Its key is the pattern of the members' keys.
            watches: As of `FleetTopicPublisher`.
        """
        self.searched: SearchedMembers | None = None
        self.version = 0  # counts changes of `searched`
        self._watches = watches
        self._found: deque[TopicMember] = deque()  # without a publisher yet
        self._network = network
        self._topic = topic
        self._encoding = topic.encoding
        self._surplus = graph.settings.count_surplus_bytes(topic.ros_type)
        self._unjoined: list[TopicMember] = []
        self._joined: dict[TopicMember, GraphEndpoint] = {}
        self._key_publishers: dict[TopicMember, KeyPublisher] = {}  # of a latched topic
        self._unrepeated: deque[KeyPublisher] = deque()
        self._matched = MatchedPublishers[TopicMember]()
        self._attachments = AttachmentRows()
        self._rows: dict[TopicMember, int] = {}
        """Rows of attachments by member; empty for a latched topic."""
        self._members: dict[TopicMember, None] = {}
        self._graph = graph
        self._late_announcements = 0  # of the graph, when they were last noted
        self._pattern = key = graph.data_key(topic)
        if watches is not None:
            watches.include(key)
        self._probe = network.advertise(key, self._encoding)
        cache = f"{key}/{CACHE_SUFFIX}/{graph.zid}/*/_"
        self._queries = network.serve(cache, QUERY_DEPTH) if topic.is_latched else None

    @property
    def is_wanted(self) -> bool:
        """Whether there are subscribers on any key."""
        return self._probe.is_matched

    def add(self, member: TopicMember) -> None:
        """Add a robot; its endpoint is declared later."""
        if member.node is not None:
            self._members[member] = None
            if member.node.is_announced:
                self._unjoined.append(member)
            self._note_change()

    def _note_change(self) -> None:
        if self.searched is not None:
            self.searched.search.set_keys(lambda: map(self._make_key, self._members))

    def _make_key(self, member: TopicMember) -> str:
        # Not kept: five keys of a robot would take a kilobyte.
        head, _, tail = self._pattern.partition(self._topic.key)
        return f"{head}{member.key}{tail}"

    def remove(self, member: TopicMember) -> None:
        """Remove a robot; its node undeclares the endpoint."""
        self._note_change()
        self._joined.pop(member, None)
        self._members.pop(member, None)
        if (key_publisher := self._key_publishers.pop(member, None)) is not None:
            if key_publisher in self._unrepeated:
                self._unrepeated.remove(key_publisher)
            key_publisher.close()
        if (row := self._rows.pop(member, None)) is not None:
            self._attachments.remove(row)
            self._matched.remove(member)

    def declare_some(self) -> None:
        """Declare some endpoints; then publishers, if there are subscribers.

        See `KeyPublisher.repeat` for what was published before.
        """
        while self._unrepeated and self._unrepeated[0].repeat():
            self._unrepeated.popleft()
        self._note_late_announcements()
        has_joined_all = not self._unjoined
        self._join_some()
        if not self.is_wanted:
            return
        if self._is_searched:
            self._declare_found()
        elif has_joined_all:
            self._declare_missing()

    def _join_some(self) -> None:
        some, self._unjoined = (
            self._unjoined[:MAX_ROS_DECLARED_AT_ONCE],
            self._unjoined[MAX_ROS_DECLARED_AT_ONCE:],
        )
        for member in some:
            self._join(member)

    def _note_late_announcements(self) -> None:
        """Declare the endpoints of robots that were announced after they were added, too."""
        if self._late_announcements != self._graph.late_announcements:
            self._late_announcements = self._graph.late_announcements
            self._unjoined = [
                one
                for one in self._members
                if one.node is not None and one.node.is_announced and one not in self._joined
            ]

    def _declare_missing(self) -> None:
        """Declare some publishers; check the others if all are there."""
        if len(self._key_publishers) + len(self._rows) < len(self._members):
            is_there = self._key_publishers if self._topic.is_latched else self._rows
            missing = [member for member in self._members if member not in is_there]
            for member in missing[:MAX_ROS_DECLARED_AT_ONCE]:
                self._declare(member)
        else:
            self._matched.check_some()

    @property
    def _is_searched(self) -> bool:
        watches = self._watches
        if self.searched is None and watches and watches.is_crowded(len(self._members)):
            watch = watches.find(self._pattern)
            self.searched = SearchedMembers(SubscriberSearch(watch, self._pattern))
            self._note_change()
        return self.searched is not None

    def _declare_found(self) -> None:
        """Search those with subscribers; make some of their publishers, which declare nothing."""
        if (searched := self.searched) is None:
            return
        if searched.poll(self._list_by_key):
            self.version += 1
            found = searched.all
            for member in searched.named:
                if member.node is not None:
                    self._graph.announce_late(member.node)
            for member in self._matched.remove_except(found):
                self._attachments.remove(self._rows.pop(member))
            is_there = self._key_publishers if self._topic.is_latched else self._rows
            self._found = deque(one for one in found if one not in is_there)
        for _ in range(min(len(self._found), MAX_ROS_FOUND_AT_ONCE)):
            self._declare(self._found.popleft())

    def _list_by_key(self) -> dict[str, list[TopicMember]]:
        listed: dict[str, list[TopicMember]] = {}
        for member in self._members:
            listed.setdefault(self._make_key(member), []).append(member)
        return listed

    def has_subscribers(self, member: TopicMember) -> bool:
        """Whether a member has subscribers, as of the last check."""
        return member in self._matched.matched and self.is_wanted

    def put(self, members: Sequence[TopicMember], payloads: Sequence[bytes]) -> None:
        """Publish to members with subscribers; those without a publisher yet are skipped."""
        if not self._matched.matched:
            return
        if self._surplus:
            payloads = [payload[: -self._surplus] for payload in payloads]
        matched = self._matched.matched
        messages = [
            (publisher, payload, self._rows[member])
            for member, payload in zip(members, payloads, strict=True)
            if (publisher := matched.get(member)) is not None
        ]
        attachments = self._attachments.write_next([row for _, _, row in messages], time.time_ns())
        for (publisher, payload, _), attachment in zip(messages, attachments, strict=True):
            publisher.send(payload, attachment)

    def reply_to_queries(self) -> None:
        """Reply to late joiners with the last values."""
        for call in self._queries.take() if self._queries is not None else ():
            for member in self._find_queried(call):
                self._reply_with_last(member, call)
            call.drop()

    def close(self) -> None:
        """Undeclare the topic."""
        for member in tuple(self._members):
            self.remove(member)
        self._probe.close()
        if self._queries is not None:
            self._queries.close()

    def _make_topic(self, member: TopicMember) -> RosTopic:
        return msgspec.structs.replace(self._topic, key=member.key)

    def _join(self, member: TopicMember) -> GraphEndpoint | None:
        if member.node is None or member not in self._members:
            return None
        if member not in self._joined:
            self._joined[member] = member.node.add_topic_endpoint("MP", self._make_topic(member))
            if self._topic.is_latched and len(self._joined) <= MAX_ANNOUNCED_CACHES:
                member.node.announce_cache(self._make_cache_key(self._make_key(member)))
        return self._joined[member]

    def _declare(self, member: TopicMember) -> None:
        if member in self._key_publishers or (endpoint := self._join(member)) is None:
            return
        publisher = self._find_source().advertise(self._make_key(member), self._encoding)
        if not self._topic.is_latched:
            self._rows[member] = self._attachments.add(gid_from_endpoint(endpoint))
            self._matched.add(member, publisher)
            return
        key_publisher = self._key_publishers[member] = KeyPublisher(
            publisher, endpoint, self._network.stamp
        )
        if publisher.is_matched and (payload := member.values.payload(member.row)) is not None:
            key_publisher.send(payload)
            self._unrepeated.append(key_publisher)

    def _find_source(self) -> TopicNetwork | SubscriberWatch:
        # A query comes before the probe knows of its subscriber: it asks itself.
        if self._is_searched and self.searched is not None:
            return self.searched.search.watch
        return self._network

    def _reply_with_last(self, member: TopicMember, call: Query) -> None:
        self._declare(member)
        payload = member.values.payload(member.row)
        key_publisher = self._key_publishers.get(member)
        if payload is not None and key_publisher is not None:
            key_publisher.add_reply(call, self._make_key(member), payload, self._encoding)

    def _find_queried(self, call: Query) -> Iterator[TopicMember]:
        wanted, is_cached, _ = call.key.partition("/@adv/")
        for member in tuple(self._members):
            key = self._make_key(member)
            if (
                key == wanted
                if is_cached and "*" not in wanted
                else call.covers(self._make_cache_key(key))
            ):
                yield member

    def _make_cache_key(self, key: str) -> str:
        return make_cache_key(key, self._graph.zid)
