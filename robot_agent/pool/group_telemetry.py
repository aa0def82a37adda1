"""Topics of a group: odometry, tf and joint states."""

import struct
from collections.abc import Callable, Iterator, Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto import message_paths
from zensim.proto.codec.cdr import encode
from zensim.proto.codec.cdr_batch import CdrBatch
from zensim.proto.codec.cdr_layout import HEADER_BYTES
from zensim.proto.fleet_topics.fleet_publisher import FleetTopicPublisher
from zensim.proto.fleet_topics.topic_members import NAMED, OTHERS, UNWANTED, TopicMember
from zensim.proto.joint_transforms import ODOMETRY, FramePoses
from zensim.proto.message_paths import list_tf_paths, list_tf_stamps
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Joint, Model
from zensim.proto.messages.standard_messages import TFMessage, TransformStamped
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.topic_catalog import JOINT_STATES, ODOM, TF, TopicSpec
from zensim.robot_agent import message_templates
from zensim.robot_agent.base_controller import find_motion_rates
from zensim.robot_agent.pool.group_bases import GroupBaseController
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.robot_rows import (
    FloatArray,
    GroupRateLimiter,
    IntArray,
    KeptRows,
    StateRows,
    find_index,
    intersect_rows,
    remap_flags,
    remap_ints,
    take_rows,
)
from zensim.robot_agent.robot_telemetry import prefix_frames
from zensim.robot_agent.topic_remapping import RobotTopicKeys

FindNumbers = Callable[[IntArray], FloatArray]
"""Finds the numbers of some rows' last messages, in the order of the paths; (m, numbers)."""
EMPTY_TRANSFORM = TransformStamped()
"""Stands for the transforms of other robots."""
COUNT_STRUCT = struct.Struct("<I")
FIRST_OFFSET = HEADER_BYTES + COUNT_STRUCT.size
LATER_OFFSET = len(encode(TFMessage((EMPTY_TRANSFORM,))))
CDR_HEADER = encode(TFMessage())[:HEADER_BYTES]
MAX_TF_MESSAGE_BYTES = 32768
"""Approximate limit: a message sent in fragments is lost with any of them."""
FindPublisher = Callable[[str, TopicSpec], FleetTopicPublisher]
"""Finds the publisher of a key pattern and topic."""


