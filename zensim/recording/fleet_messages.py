"""Odometry and transforms of large fleets, from the messages of their agents.

An agent publishes the odometry of all its robots in few messages; see `FleetOdometry`. Each robot's
own messages are made of it here, with the bytes that the robot would publish: a query of its topics
gives their frames and covariances once, which never change.
"""

import time
from collections import deque
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from zensim.proto import keys
from zensim.proto.codec.cdr_batch import CdrBatch, IntArray
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.joint_transforms import ODOMETRY, FramePoses
from zensim.proto.message_paths import (
    HEADER_STAMP,
    ODOMETRY_COLUMNS,
    ODOMETRY_PATHS,
    list_tf_paths,
    list_tf_stamps,
)
from zensim.proto.messages.agent_messages import STATE_COLUMNS, FleetOdometry
from zensim.proto.messages.model_messages import MOVABLE_KINDS, Joint, Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.standard_messages import NANOSECONDS, Odometry, TFMessage
from zensim.proto.messages.telemetry_messages import Event, GetModelsResponse
from zensim.proto.network_protocols import Sample
from zensim.proto.topic_catalog import FLEET_ODOMETRY
from zensim.recording.fleet_robots import (
    FAILURES,
    SUFFIXES,
    FleetRobot,
    FleetSelection,
    list_robots,
)
from zensim.recording.recorded_topics import RecordedTopic
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.client.topic_reader import TopicReader, read_as

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus

DEPTH: Final = 4096
MAX_WAITING_BYTES: Final = 32 << 20
"""Most bytes of waiting messages; newer replace the oldest. 10,000 robots send 1.5 MB a step."""
MAX_EARLY: Final = 512
"""Messages of other epochs that wait for the clock."""
CALL_TIMEOUT_S: Final = 1.0
FIRST_BUDGET_S: Final = 3.0
"""Time for the queries of all robots of a world at the start."""
QUERY_BUDGET_S: Final = 0.5
"""Time for all queries of one call of `collect` later."""
QUERY_PERIOD_S: Final = 1.0
"""Wall time between two queries for robots that are new."""
MAX_QUERY_PERIOD_S: Final = 8.0
"""The period is doubled up to it while no names of robots are known to the server."""
MOST_NAMED: Final = 1000
"""Robots that are asked for by name."""
MOST_SINGLE: Final = 16
"""New robots whose topics are queried one by one."""
MOST_QUERIES: Final = 5
"""Queries of a robot without all replies after which its own topics are subscribed to."""
MISSED_NS: Final = NANOSECONDS
"""Simulation time without odometry of a robot after which its own topics are subscribed to."""
MISSED_S: Final = 1.0
"""Wall time that has to pass, too: a simulation may run fast or step far at once."""
CHECK_NS: Final = NANOSECONDS // 4
MAX_TIME_NS: Final = (1 << 31) * NANOSECONDS
"""End of the time that a stamp can have."""
NEVER_NS: Final = -1
NEVER_S: Final = float("-inf")
NO_SLOT: Final = 0
"""Row of no robot."""


BoolArray = npt.NDArray[np.bool_]


class _TransformParts(NamedTuple):
    """What the transforms of a robot are made of, in the order of its message."""

    columns: tuple[int, ...]
    """Joint of each transform, or `ODOMETRY`."""
    joints: tuple[Joint, ...]


def find_transform_parts(
    transforms: TFMessage, odometry: Odometry, model: Model
) -> _TransformParts | None:
    """Find what a robot's transforms are made of.

    Returns:
        None if a transform is neither its odometry nor of one of its joints.
    """
    base = odometry.header.frame_id, odometry.child_frame_id
    movable = {
        (joint.parent, joint.child): number
        for number, joint in enumerate(model.joints)
        if joint.kind in MOVABLE_KINDS
    }
    columns = []
    for one in transforms.transforms:
        edge = one.header.frame_id, one.child_frame_id
        if edge != base and edge not in movable:
            return None
        columns.append(ODOMETRY if edge == base else movable[edge])
    joints = tuple(model.joints[column] for column in columns if column != ODOMETRY)
    return _TransformParts(tuple(columns), joints)


