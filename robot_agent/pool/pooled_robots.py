"""The robots of a pool: groups in arrays, and single robots that no group can hold."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.messages.model_messages import Model
from zensim.proto.network_protocols import AgentNetwork
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic
from zensim.proto.ros2.ros_settings import NO_ROS
from zensim.proto.topic_catalog import CMD_VEL, TopicSpec
from zensim.proto.topic_endpoints import make_topic_factory
from zensim.robot_agent.drive_state_decoder import RobotState, unpack_claims
from zensim.robot_agent.pool.fleet_cmd_vel import FleetCmdVel
from zensim.robot_agent.pool.fleet_publisher import FleetTopicPublisher, RosFleetPublisher
from zensim.robot_agent.pool.group_key import (
    GroupKey,
    make_group_key,
)
from zensim.robot_agent.pool.group_telemetry import StaticTopics
from zensim.robot_agent.pool.robot_group import (
    GroupMember,
    PoolDriveState,
    PoolStateLayout,
    RobotGroup,
)
from zensim.robot_agent.pool.robot_rows import NEW_ROW, FloatArray
from zensim.robot_agent.robots import NODE_NAME, SENSOR_TYPES, Robot, log_malformed_commands
from zensim.robot_agent.topic_remapping import find_topic_keys

LOG = logging.getLogger("zensim.agent")
GROUP_NODE_PREFIX = "zensim_pool"


@dataclass(frozen=True)
class _SingleRobot:
    """A robot that no group can hold, and its indices in the arrays of its pool."""

    robot: Robot
    place: int
    joints: slice
    targets: slice


class PooledRobots:
    """Robots by claim, in groups; robots that no group can hold are driven one by one."""

    def __init__(
        self,
        network: AgentNetwork,
        timeout_ns: int,
        graph: RosGraph | None = None,
        rx_session: AgentNetwork | None = None,
    ) -> None:
        """Create an empty pool.

        Args:
            network: Session of the publishers.
            timeout_ns: Simulation time for which a command is valid; 0 = for ever.
            graph: ROS 2 graph of the robots' nodes.
            rx_session: Session without publishers, for commands; None = `network`.
        """
        self.newest_claim = 0
        """0 without claims."""
        self._network = network
        self._graph = graph
        self._ros = graph.settings if graph else NO_ROS
        self._numbers = count(1)
        self._timeout_ns = timeout_ns
        self._members: dict[int, GroupMember] = {}
        self._robots: dict[int, Robot] = {}
        self._publishers: dict[tuple[str, TopicSpec], FleetTopicPublisher] = {}
        self._static_topics = StaticTopics(self._find_publisher, self._ros)
        self._commands = FleetCmdVel(
            rx_session or network, timeout_ns, graph.domain if graph else None
        )
        self._groups: dict[GroupKey, RobotGroup] = {}
        self._claims: bytes | None = None
        self._layout = PoolStateLayout((), ())
        self._singles: tuple[_SingleRobot, ...] = ()

    def add_claims(self, claims: Sequence[Claim]) -> None:
        """Subscribe to commands of new robots, which publish from their first state on."""
        for claim in claims:
            if _can_be_grouped(claim.model):
                topic_keys = find_topic_keys(claim, self._ros)
                self._commands.listen(topic_keys.cmd_vel)
                group_key = make_group_key(claim.model, topic_keys)
                member = GroupMember(claim, group_key, topic_keys)
                member.node = self._join_ros_graph(claim.namespace, topic_keys.cmd_vel)
                member.static_topics = self._static_topics.add(claim, member.node)
                self._members[claim.claim] = member
            else:
                factory = make_topic_factory(self._network, self._graph, claim.namespace, NODE_NAME)
                robot = Robot(factory, claim, self._timeout_ns)
                robot.announce()
                self._robots[claim.claim] = robot
        self._claims = None
        self.newest_claim = max((*self._members, *self._robots), default=0)

    def release_all_except(self, claims: bytes) -> tuple[str, ...]:
        """Release the robots that are not among these claims; return their entities."""
        if claims == self._claims:
            return ()
        held = (*self._members, *self._robots)
        gone = set(held).difference(unpack_claims(claims))
        if not gone:
            return ()
        lost = tuple(self._release(claim) for claim in held if claim in gone)
        self._claims = None
        self.newest_claim = max((*self._members, *self._robots), default=0)
        if not self.newest_claim:
            self._remap(b"")
            self._static_topics.forget()
        return lost

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held; a state with a released claim is obsolete.

        Raises:
            MalformedPayload: They are not whole numbers of 4 bytes.
        """
        if claims == self._claims:
            return True
        return all(
            claim in self._members or claim in self._robots for claim in unpack_claims(claims)
        )

    def reset(self) -> None:
        """Reset all robots."""
        self._commands.reset()
        for group in self._groups.values():
            group.reset()
        for robot in self._robots.values():
            robot.reset()

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive each robot of a state by one control period.

        Raises:
            MalformedPayload: The state does not fit the robots.
        """
        if state.claims != self._claims:
            self._remap(state.claims)
        read = self._layout.read(state, self._commands.at(state.time_ns))
        targets = np.zeros(self._layout.target_total)
        for group in self._groups.values():
            group.advance(read, targets)
        for single in self._singles:
            targets[single.targets] = single.robot.advance(_extract_state(single, read))
        return DriveCommand(state.epoch, state.step, state.claims, _pack_floats(targets))

    def revise(self) -> None:
        """Return nothing: one robot's command would need new arrays of all."""

    def publish(self) -> None:
        """Publish what is due at the last state."""
        for group in self._groups.values():
            group.publish()
        for single in self._singles:
            single.robot.publish()

    def reply_to_queries(self) -> None:
        """Reply to queries with the last values; declare some of the missing publishers."""
        for publisher in tuple(self._publishers.values()):
            publisher.declare_some()
            publisher.announce_some()
            publisher.reply_to_queries()
        for robot in self._robots.values():
            robot.reply_to_queries()

    def announce(self) -> None:
        """Publish static topics to new subscribers."""
        for (_, topic), publisher in self._publishers.items():
            if topic.is_latched:
                publisher.announce()
        for robot in self._robots.values():
            robot.announce()

    def log_malformed(self) -> None:
        """Log malformed commands."""
        for key, report in self._commands.take_malformed_reports():
            LOG.warning("cmd_vel key=%s %s", key, report)
        log_malformed_commands(self._robots.values())

    def _release(self, claim: int) -> str:
        if (robot := self._robots.pop(claim, None)) is not None:
            robot.close()
            return robot.entity
        member = self._members.pop(claim)
        self._static_topics.remove(member.static_topics)
        if member.group_key in self._groups:
            self._groups[member.group_key].release(member)
        if member.node is not None:
            member.node.close()
        return member.claim.entity

    def _remap(self, claims: bytes) -> None:
        """Put the robots into the order of a state; rows of robots that stay keep their values."""
        order = unpack_claims(claims)
        self._layout, self._claims = self._make_layout(order), claims
        members = [self._members.get(one) for one in order]
        self._commands.remap(
            [member.topic_keys.cmd_vel if member else "" for member in members],
            np.array([member.place if member else NEW_ROW for member in members], dtype=np.int64),
        )
        groups: dict[GroupKey, list[GroupMember]] = {}
        for place, member in enumerate(members):
            if member is not None:
                member.place = place
                groups.setdefault(member.group_key, []).append(member)
        for key in [key for key in self._groups if key not in groups]:
            self._groups.pop(key).close()
        self._groups = {key: self._update_group(key, group) for key, group in groups.items()}
        self._singles = tuple(
            _SingleRobot(self._robots[one], place, *self._layout.find_slices(place))
            for place, one in enumerate(order)
            if one in self._robots
        )
        for topic in [one for one, publisher in self._publishers.items() if publisher.is_empty]:
            self._publishers.pop(topic).close()

    def _update_group(self, key: GroupKey, members: Sequence[GroupMember]) -> RobotGroup:
        group = self._groups.get(key) or RobotGroup(
            key, self._find_publisher, self._make_group_node()
        )
        group.remap(members, self._layout.find_group_slots([member.place for member in members]))
        return group

    def _make_layout(self, order: Sequence[int]) -> PoolStateLayout:
        joints, targets = [], []
        for one in order:
            if (member := self._members.get(one)) is not None:
                joints.append(member.group_key.joint_count)
                targets.append(member.group_key.target_count)
            else:
                joints.append(self._robots[one].joint_count)
                targets.append(self._robots[one].target_count)
        return PoolStateLayout(joints, targets)

    def _find_publisher(self, pattern: str, topic: TopicSpec) -> FleetTopicPublisher:
        key = (pattern, topic)
        if key not in self._publishers:
            endpoint = topic.at(pattern)
            ros = self._make_ros_publisher(endpoint)
            self._publishers[key] = FleetTopicPublisher(self._network, pattern, endpoint.kind, ros)
        return self._publishers[key]

    def _make_ros_publisher(self, topic: Topic) -> RosFleetPublisher | None:
        if self._graph is None or self._graph.domain is None:
            return None
        return RosFleetPublisher(self._network, self._graph, topic)

    def _make_group_node(self) -> RosNode | None:
        """Add the node that publishes the shared topic of a group to the ROS 2 graph."""
        if self._graph is None:
            return None
        number = next(self._numbers)
        return self._graph.add_node("", f"{GROUP_NODE_PREFIX}_{self._graph.zid[:8]}_{number}")

    def _join_ros_graph(self, namespace: str, cmd_vel: str) -> RosNode | None:
        """Add a robot to the ROS 2 graph, as a node that subscribes to commands."""
        node = self._graph.add_node(namespace, NODE_NAME) if self._graph else None
        if node is not None:
            for kind in CMD_VEL.messages:
                node.add_topic_endpoint("MS", Topic(cmd_vel, kind))
        return node


def _can_be_grouped(model: Model) -> bool:
    return model.drive is not None and not any(one.is_used_by(model) for one in SENSOR_TYPES)


def _extract_state(single: _SingleRobot, read: PoolDriveState) -> RobotState:
    return RobotState(
        read.time_ns,
        tuple(read.base[single.place].tolist()),
        tuple(read.positions[single.joints].tolist()),
        tuple(read.velocities[single.joints].tolist()),
    )


def _pack_floats(numbers: FloatArray) -> bytes:
    return numbers.astype("<f8").tobytes()
