"""One topic of many robots on plain and ROS 2 keys; publishers are declared lazily."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

import msgspec
import numpy as np

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.network_protocols import (
    AgentNetwork,
    Publisher,
    Query,
    SubscriberWatch,
    TopicNetwork,
)
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint
from zensim.proto.ros2.rmw_attachment import ATTACHMENT_STRUCT, GID_BYTES
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, RosTopic, gid_from_endpoint
from zensim.proto.subscriber_search import MessageBudget, SubscriberSearch, SubscriberWatches
from zensim.proto.topic_endpoints import CACHE_SUFFIX, KeyPublisher, make_cache_key
from zensim.proto.topic_faults import TopicFaults

ATTACHMENT_DTYPE: Final = np.dtype(
    [
        ("sequence_number", "<i8"),
        ("source_time_ns", "<i8"),
        ("length", "u1"),
        ("gid", "u1", GID_BYTES),
    ]
)
"""Layout of `zensim.proto.ros2.rmw_attachment`."""


class AttachmentRows:
    """ROS 2 attachments of many publishers, a row each."""

    def __init__(self) -> None:
        self._rows = np.zeros(0, dtype=ATTACHMENT_DTYPE)
        self._free: list[int] = []

    def add(self, gid: bytes) -> int:
        """Add a publisher that has sent nothing; return its row."""
        if not self._free:
            count = len(self._rows)
            self._rows = np.concatenate([self._rows, np.zeros(count + 1, dtype=ATTACHMENT_DTYPE)])
            self._free = list(range(len(self._rows) - 1, count - 1, -1))
        row = self._free.pop()
        self._rows[row] = (0, 0, GID_BYTES, np.frombuffer(gid, dtype=np.uint8))
        return row

    def remove(self, row: int) -> None:
        """Remove a publisher."""
        self._free.append(row)

    def write_next(self, rows: Sequence[int], time_ns: int) -> list[bytes]:
        """Write the attachments of the next messages of some rows, without duplicates."""
        at = np.array(rows, dtype=np.intp)
        self._rows["sequence_number"][at] += 1
        self._rows["source_time_ns"][at] = time_ns
        raw = self._rows[at].tobytes()
        return [
            raw[start : start + ATTACHMENT_STRUCT.size]
            for start in range(0, len(raw), ATTACHMENT_STRUCT.size)
        ]


MAX_CHECKED_AT_ONCE = 32
"""Publishers whose matching status is read in one call: 0.1 ms."""
OwnerT = TypeVar("OwnerT")


class MatchedPublishers(Generic[OwnerT]):
    """Publishers by owner, and those of them that have subscribers."""

    def __init__(self) -> None:
        self.matched: dict[OwnerT, Publisher] = {}
        """Publishers that had subscribers at the last check."""
        self._all: dict[OwnerT, Publisher] = {}
        self._unchecked: list[OwnerT] = []

    def add(self, owner: OwnerT, publisher: Publisher) -> None:
        """Add a publisher."""
        self._all[owner] = self.matched[owner] = publisher

    def remove(self, owner: OwnerT) -> None:
        """Undeclare a publisher."""
        if (publisher := self._all.pop(owner, None)) is not None:
            self.matched.pop(owner, None)
            publisher.close()

    def remove_except(self, owners: Set[OwnerT]) -> list[OwnerT]:
        """Undeclare the publishers of all others; return these."""
        others = [owner for owner in self._all if owner not in owners]
        for owner in others:
            self.remove(owner)
        return others

    def check_all(self) -> None:
        """Check all publishers."""
        self.matched = {owner: one for owner, one in self._all.items() if one.is_matched}

    def check_some(self) -> None:
        """Check the next publishers, in turn."""
        if not self._unchecked:
            self._unchecked = list(self._all)
        some, self._unchecked = (
            self._unchecked[:MAX_CHECKED_AT_ONCE],
            self._unchecked[MAX_CHECKED_AT_ONCE:],
        )
        for owner in some:
            if (publisher := self._all.get(owner)) is None:
                continue
            if publisher.is_matched:
                self.matched[owner] = publisher
            else:
                self.matched.pop(owner, None)


QUERY_DEPTH = 256
MAX_ROS_DECLARED_AT_ONCE = 16
"""Tokens or publishers declared in one call: 1 to 2 ms."""
MAX_ROS_FOUND_AT_ONCE = 32
"""Publishers made in one call that declare nothing; a latched topic publishes once on each."""


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


UNWANTED, NAMED, OTHERS = range(3)
"""No subscriber; one of its own; one by wildcard, within the budget. See `SubscribedKeys`."""
MAX_DECLARED_AT_ONCE = 32
"""Publishers declared or checked in one call: a few milliseconds."""


class FleetTopicPublisher:
    """One topic of many robots on the keys of one pattern."""

    _demand: tuple[int, Mapping[TopicMember, int]] | None = None
    """Version and demand that `list_demand` found last."""

    def __init__(
        self,
        network: AgentNetwork,
        pattern: str,
        message_type: type[msgspec.Struct],
        ros: RosFleetPublisher | None = None,
        faults: TopicFaults | None = None,
        watches: SubscriberWatches | None = None,
    ) -> None:
        """Declare the topic.

        Args:
            network: Session of the publishers.
            pattern: Of the members' keys; see `zensim.proto.keys.make_pattern`.
            message_type: Of the payloads, which are CDR.
            ros: The same on ROS 2 keys.
            faults: Of the topics of this process.
            watches: With them, topics of too many robots declare no publishers, and search for
                those with subscribers; None = all publishers are declared, always.
        """
        self._searched: SearchedMembers | None = None
        self._watches = watches
        self._pattern = pattern
        if watches is not None:
            watches.include(pattern)
        self._own_version = 0
        self._ros = ros
        self._faults = TopicFaults() if faults is None else faults
        self._message_type = message_type
        self._network = network
        self._encoding = make_encoding(message_type, Format.CDR)
        self._members: dict[str, tuple[TopicMember, ...]] = {}
        self._undeclared: list[TopicMember] = []
        self._unannounced: list[TopicMember] = []
        self._has_announced = False
        self._matched = MatchedPublishers[TopicMember]()
        self._has_put = False
        self._probe = network.advertise(pattern, self._encoding)
        # Other pools serve other robots on the same pattern.
        self._queries = network.serve(pattern, QUERY_DEPTH, is_complete=False)

    @property
    def is_wanted(self) -> bool:
        """Whether there are subscribers on any key."""
        return self._probe.is_matched or (self._ros is not None and self._ros.is_wanted)

    @property
    def is_empty(self) -> bool:
        """Whether there are no robots."""
        return not self._members

    @property
    def is_declaring(self) -> bool:
        """Whether there are subscribers and members without a publisher; see `declare_some`."""
        return self._probe.is_matched and bool(self._undeclared)

    def has_subscribers(self, member: TopicMember) -> bool:
        """Whether a member has subscribers, as of the last check."""
        return (self._probe.is_matched and member in self._matched.matched) or (
            self._ros is not None and self._ros.has_subscribers(member)
        )

    def add(self, member: TopicMember) -> None:
        """Add a robot; its publisher is declared once there are subscribers."""
        self._members[member.key] = (*self._members.get(member.key, ()), member)
        self._note_change()
        if self._searched is None:
            self._undeclared.append(member)
        if self._ros is not None:
            self._ros.add(member)

    def remove(self, member: TopicMember) -> None:
        """Remove a robot."""
        left = tuple(one for one in self._members.pop(member.key, ()) if one is not member)
        if left:
            self._members[member.key] = left
        self._matched.remove(member)
        member.publisher = None
        self._note_change()
        if self._ros is not None:
            self._ros.remove(member)

    def _note_change(self) -> None:
        if self._searched is not None:
            self._searched.search.set_keys(self._members.keys)

    def declare_some(self) -> None:
        """Declare some of the missing publishers if there are subscribers; check others."""
        if self._ros is not None:
            self._ros.declare_some()
        if not self._members or not self._probe.is_matched:
            return
        if self._is_searched:
            self._make_found()
            return
        # A process that publishes to subscribers only puts nothing while it knows of none.
        if not self._undeclared and (self._has_put or not self._matched.matched):
            self._matched.check_some()
            self._has_put = False
        some, self._undeclared = (
            self._undeclared[:MAX_DECLARED_AT_ONCE],
            self._undeclared[MAX_DECLARED_AT_ONCE:],
        )
        for member in some:
            if member in self._members.get(member.key, ()):
                member.publisher = self._network.advertise(member.key, self._encoding)
                self._matched.add(member, member.publisher)

    @property
    def _is_searched(self) -> bool:
        watches = self._watches
        if self._searched is None and watches and watches.is_crowded(len(self._members)):
            watch = watches.find(self._pattern)
            self._searched = SearchedMembers(SubscriberSearch(watch, self._pattern))
            self._undeclared.clear()
            self._note_change()
        return self._searched is not None

    def _make_found(self) -> None:
        """Search those with subscribers; make their publishers, which declare nothing."""
        if (searched := self._searched) is None or not searched.poll(lambda: self._members):
            return
        self._own_version += 1
        found = searched.all
        for member in self._matched.remove_except(found):
            member.publisher, member.was_matched = None, False
        for member in found - self._matched.matched.keys():
            member.publisher = searched.search.watch.advertise(member.key, self._encoding)
            self._matched.add(member, member.publisher)

    @property
    def version(self) -> int:
        """Changes with what `list_demand` returns."""
        return self._own_version + (0 if self._ros is None else self._ros.version)

    @property
    def budget(self) -> MessageBudget | None:
        """Budget of messages to subscribers by wildcard; None while all publishers are declared."""
        is_searched = self._searched is not None or (
            self._ros is not None and self._ros.searched is not None
        )
        return self._watches.budget if self._watches is not None and is_searched else None

    def find_members(self, key: str) -> Sequence[TopicMember]:
        """Find the members with a key."""
        return self._members.get(key, ())

    def list_demand(self) -> Mapping[TopicMember, int]:
        """List the members whose messages are needed, and by whom: `NAMED` or `OTHERS`.

        All groups of robots ask for it; it is made once for each `version`.
        """
        if self._demand is None or self._demand[0] != self.version:
            searched = [self._searched, None if self._ros is None else self._ros.searched]
            known = [one for one in searched if one is not None]
            demand = {member: OTHERS for one in known for member in one.others}
            demand.update({member: NAMED for one in known for member in one.named})
            self._demand = self.version, demand
        return self._demand[1]

    def check_all(self) -> None:
        """Declare all missing publishers if there are subscribers, and check all."""
        while self.is_declaring:
            self.declare_some()
        self._matched.check_all()

    def put(self, members: Sequence[TopicMember], payloads: Sequence[bytes]) -> None:
        """Publish to members with subscribers; those without a publisher yet are skipped."""
        self._has_put = True
        if self._faults:
            members, payloads = self._change(members, payloads)
        matched = self._matched.matched if self._probe.is_matched else {}
        for member, payload in zip(members, payloads, strict=True) if matched else ():
            if (publisher := matched.get(member)) is not None:
                publisher.send(payload)
        if self._ros is not None:
            self._ros.put(members, payloads)

    def _change(
        self, members: Sequence[TopicMember], payloads: Sequence[bytes]
    ) -> tuple[list[TopicMember], list[bytes]]:
        changed = [
            (member, one)
            for member, payload in zip(members, payloads, strict=True)
            for one in self._faults.change(member.key, self._message_type, payload)
        ]
        return [member for member, _ in changed], [payload for _, payload in changed]

    def announce(self) -> None:
        """Start to publish last values to new subscribers; see `announce_some`."""
        if self._unannounced:
            return
        if self.is_wanted:
            listed = self._list_members() if self._searched is None else self._matched.matched
            self._unannounced = list(listed)
        elif self._has_announced:
            for member in self._list_members():
                member.was_matched = False
            self._has_announced = False

    def _list_members(self) -> Iterator[TopicMember]:
        return (member for members in self._members.values() for member in members)

    def announce_some(self) -> None:
        """Continue `announce` with a part of the robots."""
        if not self._unannounced:
            return
        self._has_announced = True
        some, self._unannounced = (
            self._unannounced[:MAX_DECLARED_AT_ONCE],
            self._unannounced[MAX_DECLARED_AT_ONCE:],
        )
        for member in some:
            _publish_if_newly_matched(member)

    def reply_to_queries(self) -> None:
        """Reply to queries with the last values of these robots."""
        for call in self._queries.take():
            answers = [
                (member.key, payload)
                for member in self._find_queried(call)
                if (payload := member.values.payload(member.row)) is not None
            ]
            if answers:
                call.reply_each(answers, self._encoding)
            else:
                call.drop()
        if self._ros is not None:
            self._ros.reply_to_queries()

    def close(self) -> None:
        """Undeclare the topic."""
        for member in tuple(self._list_members()):
            self.remove(member)
        self._probe.close()
        self._queries.close()
        if self._ros is not None:
            self._ros.close()

    def _find_queried(self, call: Query) -> Iterator[TopicMember]:
        if call.key in self._members:
            yield from self._members[call.key]
        elif "*" in call.key:
            for key, members in self._members.items():
                if call.covers(key):
                    yield from members


def _publish_if_newly_matched(member: TopicMember) -> None:
    if member.publisher is None:
        return
    is_matched = member.publisher.is_matched
    if is_matched and not member.was_matched:
        payload = member.values.payload(member.row)
        if payload is not None:
            member.publisher.send(payload)
    member.was_matched = is_matched
