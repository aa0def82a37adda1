"""What a robot tells: odometry, transforms, joint states, its description."""

from proto import keys
from proto.claims import Claim
from proto.faces import Faces
from proto.header import Header, Time, time_from_ns
from proto.ros_graph import Topic
from proto.topics import JointState, Odometry, String, TFMessage
from robot_agent.driven_base import drive_of, gate_of, motion_rates
from robot_agent.frames import (
    ALL_JOINTS,
    base_of,
    fixed_edges,
    moving_joints,
    moving_transforms,
    odometry_edge,
    published_joints,
)
from robot_agent.odometry import Motion, OdometryFrames, covariance_of
from robot_agent.outlet import Outlet
from robot_agent.rate_gate import RateGate
from robot_agent.reading import Reading
from robot_agent.remapping import odometry_key, topic_key
from robot_agent.tf_outlets import tf_outlets, tf_static_outlets


class MotionTelemetry:
    """Odometry and tf of one robot, at the rate of its drive."""

    def __init__(self, faces: Faces, claim: Claim) -> None:
        model, drive = claim.model, drive_of(claim.model)
        self._reading: Reading | None = None
        self._motion = Motion()
        self._moving = moving_joints(model)
        self._has_odom_tf = drive.publish_odom_tf
        self._frames = OdometryFrames(
            drive.odometry_frame, base_of(model).name, covariance_of(drive)
        )
        self.outlets: list[Outlet] = []
        self._gates: list[RateGate | None] = []
        _, odometry_hz, tf_hz = motion_rates(drive)
        if drive.publish_odom:
            key = odometry_key(claim.namespace, drive)
            self.outlets.append(Outlet(faces, Topic(key, Odometry), self._odometry))
            self._gates.append(gate_of(odometry_hz))
        if self._moving or self._has_odom_tf:
            key = topic_key(claim.namespace, keys.TF, drive.ros)
            told = tf_outlets(faces, claim.namespace, key, self._transforms)
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

    def _odometry(self) -> Odometry | None:
        if self._reading is None:
            return None
        return self._frames.message(self._motion, time_from_ns(self._reading.time_ns))

    def _transforms(self) -> TFMessage | None:
        if self._reading is None:
            return None
        stamp = time_from_ns(self._reading.time_ns)
        joints = moving_transforms(self._moving, self._reading.positions, stamp)
        if not self._has_odom_tf:
            return TFMessage(joints)
        edge = odometry_edge(self._frames.frame_id, self._frames.child_frame_id, self._motion)
        return TFMessage((edge.stamped(stamp), *joints))


class JointTelemetry:
    """Joint states of one robot, at a rate of their own."""

    def __init__(self, faces: Faces, claim: Claim) -> None:
        publisher = claim.model.joint_state or ALL_JOINTS
        self._reading: Reading | None = None
        self._gate = RateGate(publisher.update_rate_hz)
        self._joints = published_joints(claim.model)
        self._names = tuple(claim.model.joints[index].name for index in self._joints)
        self.outlets: list[Outlet] = []
        if self._joints:
            key = topic_key(claim.namespace, keys.JOINT_STATES, publisher.ros)
            self.outlets.append(Outlet(faces, Topic(key, JointState), self._joint_states))

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

    def _joint_states(self) -> JointState | None:
        if (reading := self._reading) is None:
            return None
        return JointState(
            Header(time_from_ns(reading.time_ns)),
            self._names,
            tuple(reading.positions[index] for index in self._joints),
            tuple(reading.velocities[index] for index in self._joints),
        )


def constant_outlets(faces: Faces, claim: Claim) -> list[Outlet]:
    """Declare what never changes: fixed transforms, and the description."""
    # Stamped 0: it holds from the beginning of time.
    edges = fixed_edges(claim.model, base_of(claim.model))
    fixed = TFMessage(tuple(edge.stamped(Time()) for edge in edges))
    outlets: list[Outlet] = []
    if fixed.transforms:
        outlets += tf_static_outlets(faces, claim.namespace, lambda: fixed)
    if claim.robot_description:
        key = keys.robot(claim.namespace, keys.ROBOT_DESCRIPTION)
        topic, description = Topic(key, String, is_latched=True), String(claim.robot_description)
        outlets.append(Outlet(faces, topic, lambda: description))
    return outlets
