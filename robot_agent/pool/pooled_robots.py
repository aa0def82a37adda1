"""The robots of a pool: groups in arrays, and single robots that no group can hold."""

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import Format, MalformedPayload, make_encoding
from zensim.proto.fleet_topics.fleet_publisher import FleetTopicPublisher
from zensim.proto.fleet_topics.ros_fleet_publisher import RosFleetPublisher
from zensim.proto.fleet_topics.topic_members import TopicMember
from zensim.proto.message_paths import ODOMETRY_COLUMNS
from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim, DriveCommand, DriveState
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Twist, TwistStamped, Vector3
from zensim.proto.network_protocols import AgentNetwork, Sample
from zensim.proto.ros2.node_services import NodeParameters, NodeServices
from zensim.proto.ros2.rmw_keys import ANY_HASH, make_data_key
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, RosTopic
from zensim.proto.ros2.ros_settings import NO_ROS
from zensim.proto.subscriber_search import SubscriberWatches
from zensim.proto.topic_catalog import CMD_VEL, TopicSpec
from zensim.proto.topic_endpoints import TopicFactory, TopicSubscription, make_topic_factory
from zensim.proto.topic_faults import TopicFaults
from zensim.robot_agent.base_controller import has_own_tf_rate
from zensim.robot_agent.bumpers import ContactReport
from zensim.robot_agent.drive_state_decoder import RobotState, is_repeated, unpack_claims
from zensim.robot_agent.fleet_odometry import MotionRows
from zensim.robot_agent.joint_control import JointControl, make_joint_control
from zensim.robot_agent.pool.group_bases import GroupBaseController
from zensim.robot_agent.pool.group_key import GroupKey, GroupKeys
from zensim.robot_agent.pool.group_sensors import GroupSensors
from zensim.robot_agent.pool.group_telemetry import FindPublisher, GroupTelemetry
from zensim.robot_agent.pool.pooled_bumpers import PooledBumpers
from zensim.robot_agent.pool.static_topics import SharedStaticTopic, StaticTopics
from zensim.robot_agent.robot_parameters import list_robot_parameters
from zensim.robot_agent.robot_rows import (
    NEW_ROW,
    FloatArray,
    IntArray,
    RowPlaces,
    StateRows,
    find_index,
    make_row_places,
    remap_floats,
    remap_ints,
)
from zensim.robot_agent.robots import NODE_NAME, SENSOR_TYPES, DrivenRobot, log_malformed_commands
from zensim.robot_agent.topic_remapping import RobotTopicKeys, find_topic_keys

FLEET_CMD_VEL_DEPTH = 8192
NEVER_NS = 2**63 - 1
TWIST_COLUMNS = 6
ORDERED_COLUMNS = (0, 1, 5)
"""Columns of a twist that a drive state can order: forward, left, turn."""
TWIST_BYTES = 52
TWIST_DTYPE = np.dtype([("header", "S4"), ("numbers", "<f8", TWIST_COLUMNS)])
LITTLE_ENDIAN = b"\x00\x01"
PLAIN_ENCODINGS = frozenset({make_encoding(Twist, Format.CDR), Format.CDR.value, "zenoh/bytes", ""})
"""Encodings with which 52 bytes of CDR are a Twist."""
FLOAT_BYTES = 8
LOG = logging.getLogger("zensim.agent")
GROUP_NODE_PREFIX = "zensim_pool"


