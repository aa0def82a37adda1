"""Topics of one robot: odometry, tf, tf_static, joint states and robot_description."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

import msgspec

from zensim.proto.codec.cdr_template import CdrTemplate
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model, Origin
from zensim.proto.messages.standard_messages import (
    String,
    TFMessage,
    Time,
    TransformStamped,
)
from zensim.proto.rate_limiter import RateLimiter
from zensim.proto.rigid_transforms import find_yaw, from_axis_angle
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.topic_catalog import JOINT_STATES, ODOM, ROBOT_DESCRIPTION, TF, TF_STATIC
from zensim.proto.topic_endpoints import LazyTopicPublisher, MakePayload, TopicFactory
from zensim.robot_agent import message_templates
from zensim.robot_agent.base_controller import find_motion_rates, get_drive, make_rate_limiter
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import Z_AXIS, BaseMotion, find_world_motion
from zensim.robot_agent.robot_frames import (
    DEFAULT_JOINT_STATE_PUBLISHER,
    FrameEdge,
    find_base_frame,
    list_fixed_edges,
    list_moving_joints,
    list_published_joints,
)
from zensim.robot_agent.topic_remapping import resolve_odom_key, resolve_topic_key

MakeValue: TypeAlias = Callable[[TFMessage], MakePayload]


def make_tf_publishers(
    faces: TopicFactory, namespace: str, own_key: str, *, template: TFMessage, value_of: MakeValue
) -> list[LazyTopicPublisher]:
    """Declare a robot's transforms that move.

    Args:
        faces: Where.
        namespace: Of the robot.
        own_key: Of its own topic.
        template: The transforms before they have moved, with frames as described.
        value_of: Makes what is told of a template: of that one, or with other names of frames.
    """
    outlets = []
    if faces.settings.has_namespaced_tf:
        outlets.append(LazyTopicPublisher(faces, TF.at(own_key), value_of(template)))
    if faces.settings.has_global_tf:
        shared = value_of(prefix_frames(template, namespace))
        outlets.append(LazyTopicPublisher(faces, TF.root(), shared, is_shared=True))
    return outlets


def prefix_frames(message: TFMessage, namespace: str) -> TFMessage:
    """Let frames begin with the namespace, but for those that do already."""
    return TFMessage(tuple(_prefix_transform(edge, f"{namespace}/") for edge in message.transforms))


def _prefix_transform(edge: TransformStamped, prefix: str) -> TransformStamped:
    header = msgspec.structs.replace(
        edge.header, frame_id=_prefix_frame_id(edge.header.frame_id, prefix)
    )
    return TransformStamped(header, _prefix_frame_id(edge.child_frame_id, prefix), edge.transform)


def _prefix_frame_id(frame_id: str, prefix: str) -> str:
    return frame_id if frame_id.startswith(prefix) else prefix + frame_id


def make_tf_static_publishers(
    faces: TopicFactory, claim: Claim, fixed: TFMessage
) -> list[LazyTopicPublisher]:
    """Declare a robot's transforms that never change."""
    outlets = []
    for key, message in list_tf_static(claim, fixed, faces.settings):
        topic = TF_STATIC.at(key)
        outlets.append(
            LazyTopicPublisher(
                faces, topic, partial(_return_message, message), is_shared=key == TF_STATIC.suffix
            )
        )
    return outlets


def list_tf_static(
    claim: Claim, fixed: TFMessage, ros: RosSettings
) -> Iterator[tuple[str, TFMessage]]:
    """Find which topics tell of a robot's fixed transforms, and what."""
    if ros.has_namespaced_tf and fixed.transforms:
        yield TF_STATIC.key(claim.namespace), fixed
    shared = prefix_frames(fixed, claim.namespace).transforms + _make_root_transform(
        claim, ros.tf_root
    )
    if ros.has_global_tf and shared:
        yield TF_STATIC.suffix, TFMessage(shared)


def _make_root_transform(claim: Claim, root: str) -> tuple[TransformStamped, ...]:
    """Hang a robot's odometry frame, its namespace before it, from the shared frame.

    Args:
        claim: The robot.
        root: The shared frame; empty for none.

    Returns:
        One transform that never changes; none without a root, or when tf has no odometry frame.
    """
    drive = get_drive(claim.model)
    if not root or not drive.publish_odom_tf:
        return ()
    origin = Origin() if drive.encoder is None else _find_odom_origin(claim)
    edge = FrameEdge(root, f"{claim.namespace}/{drive.odometry_frame}", origin)
    # Stamped 0: it holds from the beginning of time.
    return (edge.to_message(Time()),)


def _find_odom_origin(claim: Claim) -> Origin:
    """Find where encoders counted from: the spawn, upright."""
    if not claim.spawn_state:
        return Origin()
    base = BaseMotion(
        *find_world_motion(claim.spawn_state, find_base_frame(claim.model).pose_in_root, FLOAT_MATH)
    )
    yaw = find_yaw(base.orientation, FLOAT_MATH)
    return Origin(base.position, from_axis_angle(Z_AXIS, yaw))


def _return_message(message: TFMessage) -> TFMessage:
    return message


