"""The robots of a pool: groups of robots in arrays, and single robots that no group can hold."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.network_protocols import AgentNetwork
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic
from zensim.proto.ros2.ros_settings import NO_ROS
from zensim.proto.topic_catalog import CMD_VEL, TopicSpec
from zensim.proto.topic_endpoints import make_topic_factory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.pool.fleet_cmd_vel import FleetCmdVel
from zensim.robot_agent.pool.fleet_publisher import FleetTopicPublisher, RosFleetPublisher
from zensim.robot_agent.pool.group_key import (
    GroupKey,
    can_be_grouped,
    find_topic_keys,
    make_group_key,
)
from zensim.robot_agent.pool.group_telemetry import StaticTopics
from zensim.robot_agent.pool.robot_group import (
    GroupMember,
    PoolDriveState,
    PoolStateLayout,
    RobotGroup,
    unpack_claims,
)
from zensim.robot_agent.pool.robot_rows import NEW_ROW, FloatArray
from zensim.robot_agent.robots import NODE_NAME, Robot

LOG = logging.getLogger("zensim.agent")
GROUP_NODE_PREFIX = "zensim_pool"


@dataclass(frozen=True)
class _SingleRobot:
    """A robot that is driven by itself, and where it stands in the arrays of its pool."""

    robot: Robot
    place: int
    joints: slice
    targets: slice


class PooledRobots:
    """Robots by claim, in squads of one kind; those that no squad can drive, one by one."""

    def __init__(
        self,
        network: AgentNetwork,
        timeout_ns: int,
        graph: RosGraph | None = None,
        ears: AgentNetwork | None = None,
    ) -> None:
        """Hold nobody yet.

        Args:
            network: Where robots tell.
            timeout_ns: Simulation time that a command holds; 0 = for ever.
            graph: Where robots are nodes of ROS 2.
            ears: A session without publishers, where commands are heard; None = `network`.
        """
        self.newest_claim = 0
        """The newest claim that is held; 0 without any."""
        self._network = network
        self._graph = graph
        self._ros = graph.settings if graph else NO_ROS
        self._numbers = count(1)
        self._timeout_ns = timeout_ns
        self._members: dict[int, GroupMember] = {}
        self._robots: dict[int, Robot] = {}
        self._outlets: dict[tuple[str, TopicSpec], FleetTopicPublisher] = {}
        self._constants = StaticTopics(self._find_publisher, self._ros)
        self._commands = FleetCmdVel(ears or network, timeout_ns, graph.domain if graph else None)
        self._groups: dict[GroupKey, RobotGroup] = {}
        self._claims: bytes | None = None
        self._layout = PoolStateLayout((), ())
        self._singles: tuple[_SingleRobot, ...] = ()

    def add_claims(self, claims: Sequence[Claim]) -> None:
        """Hold what was claimed: it is heard from now on, and told of from its first state on."""
        for claim in claims:
            if can_be_grouped(claim.model):
                topics = find_topic_keys(claim, self._ros)
                self._commands.listen(topics.cmd_vel)
                member = GroupMember(claim, make_group_key(claim.model, topics), topics)
                member.node = self._join_ros_graph(claim.namespace, topics.cmd_vel)
                member.constants = self._constants.add(claim, member.node)
                self._members[claim.claim] = member
            else:
                faces = make_topic_factory(self._network, self._graph, claim.namespace, NODE_NAME)
                robot = Robot(faces, claim, self._timeout_ns)
                robot.announce()
                self._robots[claim.claim] = robot
        self._claims = None
        self.newest_claim = max((*self._members, *self._robots), default=0)

    def release_all_except(self, claims: bytes) -> tuple[str, ...]:
        """Let go the robots that are not among these claims, and name them."""
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
        return lost

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held; a state of a claim given up is not for this fleet.

        Raises:
            MalformedPayload: They are not whole numbers of 4 bytes.
        """
        if claims == self._claims:
            return True
        return all(
            claim in self._members or claim in self._robots for claim in unpack_claims(claims)
        )

    def reset(self) -> None:
        """Start all robots again."""
        self._commands.reset()
        for squad in self._groups.values():
            squad.reset()
        for robot in self._robots.values():
            robot.reset()

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive every robot of a state by one control period.

        Raises:
            MalformedPayload: The state does not fit the robots.
        """
        if state.claims != self._claims:
            self._remap(state.claims)
        read = self._layout.read(state, self._commands.at(state.time_ns))
        targets = np.zeros(self._layout.target_total)
        for squad in self._groups.values():
            squad.advance(read, targets)
        for loner in self._singles:
            targets[loner.targets] = loner.robot.advance(_extract_state(loner, read))
        return DriveCommand(state.epoch, state.step, state.claims, _pack_floats(targets))

    def revise(self) -> None:
        """Answer states only: for one robot's command, arrays of all would be made anew."""

    def publish(self) -> None:
        """Publish what the last state made due."""
        for squad in self._groups.values():
            squad.publish()
        for loner in self._singles:
            loner.robot.publish()

    def answer(self) -> None:
        """Tell last values to those who have asked; declare some of what is to be declared."""
        for outlet in tuple(self._outlets.values()):
            outlet.declare_some()
            outlet.announce_some()
            outlet.answer()
        for robot in self._robots.values():
            robot.answer()

    def announce(self) -> None:
        """Publish what never changes to those who have begun to listen."""
        for (_, topic), outlet in self._outlets.items():
            if topic.is_latched:
                outlet.announce()
        for robot in self._robots.values():
            robot.announce()

    def log_malformed(self) -> None:
        """Log which commands were malformed."""
        for key, complaint in self._commands.take_malformed_reports():
            LOG.warning("cmd_vel key=%s %s", key, complaint)
        for robot in self._robots.values():
            if robot.commanded and (complaint := robot.commanded.take_malformed_report()):
                LOG.warning("cmd_vel entity=%s %s", robot.entity, complaint)

    def _release(self, claim: int) -> str:
        if (robot := self._robots.pop(claim, None)) is not None:
            robot.close()
            return robot.entity
        member = self._members.pop(claim)
        self._constants.remove(member.constants)
        if member.kind in self._groups:
            self._groups[member.kind].release(member)
        if member.node is not None:
            member.node.close()
        return member.claim.entity

    def _remap(self, claims: bytes) -> None:
        """Take the robots in the order of a state, and carry over what each remembers."""
        order = unpack_claims(claims)
        self._layout, self._claims = self._make_layout(order), claims
        members = [self._members.get(one) for one in order]
        self._commands.remap(
            [member.topics.cmd_vel if member else "" for member in members],
            np.array([member.place if member else NEW_ROW for member in members], dtype=np.int64),
        )
        squads: dict[GroupKey, list[GroupMember]] = {}
        for place, member in enumerate(members):
            if member is not None:
                member.place = place
                squads.setdefault(member.kind, []).append(member)
        for kind in [kind for kind in self._groups if kind not in squads]:
            self._groups.pop(kind).close()
        self._groups = {kind: self._update_group(kind, cast) for kind, cast in squads.items()}
        self._singles = tuple(
            _SingleRobot(self._robots[one], place, *self._layout.find_slices(place))
            for place, one in enumerate(order)
            if one in self._robots
        )
        for key in [key for key, outlet in self._outlets.items() if outlet.is_empty]:
            self._outlets.pop(key).close()

    def _update_group(self, kind: GroupKey, members: Sequence[GroupMember]) -> RobotGroup:
        squad = self._groups.get(kind) or RobotGroup(
            kind, self._find_publisher, self._make_group_node()
        )
        squad.remap(members, self._layout.find_group_slots([member.place for member in members]))
        return squad

    def _make_layout(self, order: Sequence[int]) -> PoolStateLayout:
        joints, targets = [], []
        for one in order:
            if (member := self._members.get(one)) is not None:
                joints.append(member.kind.joint_count)
                targets.append(member.kind.target_count)
            else:
                joints.append(self._robots[one].joint_count)
                targets.append(self._robots[one].target_count)
        return PoolStateLayout(joints, targets)

    def _find_publisher(self, pattern: str, topic: TopicSpec) -> FleetTopicPublisher:
        key = (pattern, topic)
        if key not in self._outlets:
            endpoint = topic.at(pattern)
            ros = self._make_ros_publisher(endpoint)
            self._outlets[key] = FleetTopicPublisher(self._network, pattern, endpoint.kind, ros)
        return self._outlets[key]

    def _make_ros_publisher(self, topic: Topic) -> RosFleetPublisher | None:
        if self._graph is None or self._graph.domain is None:
            return None
        return RosFleetPublisher(self._network, self._graph, topic)

    def _make_group_node(self) -> RosNode | None:
        """Add to ROS 2's graph who tells what a squad's robots share."""
        if self._graph is None:
            return None
        number = next(self._numbers)
        return self._graph.add_node("", f"{GROUP_NODE_PREFIX}_{self._graph.zid[:8]}_{number}")

    def _join_ros_graph(self, namespace: str, cmd_vel: str) -> RosNode | None:
        """Let a robot into ROS 2's graph: as a node that hears commands."""
        node = self._graph.add_node(namespace, NODE_NAME) if self._graph else None
        if node is not None:
            for kind in CMD_VEL.messages:
                node.add_topic_endpoint("MS", Topic(cmd_vel, kind))
        return node


def _extract_state(loner: _SingleRobot, read: PoolDriveState) -> RobotState:
    return RobotState(
        read.time_ns,
        tuple(read.base[loner.place].tolist()),
        tuple(read.positions[loner.joints].tolist()),
        tuple(read.velocities[loner.joints].tolist()),
    )


def _pack_floats(numbers: FloatArray) -> bytes:
    return numbers.astype("<f8").tobytes()