class FleetCmdVel:
    """The current velocity commands, a row per robot; zero until the first one."""

    def __init__(self, network: AgentNetwork, timeout_ns: int, domain: int | None = None) -> None:
        """Create it without subscriptions.

        Args:
            network: Session of the subscriptions.
            timeout_ns: Simulation time for which a command is valid; 0 = for ever.
            domain: ROS 2 domain to subscribe in, too; None = none.
        """
        self._domain = domain
        self._network = network
        self._timeout_ns = timeout_ns
        self._subscriptions: dict[str, TopicSubscription] = {}
        self._rows: dict[str, tuple[int, ...]] = {}
        self._twists = np.zeros((0, TWIST_COLUMNS))
        self._received_ns = np.zeros(0, dtype=np.int64)
        self._later_ns: int | None = None
        self._none_ends_ns = NEVER_NS
        """Simulation time until which no command is too old."""
        self._ordered: FloatArray | None = None
        """Ordered twists of the last call of `at`, and their rows."""
        self._ordered_rows = np.zeros(0, dtype=np.int64)
        self._faults: dict[str, tuple[int, str]] = {}

    def listen(self, key: str) -> None:
        """Subscribe to a key; its robot gets a row later."""
        pattern = keys.make_pattern(key)
        if pattern not in self._subscriptions:
            self._subscriptions[pattern] = self._subscribe(pattern)

    def _subscribe(self, pattern: str) -> TopicSubscription:
        plain = self._network.subscribe(pattern, FLEET_CMD_VEL_DEPTH)
        if self._domain is None:
            return TopicSubscription(plain, ())
        ros_keys = [
            make_data_key(self._domain, pattern, kind.ros_type, ANY_HASH)
            for kind in (Twist, TwistStamped)
        ]
        return TopicSubscription(
            plain, [self._network.subscribe(one, FLEET_CMD_VEL_DEPTH) for one in ros_keys]
        )

    def remap(self, robots: Sequence[str], before: IntArray) -> None:
        """Remap rows; see `remap_floats`.

        Args:
            robots: The key of each row; empty for a robot that is not in a group.
            before: Former row of each.
        """
        self._twists = remap_floats(self._twists, before)
        self._received_ns = remap_ints(self._received_ns, before)
        self._rows, self._ordered = {}, None
        for row, key in enumerate(robots):
            if not key:
                continue
            self._rows[key] = (*self._rows.get(key, ()), row)
            self.listen(key)
        patterns = {keys.make_pattern(key) for key in self._rows}
        for pattern in [one for one in self._subscriptions if one not in patterns]:
            self._subscriptions.pop(pattern).close()

    def reset(self) -> None:
        """Forget all commands; those that wait in a subscription still count."""
        self._twists[:] = 0.0
        self._later_ns = self._ordered = None
        self._none_ends_ns = NEVER_NS

    def receive_later(self, time_ns: int) -> bool:
        """Take commands that came after a state, and end a rest; return whether there were some.

        Their time counts from the next call of `at` on.

        Args:
            time_ns: Simulation time of that state.
        """
        if not (received := self._take_samples()):
            return False
        self._store_newest(received, time_ns)
        self._later_ns, self._ordered = time_ns, None
        return True

    def are_idle(self, ordered: FloatArray | None) -> bool:
        """Whether all commands are zero, except those of rows with an ordered twist (n, 3)."""
        moving = self._twists.any(axis=1)
        return not (moving if ordered is None else moving & np.isnan(ordered[:, 0])).any()

    def at(self, time_ns: int, ordered: FloatArray | None = None) -> FloatArray:
        """Find the commands (n, 6) at a simulation time.

        Args:
            time_ns: Simulation time.
            ordered: Twists (n, 3) that replace those received, except rows that are NaN.
        """
        if self._later_ns not in (None, time_ns):
            self._received_ns[self._received_ns == self._later_ns] = time_ns
            self._later_ns = None
        received = self._take_samples()
        if received:
            self._store_newest(received, time_ns)
        if ordered is not None:
            self._order(ordered, time_ns, is_known=ordered is self._ordered and not received)
        self._ordered = ordered
        if self._timeout_ns and time_ns > self._none_ends_ns:
            self._end_old(time_ns)
        return self._twists

    def _order(self, ordered: FloatArray, time_ns: int, *, is_known: bool) -> None:
        """Replace the commands of rows that are not NaN, unless they are those of the last call."""
        if not is_known:
            self._ordered_rows = rows = np.flatnonzero(~np.isnan(ordered[:, 0]))
            self._twists[rows] = 0.0
            self._twists[rows[:, None], ORDERED_COLUMNS] = ordered[rows]
            self._none_ends_ns = min(self._none_ends_ns, time_ns + self._timeout_ns)
        self._received_ns[find_index(self._ordered_rows, len(self._received_ns))] = time_ns

    def _end_old(self, time_ns: int) -> None:
        """Set the commands to zero whose time is over, and find how long no other one's is."""
        self._twists[time_ns - self._received_ns > self._timeout_ns] = 0.0
        moving = self._received_ns[self._twists.any(axis=1)]
        self._none_ends_ns = int(moving.min(initial=NEVER_NS - self._timeout_ns)) + self._timeout_ns

    def take_malformed_reports(self) -> Iterator[tuple[str, str]]:
        """Describe the malformed commands since the last call, by key."""
        faults, self._faults = self._faults, {}
        for key, (faulty, reason) in faults.items():
            yield key, f"malformed={faulty} reason={reason!r}"

    def _take_samples(self) -> dict[tuple[int, ...], list[Sample]]:
        received: dict[tuple[int, ...], list[Sample]] = {}
        for subscription in self._subscriptions.values():
            for sample in subscription.take():
                # The pattern matches robots of other pools, too.
                if (rows := self._rows.get(sample.key)) is not None:
                    received.setdefault(rows, []).append(sample)
        return received

    def _store_newest(self, received: dict[tuple[int, ...], list[Sample]], time_ns: int) -> None:
        plain = {
            rows: samples for rows, samples in received.items() if _is_plain_twist(samples[-1])
        }
        if plain:
            packed = b"".join([samples[-1].payload for samples in plain.values()])
            numbers = np.frombuffer(packed, dtype=TWIST_DTYPE)["numbers"]
            is_finite = np.isfinite(numbers).all(axis=1)
            for rows, fits in zip(list(plain), is_finite.tolist(), strict=True):
                if not fits:
                    del plain[rows]
            self._store(list(plain), numbers[is_finite], time_ns)
        for rows in received.keys() - plain.keys():
            if (twist := self._decode_newest(received[rows])) is not None:
                linear, angular = twist.linear, twist.angular
                row = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
                self._store([rows], np.array([row]), time_ns)

    def _store(self, robots: list[tuple[int, ...]], twists: FloatArray, time_ns: int) -> None:
        rows = [row for several in robots for row in several]
        if len(rows) != len(robots):
            twists = np.repeat(twists, [len(several) for several in robots], axis=0)
        self._twists[rows] = twists
        self._received_ns[rows] = time_ns
        self._none_ends_ns = min(self._none_ends_ns, time_ns + self._timeout_ns)

    def _decode_newest(self, samples: list[Sample]) -> Twist | None:
        """Decode the newest valid command: a malformed one does not hide the one before it."""
        for sample in reversed(samples):
            if (twist := self._decode(sample)) is not None:
                return twist
        return None

    def _decode(self, sample: Sample) -> Twist | None:
        try:
            return decode_twist(sample.payload, sample.encoding)
        except MalformedPayload as error:
            faulty, _ = self._faults.get(sample.key, (0, ""))
            self._faults[sample.key] = (faulty + 1, str(error))
            return None