class _Layout(NamedTuple):
    """What robots of a group have in common."""

    has_odometry: bool
    """Whether it is recorded."""
    parts: _TransformParts | None
    """None without transforms."""


class _Templates(NamedTuple):
    """Topics of a robot, and messages with the frames and covariances of its own."""

    topic: RecordedTopic | None
    """Topic of odometry; None if it is not recorded."""
    odometry: Odometry
    tf_topic: RecordedTopic | None
    """None if transforms are not made of odometry."""
    transforms: TFMessage


@dataclass(eq=False, slots=True)
class _KnownRobot:
    """A robot of the world."""

    robot: FleetRobot
    slot: int
    """Slot in the table."""
    single: set[str]
    """Keys that are subscribed to while its odometry comes."""
    replies: dict[str, Sample] = field(default_factory=dict)
    """Replies by key, kept until all have come."""
    queries: int = 0
    templates: _Templates | None = None
    """None until its topics have replied."""


class _FleetGroup:
    """Messages of robots with equal layouts."""

    def __init__(self, layout: _Layout, members: Sequence[_KnownRobot]) -> None:
        self.layout, self._members = layout, list(members)
        self.rows = {one.slot: row for row, one in enumerate(members)}
        """Rows of the robots that are left, by slot."""
        self.slots = np.array(list(self.rows), dtype=np.int64)
        """Slot of each row; `NO_SLOT` for a robot that is gone."""
        found = [one.templates for one in members if one.templates is not None]
        self._topics = [one.topic for one in found if one.topic is not None]
        self._odometry = CdrBatch(
            [one.odometry for one in found if one.topic is not None], ODOMETRY_PATHS, HEADER_STAMP
        )
        parts = layout.parts or _TransformParts((), ())
        self._tf_topics = [one.tf_topic for one in found if one.tf_topic is not None]
        self._transforms = CdrBatch(
            [one.transforms for one in found if one.tf_topic is not None],
            list_tf_paths(len(parts.columns)),
            list_tf_stamps(len(parts.columns)),
        )
        self._poses = FramePoses(parts.columns, parts.joints)
        has_own = [not self._tf_topics or one.robot.tf_key in one.single for one in members]
        self._has_transforms = ~np.array(has_own, dtype=np.bool_)
        self.is_lacking = False
        """Whether keys of robots have become single ones."""

    @property
    def members(self) -> list[_KnownRobot]:
        """Robots that are left."""
        return [self._members[row] for row in self.rows.values()]

    def remove(self, slot: int) -> None:
        """Make no more messages of a robot."""
        if (row := self.rows.pop(slot, None)) is not None:
            self.slots[row] = NO_SLOT

    def make(
        self, rows: IntArray, table: "MotionTable"
    ) -> Iterator[tuple[int, RecordedTopic, bytes]]:
        """Make the messages of some rows, (m,): stamp [ns], topic, bytes."""
        slots = self.slots[rows]
        times_ns, motions = table.times_ns[slots], table.motions[slots]
        if self.layout.has_odometry:
            self._odometry.fill(rows, motions[:, ODOMETRY_COLUMNS], times_ns)
            topics = [self._topics[row] for row in rows.tolist()]
            yield from zip(times_ns.tolist(), topics, self._odometry.payloads(rows), strict=True)
        if self._has_transforms[rows].any():
            poses = self._poses.find(motions, table.positions[slots])
            is_known, is_own = ~np.isnan(poses).any(axis=1), table.has_own_tf_rate[slots]
            self._note_lacking(rows[is_own | (~is_known & ~table.is_partial[slots])])
            numbers = np.flatnonzero(is_known & self._has_transforms[rows])
            made, times_ns = rows[numbers], times_ns[numbers]
            self._transforms.fill(made, poses[numbers], times_ns)
            topics = [self._tf_topics[row] for row in made.tolist()]
            payloads = self._transforms.payloads(made)
            yield from zip(times_ns.tolist(), topics, payloads, strict=True)

    def _note_lacking(self, rows: IntArray) -> None:
        """Leave the transforms of robots to themselves: with a rate of their own, or no joints."""
        rows = rows[self._has_transforms[rows]]
        self._has_transforms[rows] = False
        self.is_lacking |= len(rows) > 0
        for row in rows.tolist():
            self._members[row].single.add(self._members[row].robot.tf_key)