class GroupTopic:
    """A topic of each robot of a group; messages are filled only for subscribers."""

    def __init__(
        self,
        publisher: FleetTopicPublisher,
        *,
        numbers: FindNumbers,
        paths: Sequence[str],
        stamps: Sequence[str],
        rate_hz: float | None = None,
    ) -> None:
        """Create a topic without rows.

        Args:
            publisher: Publishes the messages.
            numbers: Finds the numbers of rows.
            paths: Of the numbers in a message.
            stamps: Paths of its `Time` fields.
            rate_hz: Maximum rate of a row; None = at every call, 0 = at every state.
        """
        self._rates = None if rate_hz is None else GroupRateLimiter(rate_hz)
        self.publisher = publisher
        self._numbers = numbers
        self._paths, self._stamps = paths, stamps
        self._batch = CdrBatch((), paths, stamps)
        self._members: list[TopicMember] = []
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._published_ns = np.zeros(0, dtype=np.int64)
        self._demand = np.zeros(0, dtype=np.int8)
        self._demand_version = -1
        self._next_row = 0
        """First row of the next turn, where rows share a budget."""

    def remap(
        self, members: Sequence[TopicMember], templates: Sequence[msgspec.Struct], before: IntArray
    ) -> None:
        """Set the robots and their messages.

        Args:
            members: One per row.
            templates: One per row, with any numbers.
            before: Former row of each, see `remap_floats`.
        """
        self._members = list(members)
        for row, member in enumerate(members):
            member.row = row
        self._batch = CdrBatch(templates, self._paths, self._stamps)
        self._demand_version = -1
        self.remap_rows(before)

    def remap_rows(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self._has_value = remap_flags(self._has_value, before)
        self._published_ns = remap_ints(self._published_ns, before)
        if self._rates is not None:
            self._rates.remap(before)

    def reset(self) -> None:
        """Forget all values; time may have gone back."""
        self._has_value[:] = False
        if self._rates is not None:
            self._rates.reset()

    def find_key(self, row: int) -> str:
        """Find the key of a row."""
        return self._members[row].key

    def due(self, rows: IntArray, time_ns: int) -> IntArray:
        """Find the rows that are due by the rate."""
        if self._rates is None or not len(rows):
            return rows
        found, _ = self._rates.open(time_ns)
        return intersect_rows(rows, found, len(self._has_value))

    def publish(self, rows: IntArray, time_ns: int) -> None:
        """Publish some rows."""
        if not len(rows):
            return
        at = find_index(rows, len(self._has_value))
        self._has_value[at] = True
        self._published_ns[at] = time_ns
        if not self.publisher.is_wanted:
            return
        rows = self._select_wanted(rows)
        if not len(rows):
            return
        self._fill(rows)
        members = self._members
        if len(rows) < len(members):
            members = [members[row] for row in rows.tolist()]
        self.publisher.put(members, self._batch.payloads(rows))

    def _select_wanted(self, rows: IntArray) -> IntArray:
        """Select the rows with subscribers; those with some by wildcard as the budget allows."""
        if (budget := self.publisher.budget) is None:
            return rows
        if self._demand_version != self.publisher.version:
            self._demand_version = self.publisher.version
            self._demand = self._find_demand()
        demand = self._demand[rows]
        named: IntArray = rows[demand == NAMED]
        others = rows[demand == OTHERS]
        if not len(others):
            return named
        if (count := budget.take(self.publisher, len(others))) < len(others):
            others = np.roll(others, -int(np.searchsorted(others, self._next_row)))[:count]
            self._next_row = int(others[-1]) + 1 if count else self._next_row
        wanted: IntArray = np.sort(np.concatenate([named, others]))
        return wanted

    def _find_demand(self) -> npt.NDArray[np.int8]:
        """Find who needs the messages of each row: `UNWANTED`, `NAMED` or `OTHERS`."""
        listed = self.publisher.list_demand()
        # The publisher has the members of other groups, too: few groups or many.
        if len(listed) > len(self._members):
            return np.array([listed.get(one, UNWANTED) for one in self._members], np.int8)
        demand = np.full(len(self._members), UNWANTED, np.int8)
        for member, needed_by in listed.items():
            if member.row < len(demand) and self._members[member.row] is member:
                demand[member.row] = needed_by
        return demand

    def payload(self, row: int) -> bytes | None:
        """See `LastValues`."""
        if not self._has_value[row]:
            return None
        self._fill(np.array([row]))
        return self._batch.payload(row)

    def _fill(self, rows: IntArray) -> None:
        self._batch.fill(rows, self._numbers(rows), self._published_ns[rows])


class TfMessageBatch:
    """CDR messages of the transforms of many rows, with an equal count per row."""

    def __init__(self, templates: Sequence[TFMessage]) -> None:
        """Encode a message per row, with any numbers."""
        self._count = len(templates[0].transforms) if templates else 0
        self._first = CdrBatch(templates, list_tf_paths(self._count), list_tf_stamps(self._count))
        shifted = [TFMessage((EMPTY_TRANSFORM, *one.transforms)) for one in templates]
        blank = len(list_tf_paths(1))
        self._later = CdrBatch(
            shifted, list_tf_paths(self._count + 1)[blank:], list_tf_stamps(self._count + 1)[1:]
        )

    def message(self, rows: IntArray, poses: FloatArray, times_ns: IntArray) -> bytes:
        """Write one message with the transforms of some rows, at least one.

        Args:
            rows: In the order of the message, without duplicates; (m,).
            poses: (m, 7 * transforms per row).
            times_ns: Stamps, (m,).
        """
        self._first.fill(rows[:1], poses[:1], times_ns[:1])
        self._later.fill(rows[1:], poses[1:], times_ns[1:])
        first = self._first.payload(int(rows[0]))
        parts = [
            first[:HEADER_BYTES],
            COUNT_STRUCT.pack(self._count * len(rows)),
            first[FIRST_OFFSET:],
        ]
        parts += [later[LATER_OFFSET:] for later in self._later.payloads(rows[1:])]
        return b"".join(parts)

    def size(self, row: int) -> int:
        """Find the size of a row [bytes]."""
        return len(self._later.payload(row)) - LATER_OFFSET


class GroupFramePoses:
    """Poses of a group's frames, as of when each row was due."""

    def __init__(self, group_key: GroupKey, bases: GroupBaseController) -> None:
        self._bases = bases
        rate_hz = find_motion_rates(group_key.drive)[2]
        self._limiters = None if rate_hz is None else GroupRateLimiter(rate_hz)
        self._moving = list(group_key.moving)
        base = [ODOMETRY] if group_key.drive.publish_odom_tf else []
        self._frames = FramePoses(
            [*base, *range(len(self._moving))],
            msgspec.msgpack.decode(group_key.geometry, type=tuple[Joint, ...]),
        )
        self._positions = KeptRows(group_key.joint_count)
        self._found: tuple[IntArray, FloatArray] | None = None

    def remap_rows(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self._found = None
        if self._limiters is not None:
            self._limiters.remap(before)
        self._positions.remap(before)

    def reset(self) -> None:
        """Forget the cached poses; time may have gone back."""
        self._found = None
        if self._limiters is not None:
            self._limiters.reset()

    def take(self, rows: IntArray, positions: FloatArray, time_ns: int) -> IntArray:
        """Take the joints of the rows that are due; return these rows.

        Args:
            rows: Rows with a new motion.
            positions: Of all joints [rad or m], (n, joint_count).
            time_ns: Simulation time.
        """
        self._found = None
        if len(rows) and self._limiters is not None:
            is_open, _ = self._limiters.open(time_ns)
            rows = intersect_rows(rows, is_open, len(positions))
        self._positions.keep(rows, positions)
        return rows

    def of(self, rows: IntArray) -> FloatArray:
        """Find the poses of some rows' frames, (m, 7 * frames); cached for the same rows."""
        if self._found is None or self._found[0] is not rows:
            motions = self._bases.find_motions(rows)
            positions = take_rows(self._positions.values, rows)[:, self._moving]
            self._found = rows, self._frames.find(motions, positions)
        return self._found[1]


class GroupTfTopic(GroupTopic):
    """Transforms on each robot's own topic, with frames as described."""

    def __init__(self, poses: GroupFramePoses, publisher: FleetTopicPublisher, count: int) -> None:
        """Create a topic with this count of transforms per robot."""
        super().__init__(
            publisher,
            numbers=poses.of,
            paths=message_paths.list_tf_paths(count),
            stamps=message_paths.list_tf_stamps(count),
        )


class SharedTfTopic:
    """Transforms of many robots on the shared topic, with prefixed frames."""

    def __init__(
        self, poses: GroupFramePoses, publisher: FleetTopicPublisher, node: RosNode | None
    ) -> None:
        """Declare the topic.

        Args:
            poses: Of the frames.
            publisher: Publishes the messages.
            node: ROS 2 node that publishes this topic only.
        """
        self._node = node
        self._poses = poses
        self._publisher = publisher
        self._member = TopicMember(TF.suffix, self, node=node)
        publisher.add(self._member)
        self._claims: Sequence[Claim] = ()
        self._batch: TfMessageBatch | None = None
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._published_ns = np.zeros(0, dtype=np.int64)

    def remap(self, claims: Sequence[Claim], before: IntArray) -> None:
        """Set the robots, one per row; for `before` see `remap_floats`."""
        self._claims, self._batch = claims, None
        self._has_value = remap_flags(self._has_value, before)
        self._published_ns = remap_ints(self._published_ns, before)

    def reset(self) -> None:
        """Forget all values; time may have gone back."""
        self._has_value[:] = False

    def publish(self, rows: IntArray, time_ns: int) -> None:
        """Publish the transforms of some rows."""
        if not len(rows):
            return
        at = find_index(rows, len(self._has_value))
        self._has_value[at] = True
        self._published_ns[at] = time_ns
        if self._publisher.is_wanted:
            for message in self._messages(rows):
                self._publisher.put((self._member,), (message,))

    def payload(self, row: int) -> bytes | None:  # noqa: ARG002 - of the protocol
        """Write the last transforms of all rows; see `LastValues`."""
        rows = np.flatnonzero(self._has_value)
        if not len(rows):
            return None
        return self._get_batch().message(rows, self._poses.of(rows), self._published_ns[rows])

    def close(self) -> None:
        """Undeclare the topic."""
        self._publisher.remove(self._member)
        if self._node is not None:
            self._node.close()

    def _messages(self, rows: IntArray) -> Iterator[bytes]:
        batch, poses, times_ns = self._get_batch(), self._poses.of(rows), self._published_ns[rows]
        most = max(1, MAX_TF_MESSAGE_BYTES // batch.size(int(rows[0])))
        for start in range(0, len(rows), most):
            part = slice(start, start + most)
            yield batch.message(rows[part], poses[part], times_ns[part])

    def _get_batch(self) -> TfMessageBatch:
        # Only for subscribers: robots of a fleet are claimed one by one.
        if self._batch is None:
            models = {id(one.model): one.model for one in self._claims}
            made = {key: message_templates.make_tf_template(one) for key, one in models.items()}
            self._batch = TfMessageBatch(
                [prefix_frames(made[id(one.model)], one.namespace) for one in self._claims]
            )
        return self._batch


class GroupOdometryTopic(GroupTopic):
    """Odometry of a group, at its own rate or with every motion."""

    def __init__(
        self, group_key: GroupKey, bases: GroupBaseController, find_publisher: FindPublisher
    ) -> None:
        super().__init__(
            find_publisher(group_key.patterns.odom, ODOM),
            numbers=bases.find_motions,
            paths=message_paths.ODOMETRY_PATHS,
            stamps=message_paths.HEADER_STAMP,
            rate_hz=find_motion_rates(group_key.drive)[1],
        )
        self.due_rows = np.zeros(0, dtype=np.int64)
        """Rows that were due at the last state."""

    def remap_rows(self, before: IntArray) -> None:
        """See `GroupTopic`."""
        super().remap_rows(before)
        self.due_rows = self.due_rows[:0]

    def publish(self, rows: IntArray, time_ns: int) -> None:
        """See `GroupTopic`."""
        self.due_rows = rows
        super().publish(rows, time_ns)


class GroupJointTopic(GroupTopic):
    """Joint states of a group, at their own rate."""

    def __init__(self, group_key: GroupKey, find_publisher: FindPublisher) -> None:
        count = len(group_key.published)
        super().__init__(
            find_publisher(group_key.patterns.joint_states, JOINT_STATES),
            numbers=self._find_states,
            paths=message_templates.list_joint_paths(count),
            stamps=message_paths.HEADER_STAMP,
        )
        self._limiters = GroupRateLimiter(group_key.joint_states_hz)
        self._published = list(group_key.published)
        self._joint_count = group_key.joint_count
        self._no_efforts = np.zeros((0, self._joint_count))
        self._columns = tuple(KeptRows(self._joint_count) for _ in range(3))
        """Positions, velocities and efforts of all joints."""

    def _find_states(self, rows: IntArray) -> FloatArray:
        published = self._published
        return np.hstack([take_rows(one.values, rows)[:, published] for one in self._columns])

    def remap_rows(self, before: IntArray) -> None:
        """See `GroupTopic`."""
        super().remap_rows(before)
        self._limiters.remap(before)
        for column in self._columns:
            column.remap(before)
        self._no_efforts = np.full((len(before), self._joint_count), np.nan)

    def reset(self) -> None:
        """See `GroupTopic`."""
        super().reset()
        self._limiters.reset()

    def publish_joints(self, state: StateRows) -> None:
        """Publish the joints of the rows that are due."""
        rows, _ = self._limiters.open(state.time_ns)
        if len(rows):
            efforts = self._no_efforts if state.efforts is None else state.efforts
            given = (state.positions, state.velocities, efforts)
            for kept, column in zip(self._columns, given, strict=True):
                kept.keep(rows, column)
            self.publish(rows, state.time_ns)


class GroupTelemetry:
    """The topics of one group, static ones apart."""

    def __init__(
        self,
        group_key: GroupKey,
        bases: GroupBaseController,
        find_publisher: FindPublisher,
        node: RosNode | None,
    ) -> None:
        """Declare the topics.

        Args:
            group_key: Of the robots.
            bases: Their motions.
            find_publisher: Finds the publishers of the topics.
            node: ROS 2 node that publishes the shared tf topic.
        """
        patterns = group_key.patterns
        self._published = group_key.published
        self.odometry = (
            GroupOdometryTopic(group_key, bases, find_publisher) if patterns.odom else None
        )
        self._poses = poses = GroupFramePoses(group_key, bases)
        self.transforms: GroupTfTopic | None = None
        self.shared: SharedTfTopic | None = None
        if patterns.tf:
            count = message_templates.count_transforms(group_key.drive, group_key.moving)
            self.transforms = GroupTfTopic(poses, find_publisher(patterns.tf, TF), count)
        if patterns.shared_tf:
            self.shared = SharedTfTopic(poses, find_publisher(patterns.shared_tf, TF), node)
        self.joints = GroupJointTopic(group_key, find_publisher) if patterns.joint_states else None

    @property
    def topics(self) -> tuple[GroupTopic, ...]:
        """Topics that each robot has, in the order of `list_keys` and `make_templates`."""
        found = (self.odometry, self.transforms, self.joints)
        return tuple(topic for topic in found if topic is not None)

    @property
    def wants_efforts(self) -> bool:
        """Whether joint states may have a subscriber."""
        return self.joints is not None and self.joints.publisher.is_wanted

    def list_keys(self, found: RobotTopicKeys) -> tuple[str, ...]:
        """List the keys of a robot, one per topic."""
        return tuple(key for key in (found.odom, found.tf, found.joint_states) if key)

    def make_templates(self, model: Model) -> Sequence[msgspec.Struct]:
        """Make the message templates of a model, one per topic."""
        made: list[msgspec.Struct] = []
        if self.odometry is not None:
            made.append(message_templates.make_odometry_template(model))
        if self.transforms is not None:
            made.append(message_templates.make_tf_template(model))
        if self.joints is not None:
            made.append(message_templates.make_joint_states_template(model, self._published))
        return made

    def remap_shared(self, claims: Sequence[Claim], before: IntArray) -> None:
        """Remap the rows of the shared tf topic, which are these robots."""
        self._poses.remap_rows(before)
        if self.shared is not None:
            self.shared.remap(claims, before)

    def reset(self) -> None:
        """Forget all values; time may have gone back."""
        self._poses.reset()
        for topic in self.topics:
            topic.reset()
        if self.shared is not None:
            self.shared.reset()

    def publish(self, rows: IntArray, state: StateRows) -> None:
        """Publish what is due; `rows` have a new motion."""
        time_ns = state.time_ns
        if self.odometry is not None:
            self.odometry.publish(self.odometry.due(rows, time_ns), time_ns)
        rows = self._poses.take(rows, state.positions, time_ns)
        if self.transforms is not None:
            self.transforms.publish(rows, time_ns)
        if self.shared is not None:
            self.shared.publish(rows, time_ns)
        if self.joints is not None:
            self.joints.publish_joints(state)

    def close(self) -> None:
        """Undeclare the shared tf topic; the others go with their robots."""
        if self.shared is not None:
            self.shared.close()