def _is_plain_twist(sample: Sample) -> bool:
    return (
        len(sample.payload) == TWIST_BYTES
        and sample.payload[:2] == LITTLE_ENDIAN
        and sample.encoding in PLAIN_ENCODINGS
    )


@dataclass(eq=False, slots=True)
class GroupMember:
    """One robot of a group."""

    claim: Claim
    group_key: GroupKey
    topic_keys: RobotTopicKeys
    row: int = NEW_ROW
    """Row in its group."""
    place: int = NEW_ROW
    """Place in its pool."""
    topics: tuple[TopicMember, ...] = ()
    static_topics: tuple[TopicMember, ...] = ()
    templates: Sequence[msgspec.Struct] = ()
    """One per topic."""
    node: RosNode | None = None
    """Node in the ROS 2 graph."""
    joints: JointControl | None = None
    """None without controlled joints."""


@dataclass(frozen=True)
class PoolDriveState:
    """A drive state in arrays; flat where robots differ in the count of numbers."""

    time_ns: int
    base: FloatArray
    """(n, STATE_COLUMNS)."""
    positions: FloatArray
    velocities: FloatArray
    efforts: FloatArray | None
    """None if the server does not report them."""
    twists: FloatArray
    """(n, 6)."""


@dataclass(frozen=True)
class GroupSlots:
    """Indices of a group's rows in the arrays of its pool."""

    places: RowPlaces
    """(n,)."""
    joints: RowPlaces
    """(n, joint_count)."""
    targets: RowPlaces
    """Indices of targets of the drive, (n, target_count)."""
    joint_targets: IntArray
    """Indices of targets of controlled joints, (n, joint_target_count)."""


@dataclass(frozen=True)
class _DueTelemetry:
    """Telemetry that is due at the last state."""

    rows: IntArray
    """Rows with a new motion."""
    state: StateRows


