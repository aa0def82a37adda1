"""Odometry and transforms of large fleets, from the messages of their agents.

An agent publishes the odometry of all its robots in few messages; see `FleetOdometry`. Each robot's
own messages are made of it here, with the bytes that the robot would publish: a query of its topics
gives their frames and covariances once, which never change.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import count
from typing import Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto import keys
from zensim.proto.codec.cdr_batch import CdrBatch, FloatArray, IntArray
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.joint_transforms import POSE_COLUMNS, JointTransforms
from zensim.proto.message_paths import (
    HEADER_STAMP,
    ODOMETRY_COLUMNS,
    ODOMETRY_PATHS,
    list_tf_paths,
    list_tf_stamps,
)
from zensim.proto.messages.agent_messages import STATE_COLUMNS, FleetOdometry
from zensim.proto.messages.model_messages import Joint, Model
from zensim.proto.messages.standard_messages import NANOSECONDS, Odometry, TFMessage
from zensim.proto.messages.telemetry_messages import Event, GetModelsRequest
from zensim.proto.network_protocols import CallingNetwork, Sample, Subscription
from zensim.proto.service_catalog import GET_MODELS
from zensim.proto.tf_joints import MOVABLE_KINDS
from zensim.proto.topic_catalog import FLEET_ODOMETRY
from zensim.recording.fleet_robots import (
    FAILURES,
    SUFFIXES,
    FleetRobot,
    FleetSelection,
    list_robots,
)
from zensim.recording.recorded_topics import RecordedTopic

DEPTH: Final = 4096
"""Messages of 64 KiB that wait: of 10,000 robots, some 20 a step."""
GET_TIMEOUT_S: Final = 0.5
QUERY_PERIOD_S: Final = 1.0
"""Wall time between two queries for robots that are new."""
MOST_SINGLE: Final = 16
"""New robots whose topics are queried one by one."""
MISSED_NS: Final = NANOSECONDS
"""Simulation time without odometry of a robot after which its own topics are subscribed to."""
CHECK_NS: Final = NANOSECONDS // 4
OLD_EPOCH_S: Final = 2.0
"""Wall time without a message of the newest epoch after which an older one is of a new server."""
NEVER_NS: Final = -1


class FleetNetwork(CallingNetwork, Protocol):
    """Network of a world."""

    def subscribe(self, key: str, depth: int = 1) -> Subscription:
        """Subscribe to a key expression, keeping the newest `depth` messages."""

    def get(self, key: str, timeout_s: float = 1.0) -> list[Sample]:
        """Get the last messages of a key expression."""


class _TransformParts(NamedTuple):
    """What the transforms of a robot are made of, in the order of its message."""

    columns: tuple[int, ...]
    """Joint of each transform; -1 = odometry."""
    joints: tuple[Joint, ...]


def find_transform_parts(
    transforms: TFMessage, odometry: Odometry, model: Model
) -> _TransformParts | None:
    """Find what a robot's transforms are made of.

    Returns:
        None if a transform is neither its odometry nor of one of its joints, or if transforms have
        another rate than odometry.
    """
    drive = model.drive
    if drive is None or not is_paced_alike(model):
        return None
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
        columns.append(-1 if edge == base else movable[edge])
    joints = tuple(model.joints[column] for column in columns if column >= 0)
    return _TransformParts(tuple(columns), joints)


def is_paced_alike(model: Model) -> bool:
    """Whether odometry and transforms of a robot are due at the same states."""
    drive = model.drive
    if drive is None or drive.tf_rate_hz is None:
        return True
    odometry_hz = drive.odometry_rate_hz
    return drive.tf_rate_hz == (drive.update_rate_hz if odometry_hz is None else odometry_hz)


_Layout = tuple[int, bool, tuple[int, ...] | None]
"""What robots of a group have in common: identity of the model, whether odometry is recorded,
columns of `_TransformParts`; None without transforms."""


class _FoundRobot(NamedTuple):
    """A robot whose topics replied."""

    robot: FleetRobot
    topic: RecordedTopic | None
    """Of odometry; None if it is not recorded."""
    odometry: Odometry
    tf_topic: RecordedTopic | None
    transforms: TFMessage
    parts: _TransformParts | None
    """None without transforms."""


class _FleetGroup:
    """Robots that were found at the same time, with equal models and topics."""

    def __init__(self, slots: IntArray, found: Sequence[_FoundRobot]) -> None:
        self.slots = slots
        self._topics = [one.topic for one in found if one.topic is not None]
        self._odometry = CdrBatch(
            [one.odometry for one in found if one.topic is not None],
            ODOMETRY_PATHS,
            HEADER_STAMP,
        )
        parts = found[0].parts or _TransformParts((), ())
        self._tf_topics = [one.tf_topic for one in found if one.tf_topic and one.parts]
        self._transforms = CdrBatch(
            [one.transforms for one in found if one.tf_topic and one.parts],
            list_tf_paths(len(parts.columns)),
            list_tf_stamps(len(parts.columns)),
        )
        self._columns = np.array(parts.columns, dtype=np.int64)
        self._joints = JointTransforms(parts.joints)
        self._lacking: set[int] = set()
        self.lacking_keys: list[str] = []
        """Of transforms whose joints are not known."""

    def make(
        self, rows: IntArray, motions: FloatArray, positions: FloatArray, times_ns: IntArray
    ) -> Iterator[tuple[int, RecordedTopic, bytes]]:
        """Make the messages of some rows: index into these, topic and bytes.

        Args:
            rows: Of this group, (m,).
            motions: (m, STATE_COLUMNS).
            positions: Of all joints, (m, joints); NaN where they are not known.
            times_ns: (m,).
        """
        if self._topics:
            self._odometry.fill(rows, motions[:, ODOMETRY_COLUMNS], times_ns)
            topics = [self._topics[row] for row in rows.tolist()]
            yield from zip(count(), topics, self._odometry.payloads(rows), strict=False)
        if self._tf_topics:
            poses = self._find_poses(motions, positions)
            is_known = ~np.isnan(poses).any(axis=1)
            self._note_lacking(rows[~is_known])
            rows = rows[is_known]
            self._transforms.fill(rows, poses[is_known], times_ns[is_known])
            topics = [self._tf_topics[row] for row in rows.tolist()]
            numbers = np.flatnonzero(is_known).tolist()
            yield from zip(numbers, topics, self._transforms.payloads(rows), strict=True)

    def _note_lacking(self, rows: IntArray) -> None:
        for row in rows.tolist():
            if row not in self._lacking:
                self._lacking.add(row)
                self.lacking_keys.append(self._tf_topics[row].name.lstrip("/"))

    def _find_poses(self, motions: FloatArray, positions: FloatArray) -> FloatArray:
        """Find the poses of transforms, (m, 7 * transforms)."""
        is_joint = self._columns >= 0
        found = np.empty((len(motions), len(self._columns), POSE_COLUMNS))
        found[:, is_joint] = self._joints.poses(positions[:, self._columns[is_joint]])
        found[:, ~is_joint] = motions[:, None, :POSE_COLUMNS]
        return found.reshape(len(motions), -1)


class MotionTable:
    """The newest odometry of each robot, a row each."""

    def __init__(self) -> None:
        self.slots: dict[str, int] = {}
        self.times_ns = np.zeros(0, dtype=np.int64)
        self.motions = np.zeros((0, STATE_COLUMNS))
        self.positions = np.zeros((0, 0))
        self.joint_counts = np.zeros(0, dtype=np.int64)
        self.is_fresh: npt.NDArray[np.bool_] = np.zeros(0, dtype=np.bool_)
        self.unknown: set[str] = set()
        """Robots without a row whose odometry came."""
        self.epoch = 0
        """Of the rows."""
        self._newest_s = 0.0

    def add_robots(self, names: Sequence[str], joint_counts: Sequence[int]) -> IntArray:
        """Add rows of new robots; return them."""
        before, count = len(self.times_ns), len(names)
        widest = max([self.positions.shape[1], *joint_counts])
        positions = np.full((before + count, widest), np.nan)
        positions[:before, : self.positions.shape[1]] = self.positions
        self.positions = positions
        self.motions = np.concatenate([self.motions, np.zeros((count, STATE_COLUMNS))])
        self.times_ns = np.concatenate([self.times_ns, np.full(count, NEVER_NS)])
        self.joint_counts = np.concatenate([self.joint_counts, np.array(joint_counts, np.int64)])
        self.is_fresh = np.concatenate([self.is_fresh, np.zeros(count, dtype=np.bool_)])
        added = np.arange(before, before + count)
        self.slots.update(zip(names, added.tolist(), strict=True))
        self.unknown.difference_update(names)
        return added

    def remove(self, name: str) -> None:
        """Take no more of a robot."""
        if (slot := self.slots.pop(name, None)) is not None:
            self.is_fresh[slot] = False

    def add(self, message: FleetOdometry, now_s: float) -> None:
        """Take a message; one with lengths that do not fit is left out."""
        count = len(message.entities)
        if len(message.motions) != 8 * STATE_COLUMNS * count or not self._is_of_now(message, now_s):
            return
        get = self.slots.get
        slots = np.array([get(name, NEVER_NS) for name in message.entities], dtype=np.int64)
        is_known = slots >= 0
        if not is_known.all():
            names = np.array(message.entities, dtype=object)[~is_known]
            self.unknown.update(names.tolist())
        rows = slots[is_known]
        motions = np.frombuffer(message.motions, dtype="<f8").reshape(count, STATE_COLUMNS)
        self.motions[rows] = motions[is_known]
        self.times_ns[rows] = message.time_ns
        self.is_fresh[rows] = True
        self._add_positions(message.joint_positions, slots)

    def _is_of_now(self, message: FleetOdometry, now_s: float) -> bool:
        if message.epoch < self.epoch and now_s < self._newest_s + OLD_EPOCH_S:
            return False
        if message.epoch != self.epoch:
            # Time has begun again.
            self.is_fresh[:] = False
            self.times_ns[:] = NEVER_NS
        self.epoch, self._newest_s = message.epoch, now_s
        return True

    def _add_positions(self, packed: bytes, slots: IntArray) -> None:
        """Take joint positions; those of robots with unknown numbers of joints are not known."""
        rows = slots[slots >= 0]
        self.positions[rows] = np.nan
        if len(packed) % 8 or not len(rows):
            return
        numbers, counts = np.frombuffer(packed, dtype="<f8"), self.joint_counts[rows]
        widest = int(counts.max())
        if len(numbers) == widest * len(slots) and (counts == widest).all():
            self.positions[rows, :widest] = numbers.reshape(len(slots), widest)[slots >= 0]
        elif len(rows) == len(slots) and len(numbers) == counts.sum():
            is_used = np.arange(self.positions.shape[1]) < counts[:, None]
            found = np.full(is_used.shape, np.nan)
            found[is_used] = numbers
            self.positions[rows] = found


class FleetMessages:
    """Makes the messages of a fleet's robots; what agents do not send is subscribed to by robot."""

    def __init__(self, network: FleetNetwork, world: str, selection: FleetSelection) -> None:
        """Subscribe to the agents, and find the robots.

        Args:
            network: Of the world.
            world: Its name.
            selection: Which topics are taken.
        """
        self._network, self._world, self._selection = network, world, selection
        self._subscription = network.subscribe(FLEET_ODOMETRY.key(world, "*"), DEPTH)
        self._robots: dict[str, FleetRobot] = {}
        self._due_ns: dict[str, int] = {}
        """Simulation time of each robot from which on its odometry has to be there."""
        self._single: set[str] = set()
        """Robots whose own topics are subscribed to."""
        self._single_keys: list[str] = []
        self._queried_s, self._checked_ns = 0.0, 0
        self.clear()

    def clear(self) -> None:
        """Find all robots again, as another world was loaded."""
        self._table = MotionTable()
        self._groups: list[_FleetGroup] = []
        self._robots.clear()
        self._due_ns.clear()
        self._find_robots(())

    def close(self) -> None:
        """End the subscription."""
        self._subscription.close()

    def collect(self) -> None:
        """Take what has come, so that the queue does not fill."""
        now_s, table = time.monotonic(), self._table
        for sample in self._subscription.take():
            with suppress(MalformedPayload):
                table.add(decode(FleetOdometry, sample.payload, sample.encoding), now_s)
        table.unknown -= self._single
        if table.unknown and now_s >= self._queried_s + QUERY_PERIOD_S:
            self._find_robots(tuple(table.unknown))

    def take(self, epoch: int) -> Iterator[tuple[int, RecordedTopic, bytes]]:
        """See `RobotMessageSource`."""
        table = self._table
        if table.epoch != epoch:
            return
        fresh, table.is_fresh = table.is_fresh, np.zeros_like(table.is_fresh)
        for group in self._groups:
            rows = np.flatnonzero(fresh[group.slots])
            if not len(rows):
                continue
            slots = group.slots[rows]
            times = table.times_ns[slots]
            made = group.make(rows, table.motions[slots], table.positions[slots], times)
            stamps = times.tolist()
            yield from ((stamps[number], topic, payload) for number, topic, payload in made)

    def note_event(self, event: Event) -> None:
        """Follow what becomes of robots."""
        entity = event.entity
        if event.kind == "loaded":
            self.clear()
        elif event.kind == "deleted":
            self._forget(entity)
            self._single.discard(entity)
        elif event.kind in ("claimed", "released") and entity in self._robots:
            has_agent = event.kind == "claimed"
            self._robots[entity] = self._robots[entity]._replace(has_agent=has_agent)
            self._due_ns.pop(entity, None)
        elif event.kind == "claimed":
            self._table.unknown.add(entity)

    def take_single_keys(self, now_ns: int) -> list[str]:
        """Take the keys that are to be subscribed to, since agents do not send their messages.

        They are those of robots with an agent whose odometry has not come for a second, as of an
        agent of another program or with a fault, and transforms that odometry does not give.
        """
        if not 0 <= now_ns - self._checked_ns < CHECK_NS:
            self._checked_ns = now_ns
            self._find_missed(now_ns)
        for group in self._groups:
            self._single_keys += group.lacking_keys
            group.lacking_keys = []
        taken, self._single_keys = self._single_keys, []
        return [one for one in taken if self._is_selected(one)]

    def _find_missed(self, now_ns: int) -> None:
        for entity, robot in tuple(self._robots.items()):
            slot = self._table.slots.get(entity)
            newest_ns = NEVER_NS if slot is None else int(self._table.times_ns[slot])
            expected_ns = max(newest_ns, self._due_ns.setdefault(entity, now_ns))
            if robot.has_agent and now_ns > expected_ns + MISSED_NS:
                self._single_keys += [keys.robot(robot.namespace, one) for one in SUFFIXES]
                self._forget(entity)
                self._single.add(entity)

    def _is_selected(self, key: str) -> bool:
        return any(keys.intersect(one, key) for one in self._selection.expressions)

    def _forget(self, entity: str) -> None:
        self._table.remove(entity)
        self._robots.pop(entity, None)
        self._due_ns.pop(entity, None)

    def _find_robots(self, names: tuple[str, ...]) -> None:
        """Find new robots; all if no names are given."""
        self._queried_s = time.monotonic()
        request = GetModelsRequest(names)
        try:
            found = self._network.call(GET_MODELS, request, world=self._world)
            new = [one for one in list_robots(found) if one.entity not in self._table.slots]
            replies = {sample.key: sample for sample in self._query(new)} if new else {}
        except FAILURES:
            return  # they are found later, as their odometry is unknown
        self._table.unknown.difference_update(names)
        new = [one for one in new if one.entity not in self._single]
        self._robots.update({one.entity: one for one in new})
        groups: dict[_Layout, list[_FoundRobot]] = {}
        for robot in new:
            for layout, one in self._read_replies(robot, replies):
                groups.setdefault(layout, []).append(one)
        self._groups += [self._make_group(one) for one in groups.values()]

    def _query(self, robots: Sequence[FleetRobot]) -> Iterator[Sample]:
        """Query the last messages of robots."""
        if len(robots) <= MOST_SINGLE:
            owners = [one.namespace for one in robots]
        else:
            owners = [one.rpartition("/")[0] for one in self._selection.expressions]
        for owner in dict.fromkeys(owners):
            for suffix in SUFFIXES:
                yield from self._network.get(f"{owner}/{suffix}", GET_TIMEOUT_S)

    def _read_replies(
        self, robot: FleetRobot, replies: Mapping[str, Sample]
    ) -> Iterator[tuple[_Layout, _FoundRobot]]:
        """Read the last messages of a robot; without odometry it is found later."""
        samples = [replies.get(keys.robot(robot.namespace, one)) for one in SUFFIXES]
        with suppress(MalformedPayload):
            if samples[0] is None:
                return
            odometry = decode(Odometry, samples[0].payload, samples[0].encoding)
            topic, tf_topic = (self._find_topic(one) for one in samples)
            parts, transforms = None, TFMessage()
            if samples[1] is not None and tf_topic is not None:
                transforms = decode(TFMessage, samples[1].payload, samples[1].encoding)
                parts = find_transform_parts(transforms, odometry, robot.model)
                if parts is None:
                    self._single_keys.append(samples[1].key)
            layout = id(robot.model), topic is not None, parts and parts.columns
            yield layout, _FoundRobot(robot, topic, odometry, tf_topic, transforms, parts)

    def _find_topic(self, sample: Sample | None) -> RecordedTopic | None:
        return None if sample is None else self._selection.find_topic(sample)

    def _make_group(self, found: Sequence[_FoundRobot]) -> _FleetGroup:
        names = [one.robot.entity for one in found]
        slots = self._table.add_robots(names, [len(one.robot.model.joints) for one in found])
        return _FleetGroup(slots, found)
