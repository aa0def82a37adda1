"""tf of a group: joint and odometry transforms in arrays, one message per robot or one for all on /tf."""

import struct
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from zensim.proto.codec.cdr import encode
from zensim.proto.codec.cdr_layout import HEADER_BYTES
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.messages.model_messages import Joint
from zensim.proto.messages.standard_messages import TFMessage, TransformStamped
from zensim.proto.rigid_transforms import multiply, normalize, rotate, rotate_about
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.topic_catalog import TF
from zensim.robot_agent import message_templates
from zensim.robot_agent.base_controller import find_motion_rates
from zensim.robot_agent.message_templates import list_tf_paths, list_tf_stamps
from zensim.robot_agent.pool.fleet_publisher import FleetTopicPublisher, TopicMember
from zensim.robot_agent.pool.group_bases import GroupBaseController
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.pool.group_topic import CdrBatch, GroupTopic
from zensim.robot_agent.pool.robot_rows import (
    FloatArray,
    GroupRateLimiter,
    IntArray,
    remap_flags,
    remap_floats,
    remap_ints,
)

POSE_COLUMNS = 7


class JointTransforms:
    """Transforms of some joints at any positions, as `frames.MovingJoint` has them."""

    def __init__(self, joints: Sequence[Joint]) -> None:
        """Take the joints.

        Args:
            joints: Those that move.
        """
        self.count = len(joints)
        self._at = np.array([joint.origin.position for joint in joints]).reshape(-1, 3)
        self._turned = np.array([joint.origin.orientation for joint in joints]).reshape(-1, 4)
        self._axes = np.array([normalize(joint.axis) for joint in joints]).reshape(-1, 3)
        slides = np.array([joint.kind == "prismatic" for joint in joints], dtype=np.bool_)
        self._slides = np.flatnonzero(slides)
        self._turns = np.flatnonzero(~slides)

    def poses(self, positions: FloatArray) -> FloatArray:
        """Find poses (n, count, 7) of children in their parents.

        Args:
            positions: Of the joints [rad or m], (n, count).
        """
        found = np.empty((*positions.shape, POSE_COLUMNS))
        found[..., :3] = self._at
        found[..., 3:] = self._turned
        turns, slides = self._turns, self._slides
        if len(turns):
            x, y, z = self._axes[turns].T
            turn = rotate_about((x, y, z), positions[:, turns], ARRAY_MATH)
            ox, oy, oz, ow = self._turned[turns].T
            found[:, turns, 3:] = np.stack(multiply((ox, oy, oz, ow), turn), axis=-1)
        if len(slides):
            ox, oy, oz, ow = self._turned[slides].T
            shift = self._axes[slides] * positions[:, slides, None]
            moved = rotate((ox, oy, oz, ow), (shift[..., 0], shift[..., 1], shift[..., 2]))
            found[:, slides, :3] += np.stack(moved, axis=-1)
        return found


EMPTY_TRANSFORM = TransformStamped()
"""Stands for the transforms of others."""
COUNT_STRUCT = struct.Struct("<I")
FIRST_OFFSET = HEADER_BYTES + COUNT_STRUCT.size
LATER_OFFSET = len(encode(TFMessage((EMPTY_TRANSFORM,))))


