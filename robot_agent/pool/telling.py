"""What robots of one kind tell of their motion and joints, as `robot_agent.telemetry` has it."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from proto.model import Joint, Model
from proto.topics import JointState, Odometry, TFMessage
from robot_agent import templates
from robot_agent.driven_base import motion_rates
from robot_agent.pool.driven import DrivenBases
from robot_agent.pool.joint_frames import POSE_COLUMNS, JointFrames
from robot_agent.pool.kinds import Kind, Topics
from robot_agent.pool.outlet import FleetOutlet
from robot_agent.pool.rate_gates import RateGates
from robot_agent.pool.rows import FloatArray, IntArray, carried
from robot_agent.pool.topic import SquadTopic
from robot_agent.tf_outlets import with_namespace

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


class TransformTopic(SquadTopic):
    """The odometry frame, and the frames of moving joints."""

    def __init__(self, kind: Kind, pattern: str, bases: DrivenBases, outlet_of: OutletOf) -> None:
        count = templates.tf_count(kind.drive, kind.moving)
        super().__init__(
            outlet_of(pattern, TFMessage),
            numbers=self._poses,
            paths=templates.tf_paths(count),
            stamps=templates.tf_stamps(count),
            rate_hz=motion_rates(kind.drive)[2],
        )
        self._bases = bases
        self._has_odometry = kind.drive.publish_odom_tf
        self._frames = JointFrames(msgspec.msgpack.decode(kind.geometry, type=tuple[Joint, ...]))
        self._moving = list(kind.moving)
        self._positions = np.zeros((0, len(kind.moving)))

    def carry(self, before: IntArray) -> None:
        """See `SquadTopic`."""
        super().carry(before)
        self._positions = carried(self._positions, before)

    def tell_poses(self, rows: IntArray, positions: FloatArray, time_ns: int) -> None:
        """Tell the frames of some rows; positions are of all joints of all rows."""
        rows = self.due(rows, time_ns)
        self._positions[rows] = positions[rows][:, self._moving]
        self.tell(rows, time_ns)

    def _poses(self, rows: IntArray) -> FloatArray:
        joints = self._frames.poses(self._positions[rows]).reshape(len(rows), -1)
        if not self._has_odometry:
            return joints
        return np.concatenate([self._bases.motions[rows, :POSE_COLUMNS], joints], axis=1)


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

    def __init__(self, kind: Kind, bases: DrivenBases, outlet_of: OutletOf) -> None:
        wanted = kind.patterns
        self._published = kind.published
        self.odometry = OdometryTopic(kind, bases, outlet_of) if wanted.odom else None
        self.transforms = tuple(
            TransformTopic(kind, pattern, bases, outlet_of)
            for pattern in (wanted.tf, wanted.shared_tf)
            if pattern
        )
        self._shared = self.transforms[-1] if wanted.shared_tf else None
        self.joints = JointTopic(kind, outlet_of) if wanted.joint_states else None

    @property
    def topics(self) -> tuple[SquadTopic, ...]:
        """Those that there are, in the order of `keys_of` and of `templates_of`."""
        found = (self.odometry, *self.transforms, self.joints)
        return tuple(topic for topic in found if topic is not None)

    def keys_of(self, topics: Topics) -> tuple[str, ...]:
        """List where a robot tells each of them."""
        told = (topics.odom, topics.tf, topics.shared_tf, topics.joint_states)
        return tuple(key for key in told if key)

    def templates_of(self, model: Model) -> Sequence[msgspec.Struct]:
        """Write the messages of a robot without a name, one a topic."""
        made: list[msgspec.Struct] = []
        if self.odometry is not None:
            made.append(templates.odometry_template(model))
        made += [templates.tf_template(model)] * len(self.transforms)
        if self.joints is not None:
            made.append(templates.joint_states_template(model, self._published))
        return made

    def named(self, written: Sequence[msgspec.Struct], namespace: str) -> Sequence[msgspec.Struct]:
        """Write a robot's name into those messages that all robots share a topic for."""
        return [
            with_namespace(message, namespace)
            if topic is self._shared and isinstance(message, TFMessage)
            else message
            for topic, message in zip(self.topics, written, strict=True)
        ]

    def reset(self) -> None:
        """Start again: time may have gone back."""
        for topic in self.topics:
            topic.reset()

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
        for transforms in self.transforms:
            transforms.tell_poses(rows, positions, time_ns)
        if self.joints is not None:
            self.joints.tell_joints(positions, velocities, time_ns)