class MotionTable:
    """The newest odometry of each robot, a row each; the first is of no robot."""

    def __init__(self) -> None:
        self.slots: dict[str, int] = {}
        self._free: list[int] = []
        self.times_ns = np.full(1, NEVER_NS)
        """Stamp of the newest odometry in this epoch."""
        self.due_ns = np.full(1, NEVER_NS)
        """Simulation time from which on odometry has to be there; `NEVER_NS` = not yet known."""
        self._in_time_s = np.zeros(1)
        """Wall time at which odometry was last in time."""
        self.motions = np.zeros((1, STATE_COLUMNS))
        self.positions = np.zeros((1, 0))
        self.joint_counts = np.zeros(1, dtype=np.int64)
        self.is_fresh: BoolArray = np.zeros(1, dtype=np.bool_)
        """Whether odometry came since the last take."""
        self.is_missed: BoolArray = np.zeros(1, dtype=np.bool_)
        self.has_agent: BoolArray = np.zeros(1, dtype=np.bool_)
        self.is_partial: BoolArray = np.zeros(1, dtype=np.bool_)
        """Whether others of the same message are not known, so that its joints cannot be found."""
        self.has_own_tf_rate: BoolArray = np.zeros(1, dtype=np.bool_)
        self.unknown: set[str] = set()
        """Robots without a row whose odometry came."""

    def add_robot(self, robot: FleetRobot, now_s: float) -> int:
        """Give a robot a row."""
        if not self._free:
            self._grow()
        slot, joints = self._free.pop(), len(robot.model.joints)
        self._widen(joints)
        self.times_ns[slot] = self.due_ns[slot] = NEVER_NS
        self._in_time_s[slot] = now_s
        self.positions[slot] = np.nan
        self.joint_counts[slot] = joints
        self.is_fresh[slot] = self.is_missed[slot] = False
        self.has_agent[slot] = robot.has_agent
        self.slots[robot.entity] = slot
        self.unknown.discard(robot.entity)
        return slot

    def _grow(self) -> None:
        """Double the rows."""
        size = len(self.times_ns)
        self._free += range(2 * size - 1, size - 1, -1)
        self.times_ns, self.due_ns, self._in_time_s, self.joint_counts = (
            np.concatenate([one, one])
            for one in (self.times_ns, self.due_ns, self._in_time_s, self.joint_counts)
        )
        self.motions = np.concatenate([self.motions, self.motions])
        self.positions = np.concatenate([self.positions, self.positions])
        none = np.zeros(size, dtype=np.bool_)
        self.is_fresh, self.is_missed = (
            np.concatenate([one, none]) for one in (self.is_fresh, self.is_missed)
        )
        self.has_agent, self.is_partial, self.has_own_tf_rate = (
            np.concatenate([one, none])
            for one in (self.has_agent, self.is_partial, self.has_own_tf_rate)
        )

    def _widen(self, joints: int) -> None:
        lacking = joints - self.positions.shape[1]
        if lacking > 0:
            self.positions = np.pad(self.positions, ((0, 0), (0, lacking)), constant_values=np.nan)

    def remove(self, name: str) -> None:
        """Take no more of a robot."""
        self.unknown.discard(name)
        if (slot := self.slots.pop(name, None)) is not None:
            self.is_fresh[slot] = self.is_missed[slot] = self.has_agent[slot] = False
            self._free.append(slot)

    def expect(self, slot: int, now_s: float, *, has_agent: bool) -> None:
        """Note whether odometry of a robot is expected, from now on."""
        self.has_agent[slot] = has_agent
        self.is_missed[slot] = False
        self.due_ns[slot], self._in_time_s[slot] = NEVER_NS, now_s

    def begin_epoch(self) -> None:
        """Forget all odometry, as time begins again."""
        self.is_fresh[:] = False
        self.times_ns[:] = self.due_ns[:] = NEVER_NS

    def add(self, message: FleetOdometry, now_s: float) -> None:
        """Take a message; one with lengths or times that do not fit is left out."""
        count = len(message.entities)
        if len(message.motions) != 8 * STATE_COLUMNS * count or message.time_ns >= MAX_TIME_NS:
            return
        get = self.slots.get
        slots = np.array([get(name, NO_SLOT) for name in message.entities], dtype=np.int64)
        is_known = slots != NO_SLOT
        if not is_known.all():
            names = np.array(message.entities, dtype=object)[~is_known]
            self.unknown.update(names.tolist())
        rows = slots[is_known]
        motions = np.frombuffer(message.motions, dtype="<f8").reshape(count, STATE_COLUMNS)
        self.motions[rows] = motions[is_known]
        self.times_ns[rows] = message.time_ns
        self._in_time_s[rows] = now_s
        self.is_fresh[rows] = True
        self.is_partial[rows] = len(rows) < count
        self.has_own_tf_rate[rows] = message.has_own_tf_rate
        self._add_positions(message.joint_positions, slots)

    def _add_positions(self, packed: bytes, slots: IntArray) -> None:
        """Take joint positions; those of robots with unknown numbers of joints are not known."""
        rows = slots[slots != NO_SLOT]
        self.positions[rows] = np.nan
        if len(packed) % 8 or not len(rows):
            return
        numbers, counts = np.frombuffer(packed, dtype="<f8"), self.joint_counts[rows]
        widest = int(counts.max())
        if len(numbers) == widest * len(slots) and (counts == widest).all():
            is_known = slots != NO_SLOT
            self.positions[rows, :widest] = numbers.reshape(len(slots), widest)[is_known]
        elif len(rows) == len(slots) and len(numbers) == counts.sum():
            is_used = np.arange(self.positions.shape[1]) < counts[:, None]
            found = np.full(is_used.shape, np.nan)
            found[is_used] = numbers
            self.positions[rows] = found

    def find_missed(self, now_ns: int, now_s: float) -> None:
        """Find the robots with an agent whose odometry is late in simulation and in wall time."""
        is_new = (self.due_ns == NEVER_NS) | (self.due_ns > now_ns)
        self.due_ns[is_new] = now_ns
        newest_ns = np.maximum(self.times_ns, self.due_ns)
        is_late = self.has_agent & (now_ns > newest_ns + MISSED_NS)
        self._in_time_s[~is_late] = now_s
        self.is_missed |= is_late & (now_s > self._in_time_s + MISSED_S)


