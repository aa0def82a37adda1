"""The robots that a pool holds, in the order in which the server speaks of them."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.messages.standard_messages import Twist, TwistStamped
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic
from zensim.proto.ros2.ros_settings import NO_ROS
from zensim.proto.topic_endpoints import make_topic_factory
from zensim.robot_agent.network import Network
from zensim.robot_agent.pool.commands import FleetCommands
from zensim.robot_agent.pool.constants import Constants
from zensim.robot_agent.pool.kinds import Kind, is_common, kind_of, topics_of
from zensim.robot_agent.pool.outlet import FleetOutlet
from zensim.robot_agent.pool.ros_face import RosFace
from zensim.robot_agent.pool.rows import NEW, FloatArray
from zensim.robot_agent.pool.seating import Seating, claims_in
from zensim.robot_agent.pool.squad import Member, PoolState, Squad
from zensim.robot_agent.reading import Reading
from zensim.robot_agent.robot import NODE, Robot

LOG = logging.getLogger("zensim.agent")
NODE_OF_SQUAD = "zensim_pool"
CONSTANT = frozenset({keys.TF_STATIC, keys.ROBOT_DESCRIPTION})


@dataclass(frozen=True)
class _Loner:
    """A robot that is driven by itself, and where it stands in the arrays of its pool."""

    robot: Robot
    place: int
    joints: slice
    targets: slice


class PoolFleet:
    """Robots by claim, in squads of one kind; those that no squad can drive, one by one."""

    def __init__(
        self,
        network: Network,
        timeout_ns: int,
        graph: RosGraph | None = None,
        ears: Network | None = None,
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
        self._members: dict[int, Member] = {}
        self._robots: dict[int, Robot] = {}
        self._outlets: dict[tuple[str, type[msgspec.Struct]], FleetOutlet] = {}
        self._constants = Constants(self._outlet, self._ros)
        self._commands = FleetCommands(ears or network, timeout_ns, graph.domain if graph else None)
        self._squads: dict[Kind, Squad] = {}
        self._claims: bytes | None = None
        self._seating = Seating((), ())
        self._loners: tuple[_Loner, ...] = ()

    def take(self, claims: Sequence[Claim]) -> None:
        """Hold what was claimed: it is heard from now on, and told of from its first state on."""
        for claim in claims:
            if is_common(claim.model):
                topics = topics_of(claim, self._ros)
                self._commands.listen(topics.cmd_vel)
                member = Member(claim, kind_of(claim.model, topics), topics)
                member.node = self._greeted(claim.namespace, topics.cmd_vel)
                member.constants = self._constants.add(claim, member.node)
                self._members[claim.claim] = member
            else:
                faces = make_topic_factory(self._network, self._graph, claim.namespace, NODE)
                robot = Robot(faces, claim, self._timeout_ns)
                robot.announce()
                self._robots[claim.claim] = robot
        self._claims = None
        self.newest_claim = max((*self._members, *self._robots), default=0)

    def lose_all_but(self, claims: bytes) -> tuple[str, ...]:
        """Let go the robots that are not among these claims, and name them."""
        if claims == self._claims:
            return ()
        held = (*self._members, *self._robots)
        gone = set(held).difference(claims_in(claims))
        if not gone:
            return ()
        lost = tuple(self._dismiss(claim) for claim in held if claim in gone)
        self._claims = None
        self.newest_claim = max((*self._members, *self._robots), default=0)
        if not self.newest_claim:
            self._recut(b"")
        return lost

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held; a state of a claim given up is not for this fleet.

        Raises:
            MalformedPayload: They are not whole numbers of 4 bytes.
        """
        if claims == self._claims:
            return True
        return all(claim in self._members or claim in self._robots for claim in claims_in(claims))

    def reset(self) -> None:
        """Start all robots again."""
        self._commands.reset()
        for squad in self._squads.values():
            squad.reset()
        for robot in self._robots.values():
            robot.reset()

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive every robot of a state by one control period.

        Raises:
            MalformedPayload: The state does not fit the robots.
        """
        if state.claims != self._claims:
            self._recut(state.claims)
        read = self._seating.read(state, self._commands.at(state.time_ns))
        targets = np.zeros(self._seating.target_total)
        for squad in self._squads.values():
            squad.advance(read, targets)
        for loner in self._loners:
            targets[loner.targets] = loner.robot.advance(_reading_of(loner, read))
        return DriveCommand(state.epoch, state.step, state.claims, _bytes_of(targets))

    def revise(self) -> None:
        """Answer states only: for one robot's command, arrays of all would be made anew."""

    def tell(self) -> None:
        """Publish what the last state made due."""
        for squad in self._squads.values():
            squad.tell()
        for loner in self._loners:
            loner.robot.tell()

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
        for (pattern, _), outlet in self._outlets.items():
            if keys.last_chunk(pattern) in CONSTANT:
                outlet.announce()
        for robot in self._robots.values():
            robot.announce()

    def complain(self) -> None:
        """Log which commands were malformed."""
        for key, complaint in self._commands.complaints():
            LOG.warning("cmd_vel key=%s %s", key, complaint)
        for robot in self._robots.values():
            if robot.commanded and (complaint := robot.commanded.take_complaint()):
                LOG.warning("cmd_vel entity=%s %s", robot.entity, complaint)

    def _dismiss(self, claim: int) -> str:
        if (robot := self._robots.pop(claim, None)) is not None:
            robot.close()
            return robot.entity
        member = self._members.pop(claim)
        self._constants.remove(member.constants)
        if member.kind in self._squads:
            self._squads[member.kind].dismiss(member)
        if member.node is not None:
            member.node.close()
        return member.claim.entity

    def _recut(self, claims: bytes) -> None:
        """Take the robots in the order of a state, and carry over what each remembers."""
        order = claims_in(claims)
        self._seating, self._claims = self._seating_of(order), claims
        members = [self._members.get(one) for one in order]
        self._commands.recut(
            [member.topics.cmd_vel if member else "" for member in members],
            np.array([member.place if member else NEW for member in members], dtype=np.int64),
        )
        squads: dict[Kind, list[Member]] = {}
        for place, member in enumerate(members):
            if member is not None:
                member.place = place
                squads.setdefault(member.kind, []).append(member)
        for kind in [kind for kind in self._squads if kind not in squads]:
            self._squads.pop(kind).close()
        self._squads = {kind: self._squad(kind, cast) for kind, cast in squads.items()}
        self._loners = tuple(
            _Loner(self._robots[one], place, *self._seating.of_one(place))
            for place, one in enumerate(order)
            if one in self._robots
        )
        for key in [key for key, outlet in self._outlets.items() if outlet.is_empty]:
            self._outlets.pop(key).close()

    def _squad(self, kind: Kind, members: Sequence[Member]) -> Squad:
        squad = self._squads.get(kind) or Squad(kind, self._outlet, self._squads_node())
        squad.recut(members, self._seating.of_squad([member.place for member in members]))
        return squad

    def _seating_of(self, order: Sequence[int]) -> Seating:
        joints, targets = [], []
        for one in order:
            if (member := self._members.get(one)) is not None:
                joints.append(member.kind.joint_count)
                targets.append(member.kind.target_count)
            else:
                joints.append(self._robots[one].joint_count)
                targets.append(self._robots[one].target_count)
        return Seating(joints, targets)

    def _outlet(self, pattern: str, message: type[msgspec.Struct]) -> FleetOutlet:
        key = (pattern, message)
        if key not in self._outlets:
            ros = self._ros_face(Topic(pattern, message, keys.last_chunk(pattern) in CONSTANT))
            self._outlets[key] = FleetOutlet(self._network, pattern, message, ros)
        return self._outlets[key]

    def _ros_face(self, topic: Topic) -> RosFace | None:
        if self._graph is None or self._graph.domain is None:
            return None
        return RosFace(self._network, self._graph, topic)

    def _squads_node(self) -> RosNode | None:
        """Add to ROS 2's graph who tells what a squad's robots share."""
        if self._graph is None:
            return None
        number = next(self._numbers)
        return self._graph.node("", f"{NODE_OF_SQUAD}_{self._graph.zid[:8]}_{number}")

    def _greeted(self, namespace: str, cmd_vel: str) -> RosNode | None:
        """Let a robot into ROS 2's graph: as a node that hears commands."""
        node = self._graph.node(namespace, NODE) if self._graph else None
        if node is not None:
            for kind in (Twist, TwistStamped):
                node.add_topic_endpoint("MS", Topic(cmd_vel, kind))
        return node


def _reading_of(loner: _Loner, read: PoolState) -> Reading:
    return Reading(
        read.time_ns,
        tuple(read.base[loner.place].tolist()),
        tuple(read.positions[loner.joints].tolist()),
        tuple(read.velocities[loner.joints].tolist()),
    )


def _bytes_of(numbers: FloatArray) -> bytes:
    return numbers.astype("<f8").tobytes()