class MotionTelemetry:
    """Odometry and tf of one robot, at the rate of its drive."""

    def __init__(self, faces: TopicFactory, claim: Claim) -> None:
        model, drive = claim.model, get_drive(claim.model)
        self._reading: RobotState | None = None
        self._motion = BaseMotion()
        self._moving = list_moving_joints(model)
        self._has_odom_tf = drive.publish_odom_tf
        self.publishers: list[LazyTopicPublisher] = []
        self._limiters: list[RateLimiter | None] = []
        _, odometry_hz, tf_hz = find_motion_rates(drive)
        if drive.publish_odom:
            key = resolve_odom_key(claim.namespace, drive)
            self.publishers.append(
                LazyTopicPublisher(faces, ODOM.at(key), self._make_odometry(model))
            )
            self._limiters.append(make_rate_limiter(odometry_hz))
        if self._moving or self._has_odom_tf:
            told = make_tf_publishers(
                faces,
                claim.namespace,
                resolve_topic_key(claim.namespace, TF.suffix, drive.ros),
                template=message_templates.make_tf_template(model),
                value_of=self._make_transforms,
            )
            self.publishers += told
            self._limiters += [make_rate_limiter(tf_hz) for _ in told]

    def reset(self) -> None:
        """Forget the last motion; time may have gone back."""
        self._reading = None
        for gate in self._limiters:
            if gate is not None:
                gate.reset()

    def publish(self, reading: RobotState, motion: BaseMotion) -> None:
        """Tell where the base is, how it moves, and where what hangs on it is."""
        self._reading, self._motion = reading, motion
        for outlet, gate in zip(self.publishers, self._limiters, strict=True):
            if gate is None or gate.elapsed_s(reading.time_ns) is not None:
                outlet.publish()

    def _make_odometry(self, model: Model) -> MakePayload:
        template = message_templates.make_odometry_template(model)
        image = CdrTemplate(
            template,
            numbers=message_templates.ODOMETRY_PATHS,
            stamps=message_templates.HEADER_STAMP,
        )
        return lambda: self._fill_template(image, self._odometry)

    def _make_transforms(self, template: TFMessage) -> MakePayload:
        count = len(template.transforms)
        image = CdrTemplate(
            template,
            numbers=message_templates.list_tf_paths(count),
            stamps=message_templates.list_tf_stamps(count),
        )
        return lambda: self._fill_template(image, self._transforms)

    def _fill_template(
        self, image: CdrTemplate, numbers: Callable[[RobotState], Sequence[float]]
    ) -> bytes | None:
        if (reading := self._reading) is None:
            return None
        return image.payload(reading.time_ns, numbers(reading))

    def _odometry(self, _: RobotState) -> Sequence[float]:
        motion = self._motion
        return (
            *motion.position,
            *motion.orientation,
            motion.linear_x,
            motion.linear_y,
            motion.angular_z,
        )

    def _transforms(self, reading: RobotState) -> Sequence[float]:
        numbers: list[float] = []
        if self._has_odom_tf:
            numbers += self._motion.position + self._motion.orientation
        for joint in self._moving:
            numbers += joint.pose(reading.positions[joint.index])
        return numbers


class JointTelemetry:
    """Joint states of one robot, at a rate of their own."""

    def __init__(self, faces: TopicFactory, claim: Claim) -> None:
        publisher = claim.model.joint_state or DEFAULT_JOINT_STATE_PUBLISHER
        self._reading: RobotState | None = None
        self._limiter = RateLimiter(publisher.update_rate_hz)
        self._joints = list_published_joints(claim.model)
        self.publishers: list[LazyTopicPublisher] = []
        if self._joints:
            key = resolve_topic_key(claim.namespace, JOINT_STATES.suffix, publisher.ros)
            topic = JOINT_STATES.at(key)
            self.publishers.append(
                LazyTopicPublisher(faces, topic, self._make_joint_states(claim.model))
            )

    def reset(self) -> None:
        """Forget the last reading; time may have gone back."""
        self._reading = None
        self._limiter.reset()

    def publish(self, reading: RobotState) -> None:
        """Tell positions and velocities if they are due."""
        if self._limiter.elapsed_s(reading.time_ns) is None:
            return
        self._reading = reading
        for outlet in self.publishers:
            outlet.publish()

    def _make_joint_states(self, model: Model) -> MakePayload:
        image = CdrTemplate(
            message_templates.make_joint_states_template(model, self._joints),
            numbers=message_templates.list_joint_paths(len(self._joints)),
            stamps=message_templates.HEADER_STAMP,
        )
        return lambda: self._joint_states(image)

    def _joint_states(self, image: CdrTemplate) -> bytes | None:
        if (reading := self._reading) is None:
            return None
        positions = [reading.positions[index] for index in self._joints]
        velocities = [reading.velocities[index] for index in self._joints]
        return image.payload(reading.time_ns, positions + velocities)


def make_static_publishers(faces: TopicFactory, claim: Claim) -> list[LazyTopicPublisher]:
    """Declare what never changes: fixed transforms, and the description."""
    # Stamped 0: it holds from the beginning of time.
    edges = list_fixed_edges(claim.model, find_base_frame(claim.model))
    fixed = TFMessage(tuple(edge.to_message(Time()) for edge in edges))
    outlets = make_tf_static_publishers(faces, claim, fixed)
    if claim.robot_description:
        key = ROBOT_DESCRIPTION.key(claim.namespace)
        topic, description = ROBOT_DESCRIPTION.at(key), String(claim.robot_description)
        outlets.append(LazyTopicPublisher(faces, topic, lambda: description))
    return outlets