class FleetMessages:
    """Makes the messages of a fleet's robots; what agents do not send is subscribed to by robot."""

    def __init__(self, network: "Bus", world: str, selection: FleetSelection) -> None:
        """Subscribe to the agents, and find the robots.

        Args:
            network: Of the world.
            world: Its name.
            selection: Which topics are taken.
        """
        self._network, self._world, self._selection = network, world, selection
        subscription = network.subscribe_copying(
            FLEET_ODOMETRY.key(world, "*"), DEPTH, MAX_WAITING_BYTES
        )
        self._odometry = TopicReader(subscription, read_as(FleetOdometry))
        self._epoch: int | None = None
        self._early: deque[FleetOdometry] = deque(maxlen=MAX_EARLY)
        """Messages of other epochs than that of the clock."""
        self.clear()
        self._find_robots()

    def clear(self) -> None:
        """Find all robots again, as another world was loaded."""
        self._table = MotionTable()
        self._groups: list[_FleetGroup] = []
        self._robots: dict[str, _KnownRobot] = {}
        self._unread: dict[str, _KnownRobot] = {}
        """Robots whose topics have not replied."""
        self._is_complete = False
        """Whether the robots of the world were listed."""
        self._single: frozenset[str] = frozenset()
        self._has_changed = False
        """Whether `_single` has to be found again."""
        self._queried_s, self._period_s, self._checked_ns = NEVER_S, QUERY_PERIOD_S, 0

    def close(self) -> None:
        """End the subscription."""
        self._odometry.close()

    def collect(self, epoch: int) -> None:
        """See `RobotMessageSource`."""
        if time.monotonic() >= self._queried_s + self._period_s:
            self._find_robots()
        now_s = time.monotonic()
        if epoch != self._epoch:
            self._begin_epoch(epoch, now_s)
        for message in self._odometry.take():
            if message.epoch == epoch:
                self._table.add(message, now_s)
            else:
                self._early.append(message)

    def _begin_epoch(self, epoch: int, now_s: float) -> None:
        self._epoch = epoch
        self._table.begin_epoch()
        for message in self._early:
            if message.epoch == epoch:
                self._table.add(message, now_s)
        self._early.clear()

    def take(self) -> Iterator[tuple[int, RecordedTopic, bytes]]:
        """See `RobotMessageSource`."""
        table = self._table
        fresh = table.is_fresh & ~table.is_missed
        table.is_fresh = np.zeros_like(fresh)
        for group in self._groups:
            rows = np.flatnonzero(fresh[group.slots])
            if len(rows):
                yield from group.make(rows, table)

    def note_event(self, event: Event) -> None:
        """Follow what becomes of robots."""
        entity = event.entity
        if event.kind == "loaded":
            self.clear()
        elif event.kind == "deleted":
            self._forget(entity)
        elif event.kind in ("claimed", "released") and entity in self._robots:
            slot, has_agent = self._robots[entity].slot, event.kind == "claimed"
            self._table.expect(slot, time.monotonic(), has_agent=has_agent)
        elif event.kind == "claimed":
            self._table.unknown.add(entity)

    def find_single_keys(self, now_ns: int) -> AbstractSet[str]:
        """See `RobotMessageSource`."""
        table = self._table
        before = table.is_missed
        table.is_missed = before & ~table.is_fresh
        if not 0 <= now_ns - self._checked_ns < CHECK_NS:
            self._checked_ns = now_ns
            table.find_missed(now_ns, time.monotonic())
        self._has_changed |= not np.array_equal(before, table.is_missed)
        if self._has_changed or any(one.is_lacking for one in self._groups):
            self._single = frozenset(filter(self._is_selected, self._list_single()))
            self._has_changed = False
            for group in self._groups:
                group.is_lacking = False
        return self._single

    def _list_single(self) -> Iterator[str]:
        for one in self._robots.values():
            yield from one.robot.keys if self._table.is_missed[one.slot] else ()
            yield from one.single

    def _is_selected(self, key: str) -> bool:
        return any(keys.intersect(one, key) for one in self._selection.expressions)

    def _forget(self, entity: str) -> None:
        self._table.remove(entity)
        self._has_changed = True
        self._unread.pop(entity, None)
        if (known := self._robots.pop(entity, None)) is not None:
            for group in self._groups:
                group.remove(known.slot)
            self._groups = [one for one in self._groups if one.rows]

    def _find_robots(self) -> None:
        """Find new robots, and read the topics of those that have not replied.

        What fails is tried again in the next period.
        """
        budget_s = QUERY_BUDGET_S if self._is_complete else FIRST_BUDGET_S
        with suppress(*FAILURES):
            self._add_robots()
            if unread := self._list_unread():
                self._query(unread, budget_s)
        self._queried_s = time.monotonic()

    def _add_robots(self) -> None:
        """Add the robots of the world at first, and later those whose odometry came."""
        table, now_s = self._table, time.monotonic()
        if self._is_complete and not table.unknown:
            self._period_s = QUERY_PERIOD_S
            return
        found = self._get_models(tuple(table.unknown) if self._is_complete else ())
        self._is_complete = True
        new = [one for one in list_robots(found) if one.entity not in self._robots]
        self._period_s = QUERY_PERIOD_S if new else min(2 * self._period_s, MAX_QUERY_PERIOD_S)
        for robot in new:
            known = _KnownRobot(robot, table.add_robot(robot, now_s), set(robot.single_keys))
            self._robots[robot.entity] = known
            self._has_changed = True
            if robot.odometry_key and any(map(self._is_selected, robot.keys)):
                self._unread[robot.entity] = known
        table.unknown.clear()  # others come again if they are robots

    def _get_models(self, names: tuple[str, ...]) -> GetModelsResponse:
        """Get some models; all if there are many, or if one is of no entity (any more)."""
        names = names if len(names) <= MOST_NAMED else ()
        client = ServiceClient(self._network, self._world, CALL_TIMEOUT_S)
        try:
            return client.models(names)
        except ServiceError:
            return client.models()

    def _list_unread(self) -> list[_KnownRobot]:
        """List the robots that publish but have not replied; all at first."""
        times = self._table.times_ns
        return [
            one for one in self._unread.values() if not one.queries or times[one.slot] != NEVER_NS
        ]

    def _query(self, robots: Sequence[_KnownRobot], budget_s: float) -> None:
        """Query the last messages of robots, and make the groups of those that replied."""
        replies, is_complete = self._get_messages(robots, budget_s)
        groups: dict[_Layout, list[_KnownRobot]] = {}
        for one in robots:
            one.queries += 1
            one.replies.update({key: replies[key] for key in one.robot.keys if key in replies})
            is_last = one.queries >= MOST_QUERIES
            layout = self._read_replies(one, has_all=is_complete or is_last)
            if layout is not None:
                groups.setdefault(layout, []).append(one)
            elif is_last:
                one.single.update(one.robot.keys)
            if layout is not None or is_last:
                del self._unread[one.robot.entity]
        self._has_changed = True
        for layout, members in groups.items():
            self._add_group(layout, members)

    def _get_messages(
        self, robots: Sequence[_KnownRobot], budget_s: float
    ) -> tuple[dict[str, Sample], bool]:
        """Get the messages that are lacking; return whether all have replied in time."""
        wanted = [key for one in robots for key in one.robot.keys if key not in one.replies]
        if len(robots) > MOST_SINGLE:
            owners = [one.rpartition("/")[0] for one in self._selection.expressions]
            expressions = [f"{owner}/{suffix}" for suffix in SUFFIXES for owner in owners]
            wanted = [one for one in expressions if any(keys.intersect(one, key) for key in wanted)]
        deadline_s, replies = time.monotonic() + budget_s, {}
        for key in dict.fromkeys(wanted):
            if (left_s := deadline_s - time.monotonic()) > 0:
                replies.update({one.key: one for one in self._network.get(key, left_s)})
        return replies, time.monotonic() < deadline_s

    def _read_replies(self, one: _KnownRobot, *, has_all: bool) -> _Layout | None:
        """Read the last messages of a robot; None if it has to be queried again.

        Args:
            one: The robot.
            has_all: Whether it publishes none but those that have replied.
        """
        robot = one.robot
        has_tf = bool(robot.tf_key) and self._is_selected(robot.tf_key)
        sample, tf_sample = (one.replies.get(key) for key in (robot.odometry_key, robot.tf_key))
        if sample is None or (has_tf and tf_sample is None and not has_all):
            return None
        with suppress(MalformedPayload):
            odometry = decode(Odometry, sample.payload, sample.encoding)
            parts, transforms = None, TFMessage()
            if has_tf and tf_sample is not None:
                transforms = decode(TFMessage, tf_sample.payload, tf_sample.encoding)
                parts = find_transform_parts(transforms, odometry, robot.model)
            if has_tf and parts is None:
                one.single.add(robot.tf_key)
            topic = self._find_topic(sample)
            tf_topic = self._find_topic(tf_sample) if parts else None
            one.replies = {}
            one.templates = _Templates(topic, odometry, tf_topic, transforms)
            return _Layout(topic is not None, parts if tf_topic else None)
        return None

    def _find_topic(self, sample: Sample | None) -> RecordedTopic | None:
        if sample is None or not self._is_selected(sample.key):
            return None
        return self._selection.find_topic(sample)

    def _add_group(self, layout: _Layout, members: list[_KnownRobot]) -> None:
        """Add a group in which smaller ones are merged, so that a robot is moved few times."""
        for group in sorted(self._groups, key=lambda one: len(one.rows)):
            if group.layout == layout and len(group.rows) <= 2 * len(members):
                self._groups.remove(group)
                members = group.members + members
        self._groups.append(_FleetGroup(layout, members))
