"""Topics of a group: odometry, tf and joint states, and static topics encoded once per model."""

from collections.abc import Callable, Iterator, Sequence

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.codec import cdr
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import String, TFMessage, Time
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.topic_catalog import (
    JOINT_STATES,
    ODOM,
    ROBOT_DESCRIPTION,
    ROBOT_TOPICS,
    TF,
    TopicSpec,
)
from zensim.robot_agent import message_templates
from zensim.robot_agent.base_controller import find_motion_rates
from zensim.robot_agent.pool.fleet_publisher import FleetTopicPublisher, TopicMember
from zensim.robot_agent.pool.group_bases import GroupBaseController
from zensim.robot_agent.pool.group_key import GroupKey, RobotTopicKeys
from zensim.robot_agent.pool.group_tf import GroupFramePoses, GroupTfTopic, SharedTfTopic
from zensim.robot_agent.pool.group_topic import GroupTopic
from zensim.robot_agent.pool.robot_rows import FloatArray, GroupRateLimiter, IntArray, remap_floats
from zensim.robot_agent.robot_frames import find_base_frame, list_fixed_edges
from zensim.robot_agent.robot_telemetry import list_tf_static, prefix_frames

FindPublisher = Callable[[str, TopicSpec], FleetTopicPublisher]
"""Finds the outlet of a pattern."""


class GroupOdometryTopic(GroupTopic):
    """Odometry, at a rate of its own or with every motion."""

    def __init__(
        self, kind: GroupKey, bases: GroupBaseController, find_publisher: FindPublisher
    ) -> None:
        super().__init__(
            find_publisher(kind.patterns.odom, ODOM),
            numbers=lambda rows: bases.motions[rows],
            paths=message_templates.ODOMETRY_PATHS,
            stamps=message_templates.HEADER_STAMP,
            rate_hz=find_motion_rates(kind.drive)[1],
        )


class GroupJointTopic(GroupTopic):
    """Positions and velocities of joints, at a rate of their own."""

    def __init__(self, kind: GroupKey, find_publisher: FindPublisher) -> None:
        count = len(kind.published)
        super().__init__(
            find_publisher(kind.patterns.joint_states, JOINT_STATES),
            numbers=lambda rows: self._states[rows],
            paths=message_templates.list_joint_paths(count),
            stamps=message_templates.HEADER_STAMP,
        )
        self._limiters = GroupRateLimiter(kind.joint_states_hz)
        self._published = list(kind.published)
        self._states = np.zeros((0, 2 * count))

    def remap_rows(self, before: IntArray) -> None:
        """See `GroupTopic`."""
        super().remap_rows(before)
        self._limiters.remap(before)
        self._states = remap_floats(self._states, before)

    def reset(self) -> None:
        """See `GroupTopic`."""
        super().reset()
        self._limiters.reset()

    def publish_joints(self, positions: FloatArray, velocities: FloatArray, time_ns: int) -> None:
        """Tell the joints of those rows that are due."""
        rows, _ = self._limiters.open(time_ns)
        if len(rows):
            told = positions[rows][:, self._published], velocities[rows][:, self._published]
            self._states[rows] = np.concatenate(told, axis=1)
            self.publish(rows, time_ns)