class RobotGroup:
    """States of equal robots to targets and telemetry."""

    def __init__(
        self, group_key: GroupKey, find_publisher: FindPublisher, node: RosNode | None = None
    ) -> None:
        self._bases = GroupBaseController(group_key)
        self._has_own_tf_rate = has_own_tf_rate(group_key.drive)
        self._telemetry = GroupTelemetry(group_key, self._bases, find_publisher, node)
        self._sensors = GroupSensors(group_key, find_publisher)
        self._topics = self._telemetry.topics + self._sensors.topics
        self._slots: GroupSlots | None = None
        self._jointed: list[tuple[int, JointControl]] = []
        """Rows of robots with controlled joints."""
        self._due: _DueTelemetry | None = None
        self._published: StateRows | None = None
        """State of the last telemetry."""
        self._entities: tuple[str, ...] = ()

    def remap(self, members: Sequence[GroupMember], slots: GroupSlots) -> None:
        """Set the robots, one per row, and their indices in the pool."""
        before = np.array([member.row for member in members], dtype=np.int64)
        self._slots, self._due, self._published = slots, None, None
        self._entities = tuple(member.claim.entity for member in members)
        self._jointed = [
            (row, one.joints) for row, one in enumerate(members) if one.joints is not None
        ]
        self._bases.remap(before)
        for row, member in enumerate(members):
            member.row = row
            if not member.topics:
                member.topics = self._declare_topics(member)
        self._remap_topics(members, before)

    def reset(self) -> None:
        """Reset all robots; time may have gone back."""
        self._due = None
        self._bases.reset()
        self._telemetry.reset()
        self._sensors.reset()

    def advance(self, state: PoolDriveState, targets: FloatArray) -> None:
        """Take a state; write the targets of its robots into those of the pool."""
        if (slots := self._slots) is None:
            return
        own = StateRows(
            state.time_ns,
            slots.places.read(state.base),
            slots.joints.read(state.positions),
            slots.joints.read(state.velocities),
            None if state.efforts is None else slots.joints.read(state.efforts),
        )
        rows = self._bases.update(own, slots.places.read(state.twists))
        slots.targets.write(targets, self._bases.targets)
        for row, control in self._jointed:
            numbers = control.update(state.time_ns, partial(_list_joints, own, row))
            targets[slots.joint_targets[row]] = numbers
        self._due = _DueTelemetry(rows, own)

    def repeat(self, twists: FloatArray, targets: FloatArray) -> None:
        """Write the targets of the last state again, with other twists (n, 6) of the pool."""
        if (slots := self._slots) is not None:
            self._bases.revise(slots.places.read(twists))
            slots.targets.write(targets, self._bases.targets)
            for row, control in self._jointed:
                targets[slots.joint_targets[row]] = control.targets

    def publish(self) -> None:
        """Publish what is due at the last state."""
        if (due := self._due) is not None:
            self._due, self._published = None, due.state
            self._telemetry.publish(due.rows, due.state)
            self._sensors.publish(due.state)

    def list_odometry(self, faults: TopicFaults) -> Iterator[MotionRows]:
        """List the odometry that `publish` found due; see `FleetOdometry`."""
        topic, state = self._telemetry.odometry, self._published
        if topic is None or state is None or not len(topic.due_rows):
            return
        rows, entities = topic.due_rows, self._entities
        if faults:
            affected = [self._has_fault(faults, row) for row in rows.tolist()]
            rows = rows[~np.array(affected, dtype=np.bool_)]
        if len(rows) < len(entities):
            entities = tuple(entities[row] for row in rows.tolist())
        motions = np.zeros((len(rows), STATE_COLUMNS))
        motions[:, ODOMETRY_COLUMNS] = self._bases.find_motions(rows)
        positions = state.positions[rows].astype("<f8").tobytes()
        packed = motions.astype("<f8").tobytes()
        yield MotionRows(entities, packed, positions, self._has_own_tf_rate)

    def _has_fault(self, faults: TopicFaults, row: int) -> bool:
        """Whether odometry or transforms of a robot have a fault."""
        topics = (self._telemetry.odometry, self._telemetry.transforms)
        return any(one is not None and faults.affects(one.find_key(row)) for one in topics)

    @property
    def wants_efforts(self) -> bool:
        """Whether joint states may have a subscriber."""
        return self._telemetry.wants_efforts

    @property
    def needs_all_states(self) -> bool:
        """Whether its robots have anything that moves by time: joints, sensors, encoders."""
        return bool(self._jointed or self._sensors.topics) or self._bases.needs_all_states

    def limit_updates(self, longest_s: float) -> None:
        """Set the most time [s] that an update of a drive counts."""
        self._bases.limit_updates(longest_s)

    def log_malformed(self) -> None:
        """Log refused commands of joints."""
        for row, control in self._jointed:
            if report := control.take_malformed_report():
                LOG.warning("joint_commands entity=%s %s", self._entities[row], report)

    def release(self, member: GroupMember) -> None:
        """Undeclare a robot's topics."""
        for topic, topic_member in zip(self._topics, member.topics, strict=False):
            topic.publisher.remove(topic_member)
        member.topics = ()

    def close(self) -> None:
        """Undeclare the shared topic; robots were released, or are in other groups."""
        self._telemetry.close()

    def _declare_topics(self, member: GroupMember) -> tuple[TopicMember, ...]:
        found = []
        listed = self._telemetry.list_keys(member.topic_keys) + member.topic_keys.sensors
        for topic, key in zip(self._topics, listed, strict=True):
            found.append(TopicMember(key, topic, node=member.node))
            topic.publisher.add(found[-1])
        return tuple(found)

    def _remap_topics(self, members: Sequence[GroupMember], before: IntArray) -> None:
        new = [member for member in members if not member.templates]
        models = {id(one.claim.model): one.claim.model for one in new}
        templates = {
            key: [*self._telemetry.make_templates(model), *self._sensors.make_templates(model)]
            for key, model in models.items()
        }
        for one in new:
            one.templates = templates[id(one.claim.model)]
        for number, topic in enumerate(self._topics):
            topic.remap(
                [member.topics[number] for member in members],
                [member.templates[number] for member in members],
                before,
            )
        claims = [member.claim for member in members]
        self._telemetry.remap_shared(claims, before)
        self._sensors.remap(claims, before)