class TfMessageBatch:
    """Transforms of a row each, as many in each row."""

    def __init__(self, templates: Sequence[TFMessage]) -> None:
        """Write the messages, one a row, with any numbers."""
        self._count = len(templates[0].transforms) if templates else 0
        self._first = CdrBatch(templates, list_tf_paths(self._count), list_tf_stamps(self._count))
        shifted = [TFMessage((EMPTY_TRANSFORM, *one.transforms)) for one in templates]
        blank = len(list_tf_paths(1))
        self._later = CdrBatch(
            shifted, list_tf_paths(self._count + 1)[blank:], list_tf_stamps(self._count + 1)[1:]
        )

    def message(self, rows: IntArray, poses: FloatArray, times_ns: IntArray) -> bytes:
        """Write the transforms of some rows, at least one.

        Args:
            rows: In the order of the message, none twice; (m,).
            poses: (m, 7 * transforms of a row).
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
        """Tell how many bytes a row takes."""
        return len(self._later.payload(row)) - LATER_OFFSET


class GroupFramePoses:
    """Remembers joints as they were when they were due; each row has a beat of its own."""

    def __init__(self, kind: GroupKey, bases: GroupBaseController) -> None:
        """Take whose they are, and their motions."""
        self._bases = bases
        rate_hz = find_motion_rates(kind.drive)[2]
        self._limiters = None if rate_hz is None else GroupRateLimiter(rate_hz)
        self._has_odometry = kind.drive.publish_odom_tf
        self._frames = JointTransforms(
            msgspec.msgpack.decode(kind.geometry, type=tuple[Joint, ...])
        )
        self._moving = list(kind.moving)
        self._positions = np.zeros((0, len(kind.moving)))
        self._found: tuple[IntArray, FloatArray] | None = None

    def remap_rows(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self._found = None
        if self._limiters is not None:
            self._limiters.remap(before)
        self._positions = remap_floats(self._positions, before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self._found = None
        if self._limiters is not None:
            self._limiters.reset()

    def take(self, rows: IntArray, positions: FloatArray, time_ns: int) -> IntArray:
        """Take the joints of those rows that are due, and return these.

        Args:
            rows: Whose motion is new.
            positions: Of all joints of all rows, (n, joint_count).
            time_ns: Simulation time.
        """
        self._found = None
        if len(rows) and self._limiters is not None:
            is_open, _ = self._limiters.open(time_ns)
            rows = np.intersect1d(rows, is_open, assume_unique=True)
        self._positions[rows] = positions[rows][:, self._moving]
        return rows

    def of(self, rows: IntArray) -> FloatArray:
        """Find the poses of some rows' frames, (m, 7 * frames); for the same rows but once."""
        if self._found is None or self._found[0] is not rows:
            self._found = rows, self._poses(rows)
        return self._found[1]

    def _poses(self, rows: IntArray) -> FloatArray:
        joints = self._frames.poses(self._positions[rows]).reshape(len(rows), -1)
        if not self._has_odometry:
            return joints
        return np.concatenate([self._bases.motions[rows, :POSE_COLUMNS], joints], axis=1)


MAX_TF_MESSAGE_BYTES = 32768
"""About as much as a message has at most: one that is cut in pieces is lost with any of them."""


class GroupTfTopic(GroupTopic):
    """A message a robot, with its frames as described."""

    def __init__(self, poses: GroupFramePoses, outlet: FleetTopicPublisher, count: int) -> None:
        """Take whose frames, where they are told, and how many each robot has."""
        super().__init__(
            outlet,
            numbers=poses.of,
            paths=message_templates.list_tf_paths(count),
            stamps=message_templates.list_tf_stamps(count),
        )


class SharedTfTopic:
    """Messages of many robots, with frames that begin with their namespaces."""

    def __init__(
        self, poses: GroupFramePoses, outlet: FleetTopicPublisher, node: RosNode | None
    ) -> None:
        """Declare the topic.

        Args:
            poses: Of the frames.
            outlet: Where they leave.
            node: Who tells it in ROS 2, and nothing else.
        """
        self._node = node
        self._poses = poses
        self._outlet = outlet
        self._line = TopicMember(TF.suffix, self, node=node)
        outlet.add(self._line)
        self._templates: Sequence[TFMessage] = ()
        self._images: TfMessageBatch | None = None
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._told_ns = np.zeros(0, dtype=np.int64)

    def remap(self, written: Sequence[TFMessage], before: IntArray) -> None:
        """Take the robots as they are now: a message of each; see `rows.carried`."""
        self._templates, self._images = written, None
        self._has_value = remap_flags(self._has_value, before)
        self._told_ns = remap_ints(self._told_ns, before)

    def reset(self) -> None:
        """Forget all values: time may have gone back."""
        self._has_value[:] = False

    def publish(self, rows: IntArray, time_ns: int) -> None:
        """Tell the frames of some rows."""
        if not len(rows):
            return
        self._has_value[rows] = True
        self._told_ns[rows] = time_ns
        if self._outlet.is_wanted:
            for message in self._messages(rows):
                self._outlet.put((self._line,), (message,))

    def payload(self, row: int) -> bytes | None:  # noqa: ARG002 - of the protocol
        """Write the last values of all; see `outlet.Values`."""
        rows = np.flatnonzero(self._has_value)
        if not len(rows):
            return None
        return self._written().message(rows, self._poses.of(rows), self._told_ns[rows])

    def close(self) -> None:
        """Withdraw the topic."""
        self._outlet.remove(self._line)
        if self._node is not None:
            self._node.close()

    def _messages(self, rows: IntArray) -> Iterator[bytes]:
        images, poses, told_ns = self._written(), self._poses.of(rows), self._told_ns[rows]
        most = max(1, MAX_TF_MESSAGE_BYTES // images.size(int(rows[0])))
        for start in range(0, len(rows), most):
            part = slice(start, start + most)
            yield images.message(rows[part], poses[part], told_ns[part])

    def _written(self) -> TfMessageBatch:
        # Only when somebody wants them: fleets come robot by robot.
        if self._images is None:
            self._images = TfMessageBatch(self._templates)
        return self._images
