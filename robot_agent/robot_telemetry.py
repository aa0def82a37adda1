"""Topics of one robot: odometry, tf, tf_static, joint states and robot_description."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

import msgspec

from zensim.proto import message_paths
from zensim.proto.codec.cdr_template import CdrTemplate
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model, Origin
from zensim.proto.messages.standard_messages import String, TFMessage, Time, TransformStamped
from zensim.proto.rate_limiter import RateLimiter
from zensim.proto.rigid_transforms import find_yaw, from_axis_angle
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.tf_joints import list_published_joints
from zensim.proto.topic_catalog import (
    JOINT_STATES,
    ODOM,
    ROBOT_DESCRIPTION,
    TF,
    TF_STATIC,
    TopicSpec,
)
from zensim.proto.topic_endpoints import LazyTopicPublisher, MakePayload, TopicFactory
from zensim.robot_agent import message_templates
from zensim.robot_agent.base_controller import find_motion_rates, has_own_tf_rate, make_rate_limiter
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import Z_AXIS, BaseMotion, find_world_motion
from zensim.robot_agent.robot_frames import (
    DEFAULT_JOINT_STATE_PUBLISHER,
    FrameEdge,
    find_base_frame,
    get_drive,
    list_fixed_edges,
    list_moving_joints,
)
from zensim.robot_agent.topic_remapping import RobotTopicKeys, find_topic_keys

MakeValue: TypeAlias = Callable[[TFMessage], MakePayload]
StaticMessage: TypeAlias = tuple[TopicSpec, str, TFMessage | String]
"""Topic, key and message."""


def make_tf_publishers(
    factory: TopicFactory,
    namespace: str,
    topic_keys: RobotTopicKeys,
    *,
    template: TFMessage,
    value_of: MakeValue,
) -> list[LazyTopicPublisher]:
    """Declare a robot's moving transforms, on its own topic and on the shared one.

    Args:
        factory: Declares topics.
        namespace: Of the robot.
        topic_keys: Its keys; without a key there is no publisher.
        template: The transforms, with frames as described.
        value_of: Makes the payload of a template: of this one, or of one with prefixed frames.
    """
    publishers = []
    if topic_keys.tf:
        publishers.append(LazyTopicPublisher(factory, TF.at(topic_keys.tf), value_of(template)))
    if topic_keys.shared_tf:
        shared = value_of(prefix_frames(template, namespace))
        publishers.append(LazyTopicPublisher(factory, TF.root(), shared, is_shared=True))
    return publishers


def prefix_frames(message: TFMessage, namespace: str) -> TFMessage:
    """Prefix frames with the namespace, unless they start with it."""
    return TFMessage(tuple(_prefix_transform(edge, f"{namespace}/") for edge in message.transforms))


def _prefix_transform(edge: TransformStamped, prefix: str) -> TransformStamped:
    header = msgspec.structs.replace(
        edge.header, frame_id=_prefix_frame_id(edge.header.frame_id, prefix)
    )
    return TransformStamped(header, _prefix_frame_id(edge.child_frame_id, prefix), edge.transform)


def _prefix_frame_id(frame_id: str, prefix: str) -> str:
    return frame_id if frame_id.startswith(prefix) else prefix + frame_id


def make_fixed_transforms(model: Model) -> TFMessage:
    """Make the transforms that never change, stamped 0."""
    edges = list_fixed_edges(model, find_base_frame(model))
    return TFMessage(tuple(edge.to_message(Time()) for edge in edges))


def list_static_messages(
    claim: Claim, fixed: TFMessage, ros: RosSettings
) -> Iterator[StaticMessage]:
    """List the messages of a robot that never change: tf_static and robot_description.

    Args:
        claim: The robot.
        fixed: Its fixed transforms; see `make_fixed_transforms`.
        ros: Scope and root frame of tf.
    """
    yield from list_own_static_messages(claim, fixed, ros)
    if (shared := make_shared_transforms(claim, fixed, ros)).transforms:
        yield TF_STATIC, TF_STATIC.suffix, shared


def make_shared_transforms(claim: Claim, fixed: TFMessage, ros: RosSettings) -> TFMessage:
    """Make the fixed transforms of a robot on the shared topic; see `list_static_messages`."""
    if not ros.has_global_tf:
        return TFMessage()
    root = _make_root_transform(claim, ros.tf_root)
    return TFMessage(prefix_frames(fixed, claim.namespace).transforms + root)


def differs_in_namespace_only(claim: Claim, fixed: TFMessage) -> bool:
    """Whether robots of the model have the shared transforms of this one but for the namespace."""
    drive = get_drive(claim.model)
    frames = [drive.odometry_frame]
    frames += [
        one for edge in fixed.transforms for one in (edge.header.frame_id, edge.child_frame_id)
    ]
    return drive.encoder is None and not any("/" in frame for frame in frames)


def list_own_static_messages(
    claim: Claim, fixed: TFMessage, ros: RosSettings
) -> Iterator[StaticMessage]:
    """List the messages of a robot that never change on topics of its own."""
    if ros.has_namespaced_tf and fixed.transforms:
        yield TF_STATIC, TF_STATIC.key(claim.namespace), fixed
    if claim.robot_description:
        description = String(claim.robot_description)
        yield ROBOT_DESCRIPTION, ROBOT_DESCRIPTION.key(claim.namespace), description


def _make_root_transform(claim: Claim, root: str) -> tuple[TransformStamped, ...]:
    """Make the transform from the shared root frame to a robot's prefixed odometry frame.

    Args:
        claim: The robot.
        root: The shared frame; empty for none.

    Returns:
        One transform; none without a root, or if tf has no odometry frame.
    """
    drive = get_drive(claim.model)
    if not root or not drive.publish_odom_tf:
        return ()
    origin = Origin() if drive.encoder is None else _find_odom_origin(claim)
    edge = FrameEdge(root, f"{claim.namespace}/{drive.odometry_frame}", origin)
    return (edge.to_message(Time()),)


def _find_odom_origin(claim: Claim) -> Origin:
    """Find the origin of encoder odometry: the spawn pose, upright."""
    if not claim.spawn_state:
        return Origin()
    base = BaseMotion(
        *find_world_motion(claim.spawn_state, find_base_frame(claim.model).pose_in_root, FLOAT_MATH)
    )
    yaw = find_yaw(base.orientation, FLOAT_MATH)
    return Origin(base.position, from_axis_angle(Z_AXIS, yaw))


class MotionTelemetry:
    """Odometry and tf of one robot, at the rates of its drive."""

    def __init__(self, factory: TopicFactory, claim: Claim) -> None:
        model, drive = claim.model, get_drive(claim.model)
        topic_keys = find_topic_keys(claim, factory.settings)
        self._state: RobotState | None = None
        self._motion = BaseMotion()
        self._moving = list_moving_joints(model)
        self._has_odom_tf = drive.publish_odom_tf
        self.publishers: list[LazyTopicPublisher] = []
        self._limiters: list[RateLimiter | None] = []
        self.odometry_key = topic_keys.odom
        """Empty without odometry."""
        self.tf_key = topic_keys.tf
        """Empty without transforms on a topic of the robot's own."""
        self._odometry_ns = -1
        """Simulation time at which odometry was due."""
        self.has_own_tf_rate = has_own_tf_rate(drive)
        _, odometry_hz, tf_hz = find_motion_rates(drive)
        if topic_keys.odom:
            topic = ODOM.at(topic_keys.odom)
            self.publishers.append(LazyTopicPublisher(factory, topic, self._make_odometry(model)))
            self._limiters.append(make_rate_limiter(odometry_hz))
        tf_publishers = make_tf_publishers(
            factory,
            claim.namespace,
            topic_keys,
            template=message_templates.make_tf_template(model),
            value_of=self._make_transforms,
        )
        self.publishers += tf_publishers
        self._limiters += [make_rate_limiter(tf_hz) for _ in tf_publishers]

    def reset(self) -> None:
        """Forget the last motion; time may have gone back."""
        self._state, self._odometry_ns = None, -1
        for limiter in self._limiters:
            if limiter is not None:
                limiter.reset()

    def publish(self, state: RobotState, motion: BaseMotion) -> None:
        """Publish odometry and transforms if they are due."""
        self._state, self._motion = state, motion
        for number, publisher in enumerate(self.publishers):
            limiter = self._limiters[number]
            if limiter is None or limiter.elapsed_s(state.time_ns) is not None:
                publisher.publish()
                if number == 0 and self.odometry_key:
                    self._odometry_ns = state.time_ns

    def find_odometry(self, time_ns: int) -> Sequence[float] | None:
        """Find the numbers of the odometry if it was due at this simulation time.

        Returns:
            Those of `message_paths.ODOMETRY_PATHS`.
        """
        if self._state is None or self._odometry_ns != time_ns:
            return None
        return self._list_odometry(self._state)

    def _make_odometry(self, model: Model) -> MakePayload:
        template = CdrTemplate(
            message_templates.make_odometry_template(model),
            numbers=message_paths.ODOMETRY_PATHS,
            stamps=message_paths.HEADER_STAMP,
        )
        return lambda: self._fill_template(template, self._list_odometry)

    def _make_transforms(self, message: TFMessage) -> MakePayload:
        count = len(message.transforms)
        template = CdrTemplate(
            message,
            numbers=message_paths.list_tf_paths(count),
            stamps=message_paths.list_tf_stamps(count),
        )
        return lambda: self._fill_template(template, self._list_transforms)

    def _fill_template(
        self, template: CdrTemplate, list_numbers: Callable[[RobotState], Sequence[float]]
    ) -> bytes | None:
        if (state := self._state) is None:
            return None
        return template.payload(state.time_ns, list_numbers(state))

    def _list_odometry(self, _: RobotState) -> Sequence[float]:
        motion = self._motion
        return (
            *motion.position,
            *motion.orientation,
            motion.linear_x,
            motion.linear_y,
            motion.angular_z,
        )

    def _list_transforms(self, state: RobotState) -> Sequence[float]:
        numbers: list[float] = []
        if self._has_odom_tf:
            numbers += self._motion.position + self._motion.orientation
        for joint in self._moving:
            numbers += joint.pose(state.positions[joint.index])
        return numbers


