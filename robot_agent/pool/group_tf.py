"""tf of a group: transforms in arrays, one message per robot, or one for many robots on /tf."""

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
    """Transforms of some joints at any positions; see `MovingJoint`."""

    def __init__(self, joints: Sequence[Joint]) -> None:
        """Stack the constants of joints that move."""
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
"""Stands for the transforms of other robots."""
COUNT_STRUCT = struct.Struct("<I")
FIRST_OFFSET = HEADER_BYTES + COUNT_STRUCT.size
LATER_OFFSET = len(encode(TFMessage((EMPTY_TRANSFORM,))))


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
        self._has_odometry = group_key.drive.publish_odom_tf
        self._frames = JointTransforms(
            msgspec.msgpack.decode(group_key.geometry, type=tuple[Joint, ...])
        )
        self._moving = list(group_key.moving)
        self._positions = np.zeros((0, len(group_key.moving)))
        self._found: tuple[IntArray, FloatArray] | None = None

    def remap_rows(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self._found = None
        if self._limiters is not None:
            self._limiters.remap(before)
        self._positions = remap_floats(self._positions, before)

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
            rows = np.intersect1d(rows, is_open, assume_unique=True)
        self._positions[rows] = positions[rows][:, self._moving]
        return rows

    def of(self, rows: IntArray) -> FloatArray:
        """Find the poses of some rows' frames, (m, 7 * frames); cached for the same rows."""
        if self._found is None or self._found[0] is not rows:
            self._found = rows, self._poses(rows)
        return self._found[1]

    def _poses(self, rows: IntArray) -> FloatArray:
        joints = self._frames.poses(self._positions[rows]).reshape(len(rows), -1)
        if not self._has_odometry:
            return joints
        return np.concatenate([self._bases.motions[rows, :POSE_COLUMNS], joints], axis=1)


MAX_TF_MESSAGE_BYTES = 32768
"""Approximate limit: a message sent in fragments is lost with any of them."""


class GroupTfTopic(GroupTopic):
    """Transforms on each robot's own topic, with frames as described."""

    def __init__(self, poses: GroupFramePoses, publisher: FleetTopicPublisher, count: int) -> None:
        """Create a topic with this count of transforms per robot."""
        super().__init__(
            publisher,
            numbers=poses.of,
            paths=message_templates.list_tf_paths(count),
            stamps=message_templates.list_tf_stamps(count),
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
        self._templates: Sequence[TFMessage] = ()
        self._batch: TfMessageBatch | None = None
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._published_ns = np.zeros(0, dtype=np.int64)

    def remap(self, templates: Sequence[TFMessage], before: IntArray) -> None:
        """Set the robots' messages, one per row; for `before` see `remap_floats`."""
        self._templates, self._batch = templates, None
        self._has_value = remap_flags(self._has_value, before)
        self._published_ns = remap_ints(self._published_ns, before)

    def reset(self) -> None:
        """Forget all values; time may have gone back."""
        self._has_value[:] = False

    def publish(self, rows: IntArray, time_ns: int) -> None:
        """Publish the transforms of some rows."""
        if not len(rows):
            return
        self._has_value[rows] = True
        self._published_ns[rows] = time_ns
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
            self._batch = TfMessageBatch(self._templates)
        return self._batch
