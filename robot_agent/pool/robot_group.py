"""A group of equal robots with an array row each, and their places in states and commands."""

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim, DriveState
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.ros2.ros_graph import RosNode
from zensim.robot_agent.pool.fleet_publisher import TopicMember
from zensim.robot_agent.pool.group_bases import GroupBaseController
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.pool.group_telemetry import FindPublisher, GroupTelemetry
from zensim.robot_agent.pool.robot_rows import NEW_ROW, FloatArray, IntArray
from zensim.robot_agent.topic_remapping import RobotTopicKeys


@dataclass(eq=False)
class GroupMember:
    """One robot of a group."""

    claim: Claim
    group_key: GroupKey
    topic_keys: RobotTopicKeys
    row: int = NEW_ROW
    """In its group."""
    place: int = NEW_ROW
    """In its pool."""
    topics: tuple[TopicMember, ...] = ()
    static_topics: tuple[TopicMember, ...] = ()
    templates: Sequence[msgspec.Struct] = ()
    """One per topic."""
    shared_tf: TFMessage | None = None
    """Its transforms on the shared topic."""
    node: RosNode | None = None
    """In the ROS 2 graph."""


@dataclass(frozen=True)
class PoolDriveState:
    """A drive state in arrays; flat where robots differ in the count of numbers."""

    time_ns: int
    base: FloatArray
    """(n, STATE_COLUMNS)."""
    positions: FloatArray
    velocities: FloatArray
    twists: FloatArray
    """(n, 6)."""


@dataclass(frozen=True)
class GroupSlots:
    """Indices of a group's rows in the arrays of its pool."""

    places: IntArray
    """(n,)."""
    joints: IntArray
    """(n, joint_count)."""
    targets: IntArray
    """(n, target_count)."""


@dataclass(frozen=True)
class _DueTelemetry:
    """Telemetry that is due at the last state."""

    rows: IntArray
    positions: FloatArray
    velocities: FloatArray
    time_ns: int


class RobotGroup:
    """States of equal robots to targets and telemetry."""

    def __init__(
        self, group_key: GroupKey, find_publisher: FindPublisher, node: RosNode | None = None
    ) -> None:
        self._bases = GroupBaseController(group_key)
        self._telemetry = GroupTelemetry(group_key, self._bases, find_publisher, node)
        self._slots: GroupSlots | None = None
        self._due: _DueTelemetry | None = None

    def remap(self, members: Sequence[GroupMember], slots: GroupSlots) -> None:
        """Set the robots, one per row, and their indices in the pool."""
        before = np.array([member.row for member in members], dtype=np.int64)
        self._slots, self._due = slots, None
        self._bases.remap(before)
        for row, member in enumerate(members):
            member.row = row
            if not member.topics:
                member.topics = self._declare_topics(member)
        self._remap_topics(members, before)

    def reset(self) -> None:
        """Reset all robots; time may have gone back."""
        self._due = None
        self._bases.reset()
        self._telemetry.reset()

    def advance(self, state: PoolDriveState, targets: FloatArray) -> None:
        """Take a state; write the targets of its robots into those of the pool."""
        if (slots := self._slots) is None:
            return
        positions, velocities = state.positions[slots.joints], state.velocities[slots.joints]
        rows = self._bases.update(
            state.time_ns,
            base=state.base[slots.places],
            positions=positions,
            velocities=velocities,
            twists=state.twists[slots.places],
        )
        targets[slots.targets] = self._bases.targets
        self._due = _DueTelemetry(rows, positions, velocities, state.time_ns)

    def publish(self) -> None:
        """Publish what is due at the last state."""
        if (due := self._due) is not None:
            self._due = None
            self._telemetry.publish(
                due.rows, positions=due.positions, velocities=due.velocities, time_ns=due.time_ns
            )

    def release(self, member: GroupMember) -> None:
        """Undeclare a robot's topics."""
        for topic, topic_member in zip(self._telemetry.topics, member.topics, strict=False):
            topic.publisher.remove(topic_member)
        member.topics = ()

    def close(self) -> None:
        """Undeclare the shared topic; robots were released, or are in other groups."""
        self._telemetry.close()

    def _declare_topics(self, member: GroupMember) -> tuple[TopicMember, ...]:
        found = []
        listed = self._telemetry.list_keys(member.topic_keys)
        for topic, key in zip(self._telemetry.topics, listed, strict=True):
            found.append(TopicMember(key, topic, node=member.node))
            topic.publisher.add(found[-1])
        return tuple(found)

    def _remap_topics(self, members: Sequence[GroupMember], before: IntArray) -> None:
        new = [member for member in members if not member.templates]
        models = {id(one.claim.model): one.claim.model for one in new}
        templates = {key: self._telemetry.make_templates(model) for key, model in models.items()}
        for one in new:
            one.templates = templates[id(one.claim.model)]
            one.shared_tf = self._telemetry.make_shared_template(
                one.claim.model, one.claim.namespace
            )
        for number, topic in enumerate(self._telemetry.topics):
            topic.remap(
                [member.topics[number] for member in members],
                [member.templates[number] for member in members],
                before,
            )
        shared = [one.shared_tf for one in members if one.shared_tf is not None]
        self._telemetry.remap_shared(shared, before)


FLOAT_BYTES = 8


class PoolStateLayout:
    """Robots in the order of a state's claims, and the start of their joints and targets."""

    def __init__(self, joint_counts: Sequence[int], target_counts: Sequence[int]) -> None:
        self._joints = np.concatenate([[0], np.cumsum(joint_counts)]).astype(np.int64)
        self._targets = np.concatenate([[0], np.cumsum(target_counts)]).astype(np.int64)

    @property
    def target_total(self) -> int:
        """Count of numbers in a command."""
        return int(self._targets[-1])

    def find_group_slots(self, places: Sequence[int]) -> GroupSlots:
        """Find the indices of robots with equal counts of joints and targets."""
        at = np.array(places, dtype=np.int64)
        joints, targets = self._joints, self._targets
        return GroupSlots(
            at,
            joints[at, None] + np.arange(joints[at[0] + 1] - joints[at[0]]),
            targets[at, None] + np.arange(targets[at[0] + 1] - targets[at[0]]),
        )

    def find_slices(self, place: int) -> tuple[slice, slice]:
        """Find the joints and the targets of one robot."""
        joints, targets = self._joints[place : place + 2], self._targets[place : place + 2]
        return slice(*joints.tolist()), slice(*targets.tolist())

    def read(self, state: DriveState, twists: FloatArray) -> PoolDriveState:
        """Unpack a state into arrays.

        Raises:
            MalformedPayload: The count of numbers does not match the claims.
        """
        rows, joints = len(self._joints) - 1, int(self._joints[-1])
        return PoolDriveState(
            state.time_ns,
            _unpack_floats(state.base, rows * STATE_COLUMNS).reshape(rows, STATE_COLUMNS),
            _unpack_floats(state.joint_positions, joints),
            _unpack_floats(state.joint_velocities, joints),
            twists,
        )


def _unpack_floats(numbers: bytes, count: int) -> FloatArray:
    if len(numbers) != count * FLOAT_BYTES:
        raise MalformedPayload(
            f"drive state does not fit its claims: {len(numbers)} bytes for {count} numbers"
        )
    return np.frombuffer(numbers, dtype="<f8")
