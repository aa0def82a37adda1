"""The robots that an agent holds, in the order in which the server speaks of them."""

import logging
import struct
from collections.abc import Sequence

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.topic_endpoints import make_topic_factory
from zensim.robot_agent.network import Network
from zensim.robot_agent.reading import Layout
from zensim.robot_agent.robot import NODE, Robot

LOG = logging.getLogger("zensim.agent")


class Fleet:
    """Robots by claim; each drive state says which of them are left."""

    def __init__(self, network: Network, timeout_ns: int, graph: RosGraph | None = None) -> None:
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
        self._ordered: tuple[Robot, ...] = ()
        self._state: DriveState | None = None
        """That was answered last."""
        self._layout = Layout(())

    @property
    def robots(self) -> tuple[Robot, ...]:
        """All robots that are held."""
        return tuple(self._robots.values())

    def take(self, claims: Sequence[Claim]) -> None:
        """Hold what was claimed."""
        for claim in claims:
            faces = make_topic_factory(self._network, self._graph, claim.namespace, NODE)
            robot = Robot(faces, claim, self._timeout_ns)
            robot.announce()
            self.hold(claim.claim, robot)

    def hold(self, claim: int, robot: Robot) -> None:
        """Add a robot under its claim."""
        self._robots[claim] = robot
        self.newest_claim = max(self._robots)
        self._claims = None

    def lose_all_but(self, claims: bytes) -> tuple[str, ...]:
        """Let go the robots that are not among these claims, and name them."""
        if claims == self._claims and len(self._ordered) == len(self._robots):
            return ()
        kept = set(_ids(claims))
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
        return claims == self._claims or all(claim in self._robots for claim in _ids(claims))

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
            self._ordered = tuple(self._robots[claim] for claim in _ids(state.claims))
            self._layout = Layout([robot.joint_count for robot in self._ordered])
            self._claims = state.claims
        readings = self._layout.readings(state)
        for robot, reading in zip(self._ordered, readings, strict=True):
            robot.advance(reading)
        self._state = state
        return self._command(state)

    def revise(self) -> DriveCommand | None:
        """Answer the last state anew if a twist has come since that changes the answer."""
        if self._state is None or self._state.claims != self._claims:
            return None
        # All are asked: each takes what it hears.
        is_revised = [robot.revise() for robot in self._ordered]
        return self._command(self._state) if any(is_revised) else None

    def tell(self) -> None:
        """Publish what the last state made due."""
        for robot in self._ordered:
            robot.tell()

    def _command(self, state: DriveState) -> DriveCommand:
        targets = [target for robot in self._ordered for target in robot.targets]
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

    def complain(self) -> None:
        """Log which commands were malformed."""
        for robot in self._robots.values():
            if robot.commanded and (complaint := robot.commanded.take_complaint()):
                LOG.warning("cmd_vel entity=%s %s", robot.entity, complaint)


def _ids(claims: bytes) -> tuple[int, ...]:
    if len(claims) % 4:
        raise MalformedPayload(f"{len(claims)} bytes of claims; each has 4")
    return struct.unpack(f"<{len(claims) // 4}I", claims)