class PoolStateLayout:
    """Robots in the order of a state's claims, and the start of their joints and targets."""

    def __init__(self, joint_counts: Sequence[int], target_counts: Sequence[int]) -> None:
        self._joints = np.concatenate([[0], np.cumsum(joint_counts)]).astype(np.int64)
        self._targets = np.concatenate([[0], np.cumsum(target_counts)]).astype(np.int64)
        self._packed_twists = b""
        self._twists = np.zeros((0, len(ORDERED_COLUMNS)))

    @property
    def target_total(self) -> int:
        """Count of numbers in a command."""
        return int(self._targets[-1])

    def find_group_slots(self, places: Sequence[int], target_count: int) -> GroupSlots:
        """Find the indices of robots with equal counts of joints and targets.

        Args:
            places: Of the robots.
            target_count: Targets of the drive of each, which are the first.
        """
        at = np.array(places, dtype=np.int64)
        joints, targets = self._joints, self._targets
        return GroupSlots(
            make_row_places(at),
            make_row_places(joints[at, None] + np.arange(joints[at[0] + 1] - joints[at[0]])),
            make_row_places(targets[at, None] + np.arange(target_count)),
            targets[at, None] + np.arange(target_count, targets[at[0] + 1] - targets[at[0]]),
        )

    def find_slices(self, place: int) -> tuple[slice, slice]:
        """Find the joints and the targets of one robot."""
        joints, targets = self._joints[place : place + 2], self._targets[place : place + 2]
        return slice(*joints.tolist()), slice(*targets.tolist())

    def read_twists(self, state: DriveState) -> FloatArray | None:
        """Unpack the ordered twists (n, 3), the same array for the same bytes; None without some.

        Raises:
            MalformedPayload: Their number is not that of the claims.
        """
        if not state.twists:
            return None
        if state.twists != self._packed_twists:
            rows, columns = len(self._joints) - 1, len(ORDERED_COLUMNS)
            self._twists = _unpack_floats(state.twists, rows * columns).reshape(rows, columns)
            self._packed_twists = state.twists
        return self._twists

    def read(self, state: DriveState, twists: FloatArray) -> PoolDriveState:
        """Unpack a state into arrays.

        Raises:
            MalformedPayload: The count of numbers does not match the claims.
        """
        rows, joints = len(self._joints) - 1, int(self._joints[-1])
        return PoolDriveState(
            state.time_ns,
            _unpack_floats(state.base, rows * STATE_COLUMNS).reshape(rows, STATE_COLUMNS),
            _unpack_floats(state.joint_positions, joints),
            _unpack_floats(state.joint_velocities, joints),
            _unpack_floats(state.joint_efforts, joints) if state.joint_efforts else None,
            twists,
        )


def _unpack_floats(numbers: bytes, count: int) -> FloatArray:
    if len(numbers) != count * FLOAT_BYTES:
        raise MalformedPayload(
            f"drive state does not fit its claims: {len(numbers)} bytes for {count} numbers"
        )
    return np.frombuffer(numbers, dtype="<f8")