class GroupTelemetry:
    """The topics of one kind."""

    def __init__(
        self,
        kind: GroupKey,
        bases: GroupBaseController,
        find_publisher: FindPublisher,
        node: RosNode | None,
    ) -> None:
        """Declare the topics.

        Args:
            kind: Of the robots.
            bases: Their motions.
            find_publisher: Where the topics are published.
            node: Who tells in ROS 2 what all robots share a topic for.
        """
        wanted = kind.patterns
        self._published = kind.published
        self.odometry = GroupOdometryTopic(kind, bases, find_publisher) if wanted.odom else None
        self._poses = poses = GroupFramePoses(kind, bases)
        self.transforms: GroupTfTopic | None = None
        self.shared: SharedTfTopic | None = None
        if wanted.tf:
            count = message_templates.count_transforms(kind.drive, kind.moving)
            self.transforms = GroupTfTopic(poses, find_publisher(wanted.tf, TF), count)
        if wanted.shared_tf:
            self.shared = SharedTfTopic(poses, find_publisher(wanted.shared_tf, TF), node)
        self.joints = GroupJointTopic(kind, find_publisher) if wanted.joint_states else None

    @property
    def topics(self) -> tuple[GroupTopic, ...]:
        """Those that each robot has, in the order of `list_keys` and of `make_templates`."""
        found = (self.odometry, self.transforms, self.joints)
        return tuple(topic for topic in found if topic is not None)

    def list_keys(self, topics: RobotTopicKeys) -> tuple[str, ...]:
        """List where a robot tells each of them."""
        return tuple(key for key in (topics.odom, topics.tf, topics.joint_states) if key)

    def make_templates(self, model: Model) -> Sequence[msgspec.Struct]:
        """Write the messages of a robot without a name, one a topic."""
        made: list[msgspec.Struct] = []
        if self.odometry is not None:
            made.append(message_templates.make_odometry_template(model))
        if self.transforms is not None:
            made.append(message_templates.make_tf_template(model))
        if self.joints is not None:
            made.append(message_templates.make_joint_states_template(model, self._published))
        return made

    def make_shared_template(self, model: Model, namespace: str) -> TFMessage | None:
        """Write what a robot has on the topic that all share."""
        if self.shared is None:
            return None
        return prefix_frames(message_templates.make_tf_template(model), namespace)

    def remap_shared(self, written: Sequence[TFMessage], before: IntArray) -> None:
        """Take the robots as they are now: what each has on the topic that all share."""
        self._poses.remap_rows(before)
        if self.shared is not None:
            self.shared.remap(written, before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self._poses.reset()
        for topic in self.topics:
            topic.reset()
        if self.shared is not None:
            self.shared.reset()

    def publish(
        self, rows: IntArray, *, positions: FloatArray, velocities: FloatArray, time_ns: int
    ) -> None:
        """Tell what is due.

        Args:
            rows: Those whose motion is new.
            positions: Of all joints of all rows, (n, joint_count).
            velocities: The same, a second.
            time_ns: Simulation time.
        """
        if self.odometry is not None:
            self.odometry.publish(self.odometry.due(rows, time_ns), time_ns)
        rows = self._poses.take(rows, positions, time_ns)
        if self.transforms is not None:
            self.transforms.publish(rows, time_ns)
        if self.shared is not None:
            self.shared.publish(rows, time_ns)
        if self.joints is not None:
            self.joints.publish_joints(positions, velocities, time_ns)

    def close(self) -> None:
        """Withdraw what all robots share a topic for; the rest goes with them."""
        if self.shared is not None:
            self.shared.close()


class StaticValue:
    """A value that is always the same; see `outlet.Values`."""

    def __init__(self, message: msgspec.Struct) -> None:
        self._payload = cdr.encode(message)

    def payload(self, row: int) -> bytes:  # noqa: ARG002 - of the protocol
        """Tell it."""
        return self._payload


class StaticTopics:
    """Puts robots' constants on their outlets; robots of one model share them."""

    def __init__(self, find_publisher: FindPublisher, ros: RosSettings = NO_ROS) -> None:
        self._find_publisher = find_publisher
        self._ros = ros
        self._fixed: dict[int, _FixedTransforms] = {}
        self._texts: dict[str, StaticValue] = {}

    def add(self, claim: Claim, node: RosNode | None = None) -> tuple[TopicMember, ...]:
        """Begin to tell a robot's constants; its node is in ROS 2's graph."""
        lines = tuple(TopicMember(key, value, node=node) for key, value in self._values(claim))
        for line in lines:
            self._outlet(line).add(line)
        return lines

    def remove(self, lines: tuple[TopicMember, ...]) -> None:
        """Withdraw a robot's constants."""
        for line in lines:
            self._outlet(line).remove(line)

    def forget(self) -> None:
        """Let go of what was written: no robot is left."""
        self._fixed.clear()
        self._texts.clear()

    def _values(self, claim: Claim) -> Iterator[tuple[str, StaticValue]]:
        fixed = self._get_fixed(claim.model)
        for key, message in list_tf_static(claim, fixed.message, self._ros):
            is_own = message is fixed.message
            yield key, fixed.constant if is_own else StaticValue(message)
        if text := claim.robot_description:
            if text not in self._texts:
                self._texts[text] = StaticValue(String(text))
            yield ROBOT_DESCRIPTION.key(claim.namespace), self._texts[text]

    def _get_fixed(self, model: Model) -> "_FixedTransforms":
        if (found := self._fixed.get(id(model))) is None:
            found = self._fixed[id(model)] = _FixedTransforms(model)
        return found

    def _outlet(self, line: TopicMember) -> FleetTopicPublisher:
        topic = ROBOT_TOPICS[keys.last_chunk(line.key)]
        return self._find_publisher(keys.make_pattern(line.key), topic)


class _FixedTransforms:
    """The fixed transforms of a model, which is kept beside so that its id stays its own."""

    def __init__(self, model: Model) -> None:
        self.model = model
        # Stamped 0: it holds from the beginning of time.
        edges = list_fixed_edges(model, find_base_frame(model))
        self.message = TFMessage(tuple(edge.to_message(Time()) for edge in edges))
        self.constant = StaticValue(self.message)
