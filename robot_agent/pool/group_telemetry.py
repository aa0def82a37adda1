"""Topics of a group: odometry, tf and joint states, and static topics encoded once per model."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.codec import cdr
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.topic_catalog import (
    JOINT_STATES,
    ODOM,
    ROBOT_TOPICS,
    TF,
    TF_STATIC,
    TopicSpec,
)
from zensim.robot_agent import message_templates
from zensim.robot_agent.base_controller import find_motion_rates
from zensim.robot_agent.pool.fleet_publisher import FleetTopicPublisher, TopicMember
from zensim.robot_agent.pool.group_bases import GroupBaseController
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.pool.group_tf import GroupFramePoses, GroupTfTopic, SharedTfTopic
from zensim.robot_agent.pool.group_topic import GroupTopic
from zensim.robot_agent.pool.robot_rows import FloatArray, GroupRateLimiter, IntArray, remap_floats
from zensim.robot_agent.robot_telemetry import (
    list_static_messages,
    make_fixed_transforms,
    prefix_frames,
)
from zensim.robot_agent.topic_remapping import RobotTopicKeys

FindPublisher = Callable[[str, TopicSpec], FleetTopicPublisher]
"""Finds the publisher of a key pattern and topic."""


class GroupOdometryTopic(GroupTopic):
    """Odometry of a group, at its own rate or with every motion."""

    def __init__(
        self, group_key: GroupKey, bases: GroupBaseController, find_publisher: FindPublisher
    ) -> None:
        super().__init__(
            find_publisher(group_key.patterns.odom, ODOM),
            numbers=lambda rows: bases.motions[rows],
            paths=message_templates.ODOMETRY_PATHS,
            stamps=message_templates.HEADER_STAMP,
            rate_hz=find_motion_rates(group_key.drive)[1],
        )


class GroupJointTopic(GroupTopic):
    """Joint states of a group, at their own rate."""

    def __init__(self, group_key: GroupKey, find_publisher: FindPublisher) -> None:
        count = len(group_key.published)
        super().__init__(
            find_publisher(group_key.patterns.joint_states, JOINT_STATES),
            numbers=lambda rows: self._states[rows],
            paths=message_templates.list_joint_paths(count),
            stamps=message_templates.HEADER_STAMP,
        )
        self._limiters = GroupRateLimiter(group_key.joint_states_hz)
        self._published = list(group_key.published)
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
        """Publish the joints of the rows that are due."""
        rows, _ = self._limiters.open(time_ns)
        if len(rows):
            states = positions[rows][:, self._published], velocities[rows][:, self._published]
            self._states[rows] = np.concatenate(states, axis=1)
            self.publish(rows, time_ns)


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

    def make_shared_template(self, model: Model, namespace: str) -> TFMessage | None:
        """Make a robot's transforms on the shared tf topic."""
        if self.shared is None:
            return None
        return prefix_frames(message_templates.make_tf_template(model), namespace)

    def remap_shared(self, templates: Sequence[TFMessage], before: IntArray) -> None:
        """Remap the rows of the shared tf topic; see `make_shared_template`."""
        self._poses.remap_rows(before)
        if self.shared is not None:
            self.shared.remap(templates, before)

    def reset(self) -> None:
        """Forget all values; time may have gone back."""
        self._poses.reset()
        for topic in self.topics:
            topic.reset()
        if self.shared is not None:
            self.shared.reset()

    def publish(
        self, rows: IntArray, *, positions: FloatArray, velocities: FloatArray, time_ns: int
    ) -> None:
        """Publish what is due.

        Args:
            rows: Rows with a new motion.
            positions: Of all joints [rad or m], (n, joint_count).
            velocities: [rad/s or m/s].
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
        """Undeclare the shared tf topic; the others go with their robots."""
        if self.shared is not None:
            self.shared.close()


class StaticValue:
    """A message that never changes; see `LastValues`."""

    def __init__(self, message: msgspec.Struct) -> None:
        self._payload = cdr.encode(message)

    def payload(self, row: int) -> bytes:  # noqa: ARG002 - of the protocol
        """Return the message."""
        return self._payload


class StaticTopics:
    """Static topics of robots; equal messages are encoded once."""

    def __init__(self, find_publisher: FindPublisher, ros: RosSettings = NO_ROS) -> None:
        self._find_publisher = find_publisher
        self._ros = ros
        self._fixed: dict[int, tuple[Model, TFMessage]] = {}
        self._values: dict[msgspec.Struct, StaticValue] = {}

    def add(self, claim: Claim, node: RosNode | None = None) -> tuple[TopicMember, ...]:
        """Declare a robot's static topics; its node is in the ROS 2 graph."""
        members = []
        for topic, key, message in list_static_messages(
            claim, self._get_fixed_transforms(claim.model), self._ros
        ):
            # On the shared topic each robot has frames of its own.
            is_own = key == TF_STATIC.suffix
            value = StaticValue(message) if is_own else self._get_value(message)
            members.append(TopicMember(key, value, node=node))
            self._find_publisher(keys.make_pattern(key), topic).add(members[-1])
        return tuple(members)

    def remove(self, members: tuple[TopicMember, ...]) -> None:
        """Undeclare a robot's static topics."""
        for member in members:
            topic = ROBOT_TOPICS[keys.last_chunk(member.key)]
            self._find_publisher(keys.make_pattern(member.key), topic).remove(member)

    def forget(self) -> None:
        """Drop the encoded messages, when no robot is left."""
        self._fixed.clear()
        self._values.clear()

    def _get_fixed_transforms(self, model: Model) -> TFMessage:
        # The model is kept, so that no other gets its id.
        if id(model) not in self._fixed:
            self._fixed[id(model)] = (model, make_fixed_transforms(model))
        return self._fixed[id(model)][1]

    def _get_value(self, message: msgspec.Struct) -> StaticValue:
        if message not in self._values:
            self._values[message] = StaticValue(message)
        return self._values[message]