@dataclass(frozen=True)
class _SingleRobot:
    """A robot that no group can hold, and its indices in the arrays of its pool."""

    robot: DrivenRobot
    place: int
    joints: slice
    targets: slice


class PooledRobots:
    """Robots by claim, in groups; robots that no group can hold are driven one by one."""

    _longest_s = math.inf
    """Most time [s] that an update of a drive counts; infinite without a rest."""

    def __init__(
        self,
        network: AgentNetwork,
        timeout_ns: int,
        graph: RosGraph | None = None,
        rx_session: AgentNetwork | None = None,
        watches: SubscriberWatches | None = None,
    ) -> None:
        """Create an empty pool.

        Args:
            network: Session of the publishers.
            timeout_ns: Simulation time for which a command is valid; 0 = for ever.
            graph: ROS 2 graph of the robots' nodes.
            rx_session: Session without publishers, for commands; None = `network`.
            watches: See `FleetTopicPublisher`.
        """
        self.newest_claim = 0  # without claims
        self._network, self._timeout_ns = network, timeout_ns
        self._graph, self._watches = graph, watches
        self._ros = graph.settings if graph else NO_ROS
        self._numbers = count(1)
        domain = graph.domain if graph else None
        self._robot_services = NodeServices(network, domain, f"**/{NODE_NAME}")
        self._pool_services = NodeServices(network, domain)
        self._members: dict[int, GroupMember] = {}
        self._robots: dict[int, DrivenRobot] = {}
        self._publishers: dict[tuple[str, TopicSpec], FleetTopicPublisher] = {}
        self._faults = TopicFaults()
        self._shared_static = SharedStaticTopic(self._make_static_factory)
        self._static_topics = StaticTopics(self._find_publisher, self._shared_static, self._ros)
        self._bumpers = PooledBumpers(self._find_publisher)
        commands_domain = domain if self._ros.has_topic(CMD_VEL.name) else None
        self._commands = FleetCmdVel(rx_session or network, timeout_ns, commands_domain)
        self._groups: dict[GroupKey, RobotGroup] = {}
        self._group_keys = GroupKeys()
        self._claims: bytes | None = None
        self._layout = PoolStateLayout((), ())
        self._singles: tuple[_SingleRobot, ...] = ()
        self._state: DriveState | None = None  # the last one that was answered

    def add_claims(self, claims: Sequence[Claim]) -> None:
        """Subscribe to commands of new robots, which publish from their first state on."""
        for claim in claims:
            if _can_be_grouped(claim.model):
                topic_keys = find_topic_keys(claim, self._ros)
                self._commands.listen(topic_keys.cmd_vel)
                group_key = self._group_keys.find(claim, topic_keys)
                member = GroupMember(claim, group_key, topic_keys)
                member.node = self._join_ros_graph(claim.namespace, topic_keys.cmd_vel)
                self._robot_services.add(
                    member.node, NodeParameters(partial(list_robot_parameters, claim))
                )
                member.static_topics = self._static_topics.add(claim, member.node)
                factory = TopicFactory(self._network, member.node, self._ros)
                member.joints = make_joint_control(factory, claim, self._timeout_ns)
                self._bumpers.add(claim, member.node)
                self._members[claim.claim] = member
            else:
                factory = make_topic_factory(self._network, self._graph, claim.namespace, NODE_NAME)
                factory.faults = self._faults
                robot = DrivenRobot(factory, claim, self._timeout_ns, is_pooled=True)
                robot.announce()
                self._robot_services.add(
                    factory.node, NodeParameters(partial(list_robot_parameters, claim))
                )
                self._static_topics.add_shared(claim)
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
        for member in self._members.values():
            if member.joints is not None:
                member.joints.reset()
        self._bumpers.reset()
        for robot in self._robots.values():
            robot.reset()

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive each robot of a state by one control period.

        Raises:
            MalformedPayload: The state does not fit the robots.
        """
        if state.claims != self._claims:
            self._remap(state.claims)
        self._note_steps(state)
        self._faults.update(state.topic_faults, state.time_ns)
        ordered = self._layout.read_twists(state)
        read = self._layout.read(state, self._commands.at(state.time_ns, ordered))
        self._state = state
        targets = np.zeros(self._layout.target_total)
        for group in self._groups.values():
            group.advance(read, targets)
        for single in self._singles:
            twist = _find_ordered(ordered, single.place)
            targets[single.targets] = single.robot.advance(_extract_state(single, read), twist)
        return self._make_command(state, targets)

    def _note_steps(self, state: DriveState) -> None:
        before = self._state
        if self._watches is not None and before is not None and before.epoch == state.epoch:
            self._watches.budget.note_state(max(1, state.step - before.step))

    def repeats(self, state: DriveState) -> bool:
        """Whether a state has the step and claims of the last one that was answered."""
        return self._state is not None and is_repeated(state, self._state)

    def repeat(self, state: DriveState) -> DriveCommand:
        """Answer the last state again, with the ordered twists of this one.

        Raises:
            MalformedPayload: The twists do not fit the robots.
        """
        ordered = self._layout.read_twists(state)
        twists = self._commands.at(state.time_ns, ordered)
        targets = np.zeros(self._layout.target_total)
        for group in self._groups.values():
            group.repeat(twists, targets)
        for single in self._singles:
            single.robot.repeat(_find_ordered(ordered, single.place))
            targets[single.targets] = single.robot.targets
        self._state = state
        return self._make_command(state, targets)

    def _make_command(self, state: DriveState, targets: FloatArray) -> DriveCommand:
        groups = self._groups.values()
        wants_efforts = any(group.wants_efforts for group in groups) or any(
            single.robot.wants_efforts for single in self._singles
        )
        packed = targets.astype("<f8").tobytes()
        return DriveCommand(
            *(state.epoch, state.step, state.claims, packed, state.order),
            wants_efforts,
            self._find_withheld_hz(),
        )

    def _find_withheld_hz(self) -> int:
        if self._watches is None:
            return 0
        self._watches.budget.update()
        return self._watches.budget.withheld_hz

    def revise(self) -> DriveCommand | None:
        """Answer the last state again if a command ends a rest.

        Else one robot's command would need new arrays of all.
        """
        state = self._state
        if state is None or state.claims != self._claims or self._longest_s == math.inf:
            return None
        is_changed = self._commands.receive_later(state.time_ns)
        return self.repeat(state) if is_changed else None

    def is_idle(self) -> bool:
        """Whether no robot has a subscriber, a valid `cmd_vel`, or anything that moves by time."""
        if self._singles or self._state is None or self._bumpers.has_members:
            return False
        if any(group.needs_all_states for group in self._groups.values()):
            return False
        wanted = (
            one.is_wanted for (_, topic), one in self._publishers.items() if not topic.is_latched
        )
        return not any(wanted) and self._commands.are_idle(self._layout.read_twists(self._state))

    def limit_updates(self, longest_s: float) -> None:
        """Set the most time [s] that an update of a drive counts; what comes now ends a rest."""
        self._longest_s = longest_s
        for group in self._groups.values():
            group.limit_updates(longest_s)

    def publish(self) -> None:
        """Publish what is due at the last state."""
        for group in self._groups.values():
            group.publish()
        for single in self._singles:
            single.robot.publish()

    def list_odometry(self) -> Iterator[MotionRows]:
        """List the odometry of all robots that was due at the last state; see `FleetOdometry`."""
        for group in self._groups.values():
            yield from group.list_odometry(self._faults)
        for single in self._singles:
            if (found := single.robot.find_odometry()) is not None:
                yield found

    @property
    def wants_contacts(self) -> bool:
        """Whether a contact sensor may have a subscriber."""
        return self._bumpers.is_wanted or any(
            robot.bumpers.is_wanted for robot in self._robots.values()
        )

    def publish_contacts(self, report: ContactReport) -> None:
        """Publish what contact sensors feel."""
        self._bumpers.publish(report)
        for robot in self._robots.values():
            robot.bumpers.publish(report)

    def check_all(self) -> None:
        """Declare all publishers that have subscribers, and check all: for a network in process."""
        for publisher in self._publishers.values():
            publisher.check_all()

    def reply_to_queries(self) -> None:
        """Reply to queries with the last values; declare some of the missing publishers."""
        for publisher in tuple(self._publishers.values()):
            publisher.declare_some()
            publisher.announce_some()
            publisher.reply_to_queries()
        self._shared_static.reply_to_queries()
        self._robot_services.poll()
        self._pool_services.poll()
        for robot in self._robots.values():
            robot.reply_to_queries()

    def announce(self) -> None:
        """Publish static topics to new subscribers."""
        self._shared_static.announce()
        for (_, topic), publisher in self._publishers.items():
            if topic.is_latched:
                publisher.announce()
        for robot in self._robots.values():
            robot.announce()

    def log_malformed(self) -> None:
        """Log malformed commands."""
        for key, report in self._commands.take_malformed_reports():
            LOG.warning("cmd_vel key=%s %s", key, report)
        for group in self._groups.values():
            group.log_malformed()
        log_malformed_commands(self._robots.values())

    def _release(self, claim: int) -> str:
        if (robot := self._robots.pop(claim, None)) is not None:
            self._static_topics.remove(claim, ())
            robot.close()
            return robot.entity
        member = self._members.pop(claim)
        self._static_topics.remove(claim, member.static_topics)
        self._bumpers.remove(claim)
        if member.group_key in self._groups:
            self._groups[member.group_key].release(member)
        if member.joints is not None:
            member.joints.close()
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
        self._group_keys.keep(groups)
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
        places = [member.place for member in members]
        group.remap(members, self._layout.find_group_slots(places, key.target_count))
        return group

    def _make_layout(self, order: Sequence[int]) -> PoolStateLayout:
        joints, targets = [], []
        for one in order:
            if (member := self._members.get(one)) is not None:
                joints.append(member.group_key.joint_count)
                targets.append(member.group_key.target_count + member.group_key.joint_target_count)
            else:
                joints.append(self._robots[one].joint_count)
                targets.append(self._robots[one].target_count)
        return PoolStateLayout(joints, targets)

    def _find_publisher(self, pattern: str, topic: TopicSpec) -> FleetTopicPublisher:
        key = (pattern, topic)
        if key not in self._publishers:
            endpoint = topic.at(pattern)
            ros = self._make_ros_publisher(endpoint)
            self._publishers[key] = FleetTopicPublisher(
                self._network, pattern, endpoint.kind, ros, self._faults, self._watches
            )
        return self._publishers[key]

    def _make_ros_publisher(self, topic: RosTopic) -> RosFleetPublisher | None:
        if self._graph is None or self._graph.domain is None:
            return None
        if not self._ros.has_topic(topic.name):
            return None
        return RosFleetPublisher(self._network, self._graph, topic, self._watches)

    def _make_group_node(self) -> RosNode | None:
        """Add the node that publishes the shared topic of a group to the ROS 2 graph."""
        if self._graph is None:
            return None
        node = self._graph.add_node("", f"{self._node_prefix}_{next(self._numbers)}")
        self._pool_services.add(node)
        return node

    def _make_static_factory(self) -> TopicFactory:
        """Make a factory with the node that publishes the shared static topic."""
        name = f"{self._node_prefix}_static"
        factory = make_topic_factory(self._network, self._graph, "", name)
        factory.faults = self._faults
        self._pool_services.add(factory.node)
        return factory

    @property
    def _node_prefix(self) -> str:
        return f"{GROUP_NODE_PREFIX}_{self._graph.zid[:8] if self._graph else ''}"

    def _join_ros_graph(self, namespace: str, cmd_vel: str) -> RosNode | None:
        """Add a robot to the ROS 2 graph, as a node that subscribes to commands."""
        node = self._graph.add_robot(namespace, NODE_NAME) if self._graph else None
        if node is not None and self._ros.has_topic(CMD_VEL.name):
            for kind in CMD_VEL.messages:
                node.add_topic_endpoint("MS", RosTopic(cmd_vel, kind))
        return node


def _can_be_grouped(model: Model) -> bool:
    return model.drive is not None and not any(
        one.is_used_by(model) for one in SENSOR_TYPES if not one.has_groups
    )


def _list_joints(state: StateRows, row: int) -> tuple[list[float], list[float]]:
    """List positions and velocities of the joints of a row."""
    return state.positions[row].tolist(), state.velocities[row].tolist()


def _extract_state(single: _SingleRobot, read: PoolDriveState) -> RobotState:
    return RobotState(
        read.time_ns,
        tuple(read.base[single.place].tolist()),
        tuple(read.positions[single.joints].tolist()),
        tuple(read.velocities[single.joints].tolist()),
        () if read.efforts is None else tuple(read.efforts[single.joints].tolist()),
    )


def _find_ordered(ordered: FloatArray | None, place: int) -> Twist | None:
    if ordered is None or np.isnan(ordered[place, 0]):
        return None
    forward, left, turn = ordered[place].tolist()
    return Twist(Vector3(forward, left), Vector3(z=turn))
