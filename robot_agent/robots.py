"""Robots that are driven one by one: cmd_vel in, targets and telemetry out."""

import logging
import struct
from collections.abc import Sequence

from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.network_protocols import AgentNetwork, Sample, Subscription
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.topic_catalog import CMD_VEL
from zensim.proto.topic_endpoints import LazyTopicPublisher, TopicFactory, make_topic_factory
from zensim.robot_agent.base_controller import BaseController, get_drive
from zensim.robot_agent.drive_state_decoder import DriveStateLayout, RobotState
from zensim.robot_agent.robot_telemetry import (
    JointTelemetry,
    MotionTelemetry,
    make_static_publishers,
)
from zensim.robot_agent.topic_remapping import resolve_cmd_vel_key
from zensim.robot_agent.true_odometry import TrueOdometryTelemetry

CMD_VEL_DEPTH = 8
"""A bad message does not hide the good one before it."""
ZERO_TWIST = Twist()


class CmdVelSubscriber:
    """The twist that holds now; a standing robot until a first one has come."""

    def __init__(self, subscription: Subscription, timeout_ns: int) -> None:
        """Take the channel.

        Args:
            subscription: To cmd_vel.
            timeout_ns: Simulation time that a twist holds after it was first seen; 0 = for ever.
        """
        self.malformed = 0
        """Messages that were no velocity command, since the start."""
        self._reported = 0
        self._fault = ""
        self._subscription = subscription
        self._timeout_ns = timeout_ns
        self.twist = ZERO_TWIST
        """As it was when it was asked for last."""
        self._seen_ns = 0

    def reset(self) -> None:
        """Forget the twist; one that waits in the channel still counts."""
        self.twist = ZERO_TWIST

    def at(self, time_ns: int) -> Twist:
        """Find the twist at a moment of simulation time."""
        for sample in reversed(self._subscription.take()):
            twist = self._read(sample)
            if twist is not None:
                self.twist, self._seen_ns = twist, time_ns
                break
        if self._timeout_ns and time_ns - self._seen_ns > self._timeout_ns:
            self.twist = ZERO_TWIST
        return self.twist

    def take_malformed_report(self) -> str:
        """Say what was malformed since the last time; empty when nothing was."""
        if self.malformed == self._reported:
            return ""
        self._reported = self.malformed
        return f"malformed={self.malformed} reason={self._fault!r}"

    def close(self) -> None:
        """Stop listening."""
        self._subscription.close()

    def _read(self, sample: Sample) -> Twist | None:
        try:
            return decode_twist(sample.payload, sample.encoding)
        except MalformedPayload as error:
            self.malformed += 1
            self._fault = str(error)
            return None


NODE_NAME = "agent"
"""What a robot's node is called in ROS 2, within the robot's namespace."""


class Robot:
    """Turns readings into targets, then into telemetry; without a drive, only the latter."""

    def __init__(self, faces: TopicFactory, claim: Claim, cmd_vel_timeout_ns: int) -> None:
        self.entity = claim.entity
        self._faces = faces
        self.joint_count = len(claim.model.joints)
        self.target_count = claim.model.target_count
        self.commanded: CmdVelSubscriber | None = None
        """None without a drive: there is nothing to command."""
        self._base = BaseController(claim.model)
        self._motion = MotionTelemetry(faces, claim)
        self._joints = JointTelemetry(faces, claim)
        self._truth = TrueOdometryTelemetry(faces, claim)
        self._constant = make_static_publishers(faces, claim)
        self._reading: RobotState | None = None
        self._is_motion_new = False
        if claim.model.drive is not None:
            key = resolve_cmd_vel_key(claim.namespace, get_drive(claim.model))
            heard = faces.subscription(key, CMD_VEL.messages, CMD_VEL_DEPTH)
            self.commanded = CmdVelSubscriber(heard, cmd_vel_timeout_ns)

    def reset(self) -> None:
        """Start again at a reset of the world: stand, forget, let time go back."""
        self._base.reset()
        self._motion.reset()
        self._joints.reset()
        self._truth.reset()
        if self.commanded is not None:
            self.commanded.reset()

    def advance(self, reading: RobotState) -> tuple[float, ...]:
        """Take a reading and find the numbers for `Model.actuators`."""
        twist = self.commanded.at(reading.time_ns) if self.commanded else ZERO_TWIST
        self._reading = reading
        self._is_motion_new = self._base.update(reading, twist)
        return self._base.targets

    @property
    def targets(self) -> tuple[float, ...]:
        """Numbers for `Model.actuators`, as of the last reading."""
        return self._base.targets

    def revise(self) -> bool:
        """Heed a new twist as if it had come before the last reading; tell whether one did."""
        if self.commanded is None or self._reading is None:
            return False
        before = self.commanded.twist
        twist = self.commanded.at(self._reading.time_ns)
        return twist != before and self._base.revise(twist)

    def publish(self) -> None:
        """Publish what the last reading made due."""
        if self._reading is None:
            return
        if self._is_motion_new:
            self._motion.publish(self._reading, self._base.motion)
        self._joints.publish(self._reading)
        self._truth.publish(self._reading)

    def announce(self) -> None:
        """Publish what never changes to those who have begun to listen."""
        for outlet in self._constant:
            outlet.announce()

    def answer(self) -> None:
        """Tell last values to those who have asked."""
        for outlet in self._outlets():
            outlet.answer()

    def close(self) -> None:
        """Withdraw everything."""
        for outlet in self._outlets():
            outlet.close()
        if self.commanded is not None:
            self.commanded.close()
        self._faces.close()

    def _outlets(self) -> list[LazyTopicPublisher]:
        return [
            *self._motion.publishers,
            *self._joints.publishers,
            *self._truth.publishers,
            *self._constant,
        ]


