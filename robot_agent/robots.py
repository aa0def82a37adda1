"""Robots that are driven one by one: cmd_vel in, targets and telemetry out."""

import logging
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim, DriveCommand, DriveState
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.network_protocols import MAX_COMMAND_BYTES, AgentNetwork, Sample, Subscription
from zensim.proto.ros2.node_services import NodeParameters, NodeServices
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.topic_catalog import CMD_VEL
from zensim.proto.topic_endpoints import LazyTopicPublisher, TopicFactory, make_topic_factory
from zensim.proto.topic_faults import TopicFaults
from zensim.robot_agent.base_controller import BaseController
from zensim.robot_agent.bumpers import BumperTelemetry, ContactReport
from zensim.robot_agent.drive_state_decoder import (
    DriveStateLayout,
    RobotState,
    is_repeated,
    unpack_claims,
    unpack_twists,
)
from zensim.robot_agent.fleet_odometry import MotionRows
from zensim.robot_agent.joint_control import make_joint_control
from zensim.robot_agent.mounted_sensors import list_state_sensors
from zensim.robot_agent.robot_parameters import list_robot_parameters
from zensim.robot_agent.robot_telemetry import (
    JointTelemetry,
    MotionTelemetry,
    make_static_publishers,
)
from zensim.robot_agent.topic_remapping import find_topic_keys
from zensim.robot_agent.true_odometry import TrueOdometryTelemetry

CMD_VEL_DEPTH = 8
"""A malformed message does not hide the valid one before it."""
ZERO_TWIST = Twist()
NODE_NAME = "agent"
"""Name of a robot's ROS 2 node, in the robot's namespace."""
LOG = logging.getLogger("zensim.agent")
_ODOMETRY_STRUCT = struct.Struct(f"<{STATE_COLUMNS}d")


class SensorTelemetry(Protocol):
    """Topics of the sensors of one type on one robot."""

    publishers: list[LazyTopicPublisher]

    def reset(self) -> None:
        """Start again; time may have gone back."""

    def publish(self, state: RobotState) -> None:
        """Publish what is due at a state."""


@dataclass(frozen=True)
class SensorType:
    """A type of sensor that agents simulate."""

    is_used_by: Callable[[Model], bool]
    make: Callable[[TopicFactory, Claim], SensorTelemetry]
    has_groups: bool = False
    """Whether pools simulate it for groups of robots; else they drive its robots one by one."""


def _make_state_sensors(factory: TopicFactory, claim: Claim) -> SensorTelemetry:
    # numpy takes 0.1 s and 13 MB to load, which agents of robots without sensors save.
    from zensim.robot_agent.sensor_telemetry import StateSensorTelemetry  # noqa: PLC0415

    return StateSensorTelemetry(factory, claim)


SENSOR_TYPES: Final = (
    SensorType(lambda model: bool(model.ground_truths), TrueOdometryTelemetry),
    SensorType(lambda model: bool(list_state_sensors(model)), _make_state_sensors, has_groups=True),
)


class CmdVelSubscriber:
    """The current velocity command; zero until the first one."""

    def __init__(self, subscription: Subscription, timeout_ns: int) -> None:
        """Take the subscription.

        Args:
            subscription: To cmd_vel.
            timeout_ns: Simulation time for which a command is valid; 0 = for ever.
        """
        self.malformed = 0
        """Number of malformed messages since the start."""
        self.is_disturbed = False
        """Whether the last messages that came had malformed ones among them."""
        self._reported = 0
        self._fault = ""
        self._subscription = subscription
        self._timeout_ns = timeout_ns
        self.twist = ZERO_TWIST
        """Command as of the last call of `at`."""
        self._received_ns = 0
        self._came_later = False

    def reset(self) -> None:
        """Forget the command; one that waits in the subscription still counts."""
        self.twist, self._came_later = ZERO_TWIST, False

    def count_from_next(self) -> None:
        """Count the time of the command from the next call of `at` on: it ended a rest."""
        self._came_later = True

    def at(self, time_ns: int, ordered: Twist | None = None) -> Twist:
        """Find the command at a simulation time; an ordered one replaces those received."""
        malformed = self.malformed
        if self._came_later:
            self._received_ns, self._came_later = time_ns, False
        for sample in reversed(self._subscription.take()):
            twist = self._decode(sample)
            if twist is not None:
                self.twist, self._received_ns = twist, time_ns
                break
        self.is_disturbed = self.malformed != malformed
        if ordered is not None:
            self.twist, self._received_ns = ordered, time_ns
        if self._timeout_ns and time_ns - self._received_ns > self._timeout_ns:
            self.twist = ZERO_TWIST
        return self.twist

    def take_malformed_report(self) -> str:
        """Describe the malformed messages since the last call; empty if there are none."""
        if self.malformed == self._reported:
            return ""
        self._reported = self.malformed
        return f"malformed={self.malformed} reason={self._fault!r}"

    def close(self) -> None:
        """Close the subscription."""
        self._subscription.close()

    def _decode(self, sample: Sample) -> Twist | None:
        try:
            return decode_twist(sample.payload, sample.encoding)
        except MalformedPayload as error:
            self.malformed += 1
            self._fault = str(error)
            return None


