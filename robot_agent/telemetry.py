"""What a robot tells: odometry, transforms, joint states, its description."""

from collections.abc import Callable, Sequence

from zensim.proto import keys
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import JointState, Odometry, String, TFMessage, Time
from zensim.proto.ros2.ros_graph import Topic
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent import templates
from zensim.robot_agent.driven_base import drive_of, gate_of, motion_rates
from zensim.robot_agent.frames import (
    ALL_JOINTS,
    base_of,
    fixed_edges,
    moving_joints,
    published_joints,
)
from zensim.robot_agent.image import Image
from zensim.robot_agent.odometry import Motion
from zensim.robot_agent.outlet import Outlet, Value
from zensim.robot_agent.rate_gate import RateGate
from zensim.robot_agent.reading import Reading
from zensim.robot_agent.remapping import odometry_key, topic_key
from zensim.robot_agent.tf_outlets import tf_outlets
from zensim.robot_agent.tf_static import tf_static_outlets


class MotionTelemetry:
    """Odometry and tf of one robot, at the rate of its drive."""

    def __init__(self, faces: TopicFactory, claim: Claim) -> None:
        model, drive = claim.model, drive_of(claim.model)
        self._reading: Reading | None = None
        self._motion = Motion()
        self._moving = moving_joints(model)
        self._has_odom_tf = drive.publish_odom_tf
        self.outlets: list[Outlet] = []
        self._gates: list[RateGate | None] = []
        _, odometry_hz, tf_hz = motion_rates(drive)
        if drive.publish_odom:
            key = odometry_key(claim.namespace, drive)
            self.outlets.append(Outlet(faces, Topic(key, Odometry), self._odometry_of(model)))
            self._gates.append(gate_of(odometry_hz))
        if self._moving or self._has_odom_tf:
            told = tf_outlets(
                faces,
                claim.namespace,
                topic_key(claim.namespace, keys.TF, drive.ros),
                template=templates.tf_template(model),
                value_of=self._transforms_of,
            )
            self.outlets += told
            self._gates += [gate_of(tf_hz) for _ in told]

    def reset(self) -> None:
        """Forget the last motion; time may have gone back."""
        self._reading = None
        for gate in self._gates:
            if gate is not None:
                gate.reset()

    def tell(self, reading: Reading, motion: Motion) -> None:
        """Tell where the base is, how it moves, and where what hangs on it is."""
        self._reading, self._motion = reading, motion
        for outlet, gate in zip(self.outlets, self._gates, strict=True):
            if gate is None or gate.elapsed_s(reading.time_ns) is not None:
                outlet.publish()

    def _odometry_of(self, model: Model) -> Value:
        template = templates.odometry_template(model)
        image = Image(template, numbers=templates.ODOMETRY_PATHS, stamps=templates.HEADER_STAMP)
        return lambda: self._filled(image, self._odometry)

    def _transforms_of(self, template: TFMessage) -> Value:
        count = len(template.transforms)
        image = Image(
            template, numbers=templates.tf_paths(count), stamps=templates.tf_stamps(count)
        )
        return lambda: self._filled(image, self._transforms)

    def _filled(self, image: Image, numbers: Callable[[Reading], Sequence[float]]) -> bytes | None:
        if (reading := self._reading) is None:
            return None
        return image.payload(reading.time_ns, numbers(reading))

    def _odometry(self, _: Reading) -> Sequence[float]:
        motion = self._motion
        return (
            *motion.position,
            *motion.orientation,
            motion.linear_x,
            motion.linear_y,
            motion.angular_z,
        )

    def _transforms(self, reading: Reading) -> Sequence[float]:
        numbers: list[float] = []
        if self._has_odom_tf:
            numbers += self._motion.position + self._motion.orientation
        for joint in self._moving:
            numbers += joint.pose(reading.positions[joint.index])
        return numbers


class JointTelemetry:
    """Joint states of one robot, at a rate of their own."""

    def __init__(self, faces: TopicFactory, claim: Claim) -> None:
        publisher = claim.model.joint_state or ALL_JOINTS
        self._reading: Reading | None = None
        self._gate = RateGate(publisher.update_rate_hz)
        self._joints = published_joints(claim.model)
        self.outlets: list[Outlet] = []
        if self._joints:
            key = topic_key(claim.namespace, keys.JOINT_STATES, publisher.ros)
            topic = Topic(key, JointState)
            self.outlets.append(Outlet(faces, topic, self._joint_states_of(claim.model)))

    def reset(self) -> None:
        """Forget the last reading; time may have gone back."""
        self._reading = None
        self._gate.reset()

    def tell(self, reading: Reading) -> None:
        """Tell positions and velocities if they are due."""
        if self._gate.elapsed_s(reading.time_ns) is None:
            return
        self._reading = reading
        for outlet in self.outlets:
            outlet.publish()

    def _joint_states_of(self, model: Model) -> Value:
        image = Image(
            templates.joint_states_template(model, self._joints),
            numbers=templates.joint_paths(len(self._joints)),
            stamps=templates.HEADER_STAMP,
        )
        return lambda: self._joint_states(image)

    def _joint_states(self, image: Image) -> bytes | None:
        if (reading := self._reading) is None:
            return None
        positions = [reading.positions[index] for index in self._joints]
        velocities = [reading.velocities[index] for index in self._joints]
        return image.payload(reading.time_ns, positions + velocities)


def constant_outlets(faces: TopicFactory, claim: Claim) -> list[Outlet]:
    """Declare what never changes: fixed transforms, and the description."""
    # Stamped 0: it holds from the beginning of time.
    edges = fixed_edges(claim.model, base_of(claim.model))
    fixed = TFMessage(tuple(edge.stamped(Time()) for edge in edges))
    outlets = tf_static_outlets(faces, claim, fixed)
    if claim.robot_description:
        key = keys.robot(claim.namespace, keys.ROBOT_DESCRIPTION)
        topic, description = Topic(key, String, is_latched=True), String(claim.robot_description)
        outlets.append(Outlet(faces, topic, lambda: description))
    return outlets