LOG = logging.getLogger("zensim.agent")


class IndividualRobots:
    """Robots by claim; each drive state says which of them are left."""

    def __init__(
        self, network: AgentNetwork, timeout_ns: int, graph: RosGraph | None = None
    ) -> None:
        """Hold nobody yet.

        Args:
            network: Where robots hear and tell.
            timeout_ns: Simulation time that a command holds; 0 = for ever.
            graph: Where robots are nodes of ROS 2.
        """
        self._network = network
        self._graph = graph
        self._timeout_ns = timeout_ns
        self._robots: dict[int, Robot] = {}
        self._claims: bytes | None = None
        self.newest_claim = 0
        """The newest claim that is held; 0 without any."""
        self._robots_in_order: tuple[Robot, ...] = ()
        self._state: DriveState | None = None
        """That was answered last."""
        self._state_layout = DriveStateLayout(())

    @property
    def robots(self) -> tuple[Robot, ...]:
        """All robots that are held."""
        return tuple(self._robots.values())

    def add_claims(self, claims: Sequence[Claim]) -> None:
        """Hold what was claimed."""
        for claim in claims:
            faces = make_topic_factory(self._network, self._graph, claim.namespace, NODE_NAME)
            robot = Robot(faces, claim, self._timeout_ns)
            robot.announce()
            self.hold(claim.claim, robot)

    def hold(self, claim: int, robot: Robot) -> None:
        """Add a robot under its claim."""
        self._robots[claim] = robot
        self.newest_claim = max(self._robots)
        self._claims = None

    def release_all_except(self, claims: bytes) -> tuple[str, ...]:
        """Let go the robots that are not among these claims, and name them."""
        if claims == self._claims and len(self._robots_in_order) == len(self._robots):
            return ()
        kept = set(_unpack_claims(claims))
        lost = {claim: robot for claim, robot in self._robots.items() if claim not in kept}
        for claim, robot in lost.items():
            robot.close()
            del self._robots[claim]
        if lost:
            self._claims = None
            self.newest_claim = max(self._robots, default=0)
        return tuple(robot.entity for robot in lost.values())

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held; a state of a claim given up is not for this fleet.

        Raises:
            MalformedPayload: They are not whole numbers of 4 bytes.
        """
        return claims == self._claims or all(
            claim in self._robots for claim in _unpack_claims(claims)
        )

    def reset(self) -> None:
        """Start all robots again."""
        for robot in self._robots.values():
            robot.reset()

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive every robot of a state by one control period.

        Raises:
            MalformedPayload: The state does not fit the robots.
        """
        if state.claims != self._claims:
            self._robots_in_order = tuple(
                self._robots[claim] for claim in _unpack_claims(state.claims)
            )
            self._state_layout = DriveStateLayout(
                [robot.joint_count for robot in self._robots_in_order]
            )
            self._claims = state.claims
        readings = self._state_layout.readings(state)
        for robot, reading in zip(self._robots_in_order, readings, strict=True):
            robot.advance(reading)
        self._state = state
        return self._command(state)

    def revise(self) -> DriveCommand | None:
        """Answer the last state anew if a twist has come since that changes the answer."""
        if self._state is None or self._state.claims != self._claims:
            return None
        # All are asked: each takes what it hears.
        is_revised = [robot.revise() for robot in self._robots_in_order]
        return self._command(self._state) if any(is_revised) else None

    def publish(self) -> None:
        """Publish what the last state made due."""
        for robot in self._robots_in_order:
            robot.publish()

    def _command(self, state: DriveState) -> DriveCommand:
        targets = [target for robot in self._robots_in_order for target in robot.targets]
        packed = struct.pack(f"<{len(targets)}d", *targets)
        return DriveCommand(state.epoch, state.step, state.claims, packed)

    def answer(self) -> None:
        """Tell last values to those who have asked."""
        for robot in self._robots.values():
            robot.answer()

    def announce(self) -> None:
        """Publish what never changes to those who have begun to listen."""
        for robot in self._robots.values():
            robot.announce()

    def log_malformed(self) -> None:
        """Log which commands were malformed."""
        for robot in self._robots.values():
            if robot.commanded and (complaint := robot.commanded.take_malformed_report()):
                LOG.warning("cmd_vel entity=%s %s", robot.entity, complaint)


def _unpack_claims(claims: bytes) -> tuple[int, ...]:
    if len(claims) % 4:
        raise MalformedPayload(f"{len(claims)} bytes of claims; each has 4")
    return struct.unpack(f"<{len(claims) // 4}I", claims)