class DrivenRobot:
    """One robot: states to targets and telemetry; without a drive only telemetry."""

    def __init__(
        self,
        factory: TopicFactory,
        claim: Claim,
        cmd_vel_timeout_ns: int,
        *,
        is_pooled: bool = False,
    ) -> None:
        """Declare the topics.

        Args:
            factory: Declares them.
            claim: The robot.
            cmd_vel_timeout_ns: Simulation time for which a command is valid; 0 = for ever.
            is_pooled: Whether a pool publishes the fixed transforms on the shared topic.
        """
        self.entity = claim.entity
        self._factory = factory
        self.joint_count = len(claim.model.joints)
        self.target_count = claim.model.target_count
        self.cmd_vel: CmdVelSubscriber | None = None
        """None without a drive."""
        self._base = BaseController(claim.model)
        self.joints = make_joint_control(factory, claim, cmd_vel_timeout_ns)
        self._motion = MotionTelemetry(factory, claim)
        self._joints = JointTelemetry(factory, claim)
        self._sensors = [
            sensor.make(factory, claim) for sensor in SENSOR_TYPES if sensor.is_used_by(claim.model)
        ]
        self.bumpers = BumperTelemetry(factory, claim)
        self._static = make_static_publishers(factory, claim, has_shared=not is_pooled)
        self._state: RobotState | None = None
        self._ordered: Twist | None = None
        self._is_motion_new = self._is_resting = False
        if claim.model.drive is not None:
            key = find_topic_keys(claim, factory.settings).cmd_vel
            subscription = factory.subscription(
                key, CMD_VEL.messages, CMD_VEL_DEPTH, MAX_COMMAND_BYTES, name=CMD_VEL.name
            )
            self.cmd_vel = CmdVelSubscriber(subscription, cmd_vel_timeout_ns)

    def reset(self) -> None:
        """Start again at a reset of the world; time may have gone back."""
        self._base.reset()
        if self.joints is not None:
            self.joints.reset()
        self._motion.reset()
        self._joints.reset()
        for sensor in self._sensors:
            sensor.reset()
        self.bumpers.reset()
        if self.cmd_vel is not None:
            self.cmd_vel.reset()

    def advance(self, state: RobotState, ordered: Twist | None = None) -> tuple[float, ...]:
        """Take a state and find the targets of `Model.actuators`.

        Args:
            state: State.
            ordered: Twist that the state orders, instead of `cmd_vel`.
        """
        twist = self.cmd_vel.at(state.time_ns, ordered) if self.cmd_vel else ZERO_TWIST
        self._state, self._ordered = state, ordered
        self._is_motion_new = self._base.update(state, twist)
        if self.joints is not None:
            self.joints.update(state.time_ns, lambda: (state.positions, state.velocities))
        return self.targets

    @property
    def targets(self) -> tuple[float, ...]:
        """Targets of `Model.actuators`, as of the last state."""
        if self.joints is None:
            return self._base.targets
        return self._base.targets + self.joints.targets

    @property
    def wants_efforts(self) -> bool:
        """Whether the joint states have a subscriber."""
        return self._joints.wants_efforts

    def revise(self) -> bool:
        """Apply a command that came after the last state; return whether there was one."""
        if self.cmd_vel is None or self._state is None or self._ordered is not None:
            return False
        # Malformed messages cost as much as valid ones: a flood of them is read at states only.
        if self.cmd_vel.is_disturbed:
            return False
        before = self.cmd_vel.twist
        twist = self.cmd_vel.at(self._state.time_ns)
        if self._is_resting:
            self.cmd_vel.count_from_next()
        return twist != before and self._base.revise(twist)

    @property
    def is_idle(self) -> bool:
        """Whether it has no subscriber, no valid `cmd_vel`, and nothing that moves by time."""
        is_static = self.joints is None and not (self._sensors or self.bumpers.publishers)
        is_still = self._ordered is not None or not (
            self.cmd_vel and self.cmd_vel.twist != ZERO_TWIST
        )
        if not (is_static and is_still) or self._base.needs_all_states:
            return False
        publishers = (*self._motion.publishers, *self._joints.publishers)
        return not any(publisher.is_matched for publisher in publishers)

    def limit_updates(self, longest_s: float) -> None:
        """Set the most time [s] that an update of the drive counts; infinite without a rest."""
        self._is_resting = longest_s < math.inf
        self._base.limit_updates(longest_s)

    def repeat(self, ordered: Twist | None) -> None:
        """Find the targets of the last state again, with another ordered twist."""
        self._ordered = ordered
        if ordered is not None and self.cmd_vel is not None and self._state is not None:
            self._base.revise(self.cmd_vel.at(self._state.time_ns, ordered))

    def publish(self) -> None:
        """Publish what is due at the last state."""
        if self._state is None:
            return
        if self._is_motion_new:
            self._motion.publish(self._state, self._base.motion)
        self._joints.publish(self._state)
        for sensor in self._sensors:
            sensor.publish(self._state)

    def find_odometry(self) -> MotionRows | None:
        """Find the odometry if it was due at the last state; none if it or tf has a fault."""
        if self._state is None or not self._is_motion_new:
            return None
        numbers = self._motion.find_odometry(self._state.time_ns)
        topics = self._motion.odometry_key, self._motion.tf_key
        if numbers is None or any(map(self._factory.faults.affects, topics)):
            return None
        positions = self._state.positions
        return MotionRows(
            (self.entity,),
            _ODOMETRY_STRUCT.pack(*numbers[:9], 0.0, 0.0, 0.0, numbers[9]),
            struct.pack(f"<{len(positions)}d", *positions),
            self._motion.has_own_tf_rate,
        )

    def announce(self) -> None:
        """Publish static topics to new subscribers."""
        for publisher in self._static:
            publisher.announce()

    def reply_to_queries(self) -> None:
        """Reply to queries with the last values."""
        for publisher in self._list_publishers():
            publisher.reply_to_queries()

    def close(self) -> None:
        """Undeclare all topics."""
        for publisher in self._list_publishers():
            publisher.close()
        if self.cmd_vel is not None:
            self.cmd_vel.close()
        if self.joints is not None:
            self.joints.close()
        self._factory.close()

    def _list_publishers(self) -> list[LazyTopicPublisher]:
        return [
            *self._motion.publishers,
            *self._joints.publishers,
            *(publisher for sensor in self._sensors for publisher in sensor.publishers),
            *self.bumpers.publishers,
            *self._static,
        ]