class JointTelemetry:
    """Joint states of one robot, at a rate of their own."""

    def __init__(self, factory: TopicFactory, claim: Claim) -> None:
        settings = claim.model.joint_state or DEFAULT_JOINT_STATE_PUBLISHER
        self._state: RobotState | None = None
        self._limiter = RateLimiter(settings.update_rate_hz)
        self._joints = list_published_joints(claim.model)
        self.wants_efforts = False
        """Whether there was a subscriber when the last message was due."""
        self.publishers: list[LazyTopicPublisher] = []
        if key := find_topic_keys(claim, factory.settings).joint_states:
            value = self._make_joint_states(claim.model)
            self.publishers.append(LazyTopicPublisher(factory, JOINT_STATES.at(key), value))

    def reset(self) -> None:
        """Forget the last state; time may have gone back."""
        self._state = None
        self._limiter.reset()

    def publish(self, state: RobotState) -> None:
        """Publish positions, velocities and efforts if they are due."""
        if self._limiter.elapsed_s(state.time_ns) is None:
            return
        self._state = state
        wanted = [publisher for publisher in self.publishers if publisher.is_matched]
        self.wants_efforts = bool(wanted)
        for publisher in wanted:
            publisher.publish()

    def _make_joint_states(self, model: Model) -> MakePayload:
        template = CdrTemplate(
            message_templates.make_joint_states_template(model, self._joints),
            numbers=message_templates.list_joint_paths(len(self._joints)),
            stamps=message_paths.HEADER_STAMP,
        )
        return lambda: self._fill_joint_states(template)

    def _fill_joint_states(self, template: CdrTemplate) -> bytes | None:
        if (state := self._state) is None:
            return None
        positions = [state.positions[index] for index in self._joints]
        velocities = [state.velocities[index] for index in self._joints]
        efforts = [state.efforts[index] if state.efforts else math.nan for index in self._joints]
        return template.payload(state.time_ns, positions + velocities + efforts)


def make_static_publishers(
    factory: TopicFactory, claim: Claim, *, has_shared: bool = True
) -> list[LazyTopicPublisher]:
    """Declare the topics of a robot whose message never changes; with the shared one, or not."""
    fixed = make_fixed_transforms(claim.model)
    return [
        LazyTopicPublisher(
            factory,
            topic.at(key),
            partial(_return_message, message),
            is_shared=key == TF_STATIC.suffix,
        )
        for topic, key, message in list_static_messages(claim, fixed, factory.settings)
        if has_shared or key != TF_STATIC.suffix
    ]


def _return_message(message: TFMessage | String) -> TFMessage | String:
    return message
