"""What never changes of a robot: its fixed transforms and its description, written once a model."""

from collections.abc import Iterator

import msgspec

from zensim.proto import keys
from zensim.proto.codec import cdr
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import String, TFMessage, Time
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.robot_agent.frames import base_of, fixed_edges
from zensim.robot_agent.pool.outlet import FleetOutlet, Line
from zensim.robot_agent.pool.telling import OutletOf
from zensim.robot_agent.tf_static import tf_static_of


class Constant:
    """A value that is always the same; see `outlet.Values`."""

    def __init__(self, message: msgspec.Struct) -> None:
        self._payload = cdr.encode(message)

    def payload(self, row: int) -> bytes:  # noqa: ARG002 - of the protocol
        """Tell it."""
        return self._payload


class Constants:
    """Puts robots' constants on their outlets; robots of one model share them."""

    def __init__(self, outlet_of: OutletOf, ros: RosSettings = NO_ROS) -> None:
        self._outlet_of = outlet_of
        self._ros = ros
        self._fixed: dict[int, _Fixed] = {}
        self._texts: dict[str, Constant] = {}

    def add(self, claim: Claim, node: RosNode | None = None) -> tuple[Line, ...]:
        """Begin to tell a robot's constants; its node is in ROS 2's graph."""
        lines = tuple(Line(key, value, node=node) for key, value in self._values(claim))
        for line in lines:
            self._outlet(line).add(line)
        return lines

    def remove(self, lines: tuple[Line, ...]) -> None:
        """Withdraw a robot's constants."""
        for line in lines:
            self._outlet(line).remove(line)

    def forget(self) -> None:
        """Let go of what was written: no robot is left."""
        self._fixed.clear()
        self._texts.clear()

    def _values(self, claim: Claim) -> Iterator[tuple[str, Constant]]:
        fixed = self._fixed_of(claim.model)
        for key, message in tf_static_of(claim, fixed.message, self._ros):
            is_own = message is fixed.message
            yield key, fixed.constant if is_own else Constant(message)
        if text := claim.robot_description:
            if text not in self._texts:
                self._texts[text] = Constant(String(text))
            yield keys.robot(claim.namespace, keys.ROBOT_DESCRIPTION), self._texts[text]

    def _fixed_of(self, model: Model) -> "_Fixed":
        if (found := self._fixed.get(id(model))) is None:
            found = self._fixed[id(model)] = _Fixed(model)
        return found

    def _outlet(self, line: Line) -> FleetOutlet:
        topic = keys.last_chunk(line.key)
        kind = TFMessage if topic == keys.TF_STATIC else String
        return self._outlet_of(keys.make_pattern(line.key), kind)


class _Fixed:
    """The fixed transforms of a model, which is kept beside so that its id stays its own."""

    def __init__(self, model: Model) -> None:
        self.model = model
        # Stamped 0: it holds from the beginning of time.
        edges = fixed_edges(model, base_of(model))
        self.message = TFMessage(tuple(edge.stamped(Time()) for edge in edges))
        self.constant = Constant(self.message)