def log_malformed_commands(robots: Iterable[DrivenRobot]) -> None:
    """Log the malformed commands of robots."""
    for robot in robots:
        if robot.cmd_vel and (report := robot.cmd_vel.take_malformed_report()):
            LOG.warning("cmd_vel entity=%s %s", robot.entity, report)
        if robot.joints and (report := robot.joints.take_malformed_report()):
            LOG.warning("joint_commands entity=%s %s", robot.entity, report)


class IndividualRobots:
    """Robots by claim; each drive state lists the claims that are still valid."""

    def __init__(
        self, network: AgentNetwork, timeout_ns: int, graph: RosGraph | None = None
    ) -> None:
        """Create an empty set.

        Args:
            network: Session of all topics.
            timeout_ns: Simulation time for which a command is valid; 0 = for ever.
            graph: ROS 2 graph of the robots' nodes.
        """
        self._network = network
        self._graph = graph
        self._timeout_ns = timeout_ns
        self._faults = TopicFaults()
        self._node_services = NodeServices(network, graph.domain if graph else None)
        self._robots: dict[int, DrivenRobot] = {}
        self._claims: bytes | None = None
        self.newest_claim = 0
        """0 without claims."""
        self._robots_in_order: tuple[DrivenRobot, ...] = ()
        self._state: DriveState | None = None
        """The last one that was answered."""
        self._state_layout = DriveStateLayout(())

    @property
    def robots(self) -> tuple[DrivenRobot, ...]:
        """All robots."""
        return tuple(self._robots.values())

    def add_claims(self, claims: Sequence[Claim]) -> None:
        """Add the robots of new claims."""
        for claim in claims:
            factory = make_topic_factory(self._network, self._graph, claim.namespace, NODE_NAME)
            factory.faults = self._faults
            robot = DrivenRobot(factory, claim, self._timeout_ns)
            robot.announce()
            self._node_services.add(
                factory.node, NodeParameters(partial(list_robot_parameters, claim))
            )
            self.hold(claim.claim, robot)

    def hold(self, claim: int, robot: DrivenRobot) -> None:
        """Add a robot under its claim."""
        self._robots[claim] = robot
        self.newest_claim = max(self._robots)
        self._claims = None

    def release_all_except(self, claims: bytes) -> tuple[str, ...]:
        """Release the robots that are not among these claims; return their entities."""
        if claims == self._claims and len(self._robots_in_order) == len(self._robots):
            return ()
        kept = set(unpack_claims(claims))
        lost = {claim: robot for claim, robot in self._robots.items() if claim not in kept}
        for claim, robot in lost.items():
            robot.close()
            del self._robots[claim]
        if lost:
            self._claims = None
            self.newest_claim = max(self._robots, default=0)
        return tuple(robot.entity for robot in lost.values())

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held; a state with a released claim is obsolete.

        Raises:
            MalformedPayload: They are not whole numbers of 4 bytes.
        """
        return claims == self._claims or all(
            claim in self._robots for claim in unpack_claims(claims)
        )

    def reset(self) -> None:
        """Reset all robots."""
        for robot in self._robots.values():
            robot.reset()

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive each robot of a state by one control period.

        Raises:
            MalformedPayload: The state does not fit the robots.
        """
        self._faults.update(state.topic_faults, state.time_ns)
        if state.claims != self._claims:
            self._robots_in_order = tuple(
                self._robots[claim] for claim in unpack_claims(state.claims)
            )
            self._state_layout = DriveStateLayout(
                [robot.joint_count for robot in self._robots_in_order]
            )
            self._claims = state.claims
        states = self._state_layout.split(state)
        twists = unpack_twists(state.twists, len(states))
        for robot, robot_state, twist in zip(self._robots_in_order, states, twists, strict=True):
            robot.advance(robot_state, twist)
        self._state = state
        return self._make_command(state)

    def repeats(self, state: DriveState) -> bool:
        """Whether a state has the step and claims of the last one that was answered."""
        return self._state is not None and is_repeated(state, self._state)

    def repeat(self, state: DriveState) -> DriveCommand:
        """Answer the last state again, with the ordered twists of this one.

        Raises:
            MalformedPayload: The twists do not fit the robots.
        """
        twists = unpack_twists(state.twists, len(self._robots_in_order))
        for robot, twist in zip(self._robots_in_order, twists, strict=True):
            robot.repeat(twist)
        self._state = state
        return self._make_command(state)

    def revise(self) -> DriveCommand | None:
        """Answer the last state again if a command that came since changes the answer."""
        if self._state is None or self._state.claims != self._claims:
            return None
        # A list, so that every robot takes its commands.
        is_revised = [robot.revise() for robot in self._robots_in_order]
        return self._make_command(self._state) if any(is_revised) else None

    def publish(self) -> None:
        """Publish what is due at the last state."""
        for robot in self._robots_in_order:
            robot.publish()

    def is_idle(self) -> bool:
        """Whether all robots are; see `DrivenRobot.is_idle`."""
        return all(robot.is_idle for robot in self._robots_in_order)

    def limit_updates(self, longest_s: float) -> None:
        """Set the most time [s] that an update of a drive counts."""
        for robot in self._robots_in_order:
            robot.limit_updates(longest_s)

    def list_odometry(self) -> Iterator[MotionRows]:
        """List the odometry of all robots that was due at the last state; see `FleetOdometry`."""
        for robot in self._robots_in_order:
            if (found := robot.find_odometry()) is not None:
                yield found

    @property
    def wants_contacts(self) -> bool:
        """Whether a contact sensor has a subscriber."""
        return any(robot.bumpers.is_wanted for robot in self._robots.values())

    def publish_contacts(self, report: ContactReport) -> None:
        """Publish what contact sensors feel."""
        for robot in self._robots.values():
            robot.bumpers.publish(report)

    def _make_command(self, state: DriveState) -> DriveCommand:
        targets = [target for robot in self._robots_in_order for target in robot.targets]
        packed = struct.pack(f"<{len(targets)}d", *targets)
        wants_efforts = any(robot.wants_efforts for robot in self._robots_in_order)
        return DriveCommand(
            *(state.epoch, state.step, state.claims, packed, state.order), wants_efforts
        )

    def reply_to_queries(self) -> None:
        """Reply to queries with the last values."""
        self._node_services.poll()
        for robot in self._robots.values():
            robot.reply_to_queries()

    def announce(self) -> None:
        """Publish static topics to new subscribers."""
        for robot in self._robots.values():
            robot.announce()

    def log_malformed(self) -> None:
        """Log malformed commands."""
        log_malformed_commands(self._robots.values())
