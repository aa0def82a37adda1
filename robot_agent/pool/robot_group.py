"""A group of equal robots with an array row each, and where rows stand in drive states and commands."""

import struct
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
from zensim.robot_agent.pool.group_key import GroupKey, RobotTopicKeys
from zensim.robot_agent.pool.group_telemetry import FindPublisher, GroupTelemetry
from zensim.robot_agent.pool.robot_rows import NEW_ROW, FloatArray, IntArray


@dataclass(eq=False)
class GroupMember:
    """One robot of a squad."""

    claim: Claim
    kind: GroupKey
    topics: RobotTopicKeys
    row: int = NEW_ROW
    """In its squad."""
    place: int = NEW_ROW
    """In its pool."""
    lines: tuple[TopicMember, ...] = ()
    constants: tuple[TopicMember, ...] = ()
    templates: Sequence[msgspec.Struct] = ()
    """A message a line."""
    shared_tf: TFMessage | None = None
    """What it has on the topic that all share."""
    node: RosNode | None = None
    """In ROS 2's graph."""


@dataclass(frozen=True)
class PoolDriveState:
    """What one drive state says, in arrays; flat where robots differ in how much there is."""

    time_ns: int
    base: FloatArray
    """(n, STATE_COLUMNS)."""
    positions: FloatArray
    velocities: FloatArray
    twists: FloatArray
    """(n, 6)."""


@dataclass(frozen=True)
class GroupSlots:
    """Where the rows of a squad stand in the arrays of its pool."""

    places: IntArray
    """(n,)."""
    joints: IntArray
    """(n, joint_count)."""
    targets: IntArray
    """(n, target_count)."""


@dataclass(frozen=True)
class _DueTelemetry:
    """What `tell` has to tell."""

    rows: IntArray
    positions: FloatArray
    velocities: FloatArray
    time_ns: int


class RobotGroup:
    """Turns states into targets, then into telemetry."""

    def __init__(
        self, kind: GroupKey, find_publisher: FindPublisher, node: RosNode | None = None
    ) -> None:
        self._kind = kind
        self._bases = GroupBaseController(kind)
        self._telemetry = GroupTelemetry(kind, self._bases, find_publisher, node)
        self._slots: GroupSlots | None = None
        self._due: _DueTelemetry | None = None

    def remap(self, members: Sequence[GroupMember], seats: GroupSlots) -> None:
        """Take the robots as they are now, and where they stand."""
        before = np.array([member.row for member in members], dtype=np.int64)
        self._slots, self._due = seats, None
        self._bases.remap(before)
        for row, member in enumerate(members):
            member.row = row
            if not member.lines:
                member.lines = self._lines(member)
        self._remap_topics(members, before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self._due = None
        self._bases.reset()
        self._telemetry.reset()

    def advance(self, state: PoolDriveState, targets: FloatArray) -> None:
        """Take a state; write the targets of its robots into those of the pool."""
        if (seats := self._slots) is None:
            return
        positions, velocities = state.positions[seats.joints], state.velocities[seats.joints]
        rows = self._bases.update(
            state.time_ns,
            base=state.base[seats.places],
            positions=positions,
            velocities=velocities,
            twists=state.twists[seats.places],
        )
        targets[seats.targets] = self._bases.targets
        self._due = _DueTelemetry(rows, positions, velocities, state.time_ns)

    def publish(self) -> None:
        """Publish what the last state made due."""
        if (due := self._due) is not None:
            self._due = None
            self._telemetry.publish(
                due.rows, positions=due.positions, velocities=due.velocities, time_ns=due.time_ns
            )

    def release(self, member: GroupMember) -> None:
        """Withdraw what a robot tells."""
        for topic, line in zip(self._telemetry.topics, member.lines, strict=False):
            topic.outlet.remove(line)
        member.lines = ()

    def close(self) -> None:
        """Withdraw what its robots share; they have been dismissed, or are in other squads."""
        self._telemetry.close()

    def _lines(self, member: GroupMember) -> tuple[TopicMember, ...]:
        named = self._telemetry.list_keys(member.topics)
        lines = []
        for topic, key in zip(self._telemetry.topics, named, strict=True):
            lines.append(TopicMember(key, topic, node=member.node))
            topic.outlet.add(lines[-1])
        return tuple(lines)

    def _remap_topics(self, members: Sequence[GroupMember], before: IntArray) -> None:
        new = [member for member in members if not member.templates]
        models = {id(one.claim.model): one.claim.model for one in new}
        written = {key: self._telemetry.make_templates(model) for key, model in models.items()}
        for one in new:
            one.templates = written[id(one.claim.model)]
            one.shared_tf = self._telemetry.make_shared_template(
                one.claim.model, one.claim.namespace
            )
        for number, topic in enumerate(self._telemetry.topics):
            topic.remap(
                [member.lines[number] for member in members],
                [member.templates[number] for member in members],
                before,
            )
        shared = [one.shared_tf for one in members if one.shared_tf is not None]
        self._telemetry.remap_shared(shared, before)


FLOAT_BYTES = 8


class PoolStateLayout:
    """Robots in the order of a state's claims, and where their joints and targets begin."""

    def __init__(self, joint_counts: Sequence[int], target_counts: Sequence[int]) -> None:
        self._joints = np.concatenate([[0], np.cumsum(joint_counts)]).astype(np.int64)
        self._targets = np.concatenate([[0], np.cumsum(target_counts)]).astype(np.int64)

    @property
    def target_total(self) -> int:
        """How many numbers a command has."""
        return int(self._targets[-1])

    def find_group_slots(self, places: Sequence[int]) -> GroupSlots:
        """Find the seats of robots that all have as many joints and targets."""
        at = np.array(places, dtype=np.int64)
        joints, targets = self._joints, self._targets
        return GroupSlots(
            at,
            joints[at, None] + np.arange(joints[at[0] + 1] - joints[at[0]]),
            targets[at, None] + np.arange(targets[at[0] + 1] - targets[at[0]]),
        )

    def find_slices(self, place: int) -> tuple[slice, slice]:
        """Find where the joints and the targets of one robot are."""
        joints, targets = self._joints[place : place + 2], self._targets[place : place + 2]
        return slice(*joints.tolist()), slice(*targets.tolist())

    def read(self, state: DriveState, twists: FloatArray) -> PoolDriveState:
        """Lay a state out in arrays.

        Raises:
            MalformedPayload: It has not the numbers that its claims call for.
        """
        rows, joints = len(self._joints) - 1, int(self._joints[-1])
        return PoolDriveState(
            state.time_ns,
            _unpack_floats(state.base, rows * STATE_COLUMNS).reshape(rows, STATE_COLUMNS),
            _unpack_floats(state.joint_positions, joints),
            _unpack_floats(state.joint_velocities, joints),
            twists,
        )


def unpack_claims(claims: bytes) -> list[int]:
    """Read the claims of a state.

    Raises:
        MalformedPayload: They are not whole numbers of 4 bytes.
    """
    if len(claims) % 4:
        raise MalformedPayload(f"{len(claims)} bytes of claims; each has 4")
    return list(struct.unpack(f"<{len(claims) // 4}I", claims))


def _unpack_floats(numbers: bytes, count: int) -> FloatArray:
    if len(numbers) != count * FLOAT_BYTES:
        raise MalformedPayload(
            f"drive state does not fit its claims: {len(numbers)} bytes for {count} numbers"
        )
    return np.frombuffer(numbers, dtype="<f8")
