"""Transforms of robots of one kind: on each robot's own topic, and on the one of all robots."""

from collections.abc import Iterator, Sequence

import numpy as np

from zensim.proto import keys
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.ros2.ros_graph import RosNode
from zensim.robot_agent import templates
from zensim.robot_agent.pool.frame_poses import FramePoses
from zensim.robot_agent.pool.joined_images import JoinedImages
from zensim.robot_agent.pool.outlet import FleetOutlet, Line
from zensim.robot_agent.pool.rows import IntArray, carried_flags, carried_ints
from zensim.robot_agent.pool.topic import SquadTopic

MESSAGE_BYTES = 32768
"""About as much as a message has at most: one that is cut in pieces is lost with any of them."""


class TransformTopic(SquadTopic):
    """A message a robot, with its frames as described."""

    def __init__(self, poses: FramePoses, outlet: FleetOutlet, count: int) -> None:
        """Take whose frames, where they are told, and how many each robot has."""
        super().__init__(
            outlet,
            numbers=poses.of,
            paths=templates.tf_paths(count),
            stamps=templates.tf_stamps(count),
        )


class SharedTransforms:
    """Messages of many robots, with frames that begin with their namespaces."""

    def __init__(self, poses: FramePoses, outlet: FleetOutlet, node: RosNode | None) -> None:
        """Declare the topic.

        Args:
            poses: Of the frames.
            outlet: Where they leave.
            node: Who tells it in ROS 2, and nothing else.
        """
        self._node = node
        self._poses = poses
        self._outlet = outlet
        self._line = Line(keys.TF, self, node=node)
        outlet.add(self._line)
        self._templates: Sequence[TFMessage] = ()
        self._images: JoinedImages | None = None
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._told_ns = np.zeros(0, dtype=np.int64)

    def recut(self, written: Sequence[TFMessage], before: IntArray) -> None:
        """Take the robots as they are now: a message of each; see `rows.carried`."""
        self._templates, self._images = written, None
        self._has_value = carried_flags(self._has_value, before)
        self._told_ns = carried_ints(self._told_ns, before)

    def reset(self) -> None:
        """Forget all values: time may have gone back."""
        self._has_value[:] = False

    def tell(self, rows: IntArray, time_ns: int) -> None:
        """Tell the frames of some rows."""
        if not len(rows):
            return
        self._has_value[rows] = True
        self._told_ns[rows] = time_ns
        if self._outlet.is_wanted:
            for message in self._messages(rows):
                self._outlet.put((self._line,), (message,))

    def payload(self, row: int) -> bytes | None:  # noqa: ARG002 - of the protocol
        """Write the last values of all; see `outlet.Values`."""
        rows = np.flatnonzero(self._has_value)
        if not len(rows):
            return None
        return self._written().message(rows, self._poses.of(rows), self._told_ns[rows])

    def close(self) -> None:
        """Withdraw the topic."""
        self._outlet.remove(self._line)
        if self._node is not None:
            self._node.close()

    def _messages(self, rows: IntArray) -> Iterator[bytes]:
        images, poses, told_ns = self._written(), self._poses.of(rows), self._told_ns[rows]
        most = max(1, MESSAGE_BYTES // images.size(int(rows[0])))
        for start in range(0, len(rows), most):
            part = slice(start, start + most)
            yield images.message(rows[part], poses[part], told_ns[part])

    def _written(self) -> JoinedImages:
        # Only when somebody wants them: fleets come robot by robot.
        if self._images is None:
            self._images = JoinedImages(self._templates)
        return self._images
