"""One topic of many robots on plain keys; publishers are declared lazily."""

from collections.abc import Iterator, Mapping, Sequence

import msgspec

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.fleet_topics.matched_publishers import MatchedPublishers
from zensim.proto.fleet_topics.ros_fleet_publisher import RosFleetPublisher
from zensim.proto.fleet_topics.topic_members import (
    NAMED,
    OTHERS,
    QUERY_DEPTH,
    SearchedMembers,
    TopicMember,
)
from zensim.proto.network_protocols import AgentNetwork, Query
from zensim.proto.subscriber_search import MessageBudget, SubscriberSearch, SubscriberWatches
from zensim.proto.topic_faults import TopicFaults

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
