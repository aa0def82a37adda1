"""What robots of one kind tell of their motion and joints, as `robot_agent.telemetry` has it."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import JointState, Odometry, TFMessage
from zensim.proto.ros2.ros_graph import RosNode
from zensim.robot_agent import templates
from zensim.robot_agent.driven_base import motion_rates
from zensim.robot_agent.pool.driven import DrivenBases
from zensim.robot_agent.pool.frame_poses import FramePoses
from zensim.robot_agent.pool.kinds import Kind, Topics
from zensim.robot_agent.pool.outlet import FleetOutlet
from zensim.robot_agent.pool.rate_gates import RateGates
from zensim.robot_agent.pool.rows import FloatArray, IntArray, carried
from zensim.robot_agent.pool.tf_topics import SharedTransforms, TransformTopic
from zensim.robot_agent.pool.topic import SquadTopic
from zensim.robot_agent.tf_outlets import with_namespace

OutletOf = Callable[[str, type[msgspec.Struct]], FleetOutlet]
"""Finds the outlet of a pattern."""


class OdometryTopic(SquadTopic):
    """Odometry, at a rate of its own or with every motion."""

    def __init__(self, kind: Kind, bases: DrivenBases, outlet_of: OutletOf) -> None:
        super().__init__(
            outlet_of(kind.patterns.odom, Odometry),
            numbers=lambda rows: bases.motions[rows],
            paths=templates.ODOMETRY_PATHS,
            stamps=templates.HEADER_STAMP,
            rate_hz=motion_rates(kind.drive)[1],
        )


class JointTopic(SquadTopic):
    """Positions and velocities of joints, at a rate of their own."""

    def __init__(self, kind: Kind, outlet_of: OutletOf) -> None:
        count = len(kind.published)
        super().__init__(
            outlet_of(kind.patterns.joint_states, JointState),
            numbers=lambda rows: self._states[rows],
            paths=templates.joint_paths(count),
            stamps=templates.HEADER_STAMP,
        )
        self._gates = RateGates(kind.joint_states_hz)
        self._published = list(kind.published)
        self._states = np.zeros((0, 2 * count))

    def carry(self, before: IntArray) -> None:
        """See `SquadTopic`."""
        super().carry(before)
        self._gates.recut(before)
        self._states = carried(self._states, before)

    def reset(self) -> None:
        """See `SquadTopic`."""
        super().reset()
        self._gates.reset()

    def tell_joints(self, positions: FloatArray, velocities: FloatArray, time_ns: int) -> None:
        """Tell the joints of those rows that are due."""
        rows, _ = self._gates.open(time_ns)
        if len(rows):
            told = positions[rows][:, self._published], velocities[rows][:, self._published]
            self._states[rows] = np.concatenate(told, axis=1)
            self.tell(rows, time_ns)


class Telling:
    """The topics of one kind."""

    def __init__(
        self, kind: Kind, bases: DrivenBases, outlet_of: OutletOf, node: RosNode | None
    ) -> None:
        """Declare the topics.

        Args:
            kind: Of the robots.
            bases: Their motions.
            outlet_of: See there.
            node: Who tells in ROS 2 what all robots share a topic for.
        """
        wanted = kind.patterns
        self._published = kind.published
        self.odometry = OdometryTopic(kind, bases, outlet_of) if wanted.odom else None
        self._poses = poses = FramePoses(kind, bases)
        self.transforms: TransformTopic | None = None
        self.shared: SharedTransforms | None = None
        if wanted.tf:
            count = templates.tf_count(kind.drive, kind.moving)
            self.transforms = TransformTopic(poses, outlet_of(wanted.tf, TFMessage), count)
        if wanted.shared_tf:
            self.shared = SharedTransforms(poses, outlet_of(wanted.shared_tf, TFMessage), node)
        self.joints = JointTopic(kind, outlet_of) if wanted.joint_states else None

    @property
    def topics(self) -> tuple[SquadTopic, ...]:
        """Those that each robot has, in the order of `keys_of` and of `templates_of`."""
        found = (self.odometry, self.transforms, self.joints)
        return tuple(topic for topic in found if topic is not None)

    def keys_of(self, topics: Topics) -> tuple[str, ...]:
        """List where a robot tells each of them."""
        return tuple(key for key in (topics.odom, topics.tf, topics.joint_states) if key)

    def templates_of(self, model: Model) -> Sequence[msgspec.Struct]:
        """Write the messages of a robot without a name, one a topic."""
        made: list[msgspec.Struct] = []
        if self.odometry is not None:
            made.append(templates.odometry_template(model))
        if self.transforms is not None:
            made.append(templates.tf_template(model))
        if self.joints is not None:
            made.append(templates.joint_states_template(model, self._published))
        return made

    def shared_template(self, model: Model, namespace: str) -> TFMessage | None:
        """Write what a robot has on the topic that all share."""
        if self.shared is None:
            return None
        return with_namespace(templates.tf_template(model), namespace)

    def recut_shared(self, written: Sequence[TFMessage], before: IntArray) -> None:
        """Take the robots as they are now: what each has on the topic that all share."""
        self._poses.carry(before)
        if self.shared is not None:
            self.shared.recut(written, before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self._poses.reset()
        for topic in self.topics:
            topic.reset()
        if self.shared is not None:
            self.shared.reset()

    def tell(
        self, rows: IntArray, *, positions: FloatArray, velocities: FloatArray, time_ns: int
    ) -> None:
        """Tell what is due.

        Args:
            rows: Those whose motion is new.
            positions: Of all joints of all rows, (n, joint_count).
            velocities: The same, a second.
            time_ns: Simulation time.
        """
        if self.odometry is not None:
            self.odometry.tell(self.odometry.due(rows, time_ns), time_ns)
        rows = self._poses.take(rows, positions, time_ns)
        if self.transforms is not None:
            self.transforms.tell(rows, time_ns)
        if self.shared is not None:
            self.shared.tell(rows, time_ns)
        if self.joints is not None:
            self.joints.tell_joints(positions, velocities, time_ns)

    def close(self) -> None:
        """Withdraw what all robots share a topic for; the rest goes with them."""
        if self.shared is not None:
            self.shared.close()
