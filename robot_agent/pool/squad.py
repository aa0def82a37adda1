"""Robots of one kind, driven and told of together: arrays with a row a robot."""

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.ros2.ros_graph import RosNode
from zensim.robot_agent.pool.driven import DrivenBases
from zensim.robot_agent.pool.kinds import Kind, Topics
from zensim.robot_agent.pool.outlet import Line
from zensim.robot_agent.pool.rows import NEW, FloatArray, IntArray
from zensim.robot_agent.pool.telling import OutletOf, Telling


@dataclass(eq=False)
class Member:
    """One robot of a squad."""

    claim: Claim
    kind: Kind
    topics: Topics
    row: int = NEW
    """In its squad."""
    place: int = NEW
    """In its pool."""
    lines: tuple[Line, ...] = ()
    constants: tuple[Line, ...] = ()
    templates: Sequence[msgspec.Struct] = ()
    """A message a line."""
    shared_tf: TFMessage | None = None
    """What it has on the topic that all share."""
    node: RosNode | None = None
    """In ROS 2's graph."""


@dataclass(frozen=True)
class PoolState:
    """What one drive state says, in arrays; flat where robots differ in how much there is."""

    time_ns: int
    base: FloatArray
    """(n, STATE_COLUMNS)."""
    positions: FloatArray
    velocities: FloatArray
    twists: FloatArray
    """(n, 6)."""


@dataclass(frozen=True)
class Seats:
    """Where the rows of a squad stand in the arrays of its pool."""

    places: IntArray
    """(n,)."""
    joints: IntArray
    """(n, joint_count)."""
    targets: IntArray
    """(n, target_count)."""


@dataclass(frozen=True)
class _Due:
    """What `tell` has to tell."""

    rows: IntArray
    positions: FloatArray
    velocities: FloatArray
    time_ns: int


class Squad:
    """Turns states into targets, then into telemetry."""

    def __init__(self, kind: Kind, outlet_of: OutletOf, node: RosNode | None = None) -> None:
        self._kind = kind
        self._bases = DrivenBases(kind)
        self._telling = Telling(kind, self._bases, outlet_of, node)
        self._seats: Seats | None = None
        self._due: _Due | None = None

    def recut(self, members: Sequence[Member], seats: Seats) -> None:
        """Take the robots as they are now, and where they stand."""
        before = np.array([member.row for member in members], dtype=np.int64)
        self._seats, self._due = seats, None
        self._bases.recut(before)
        for row, member in enumerate(members):
            member.row = row
            if not member.lines:
                member.lines = self._lines(member)
        self._recut_topics(members, before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self._due = None
        self._bases.reset()
        self._telling.reset()

    def advance(self, state: PoolState, targets: FloatArray) -> None:
        """Take a state; write the targets of its robots into those of the pool."""
        if (seats := self._seats) is None:
            return
        positions, velocities = state.positions[seats.joints], state.velocities[seats.joints]
        rows = self._bases.update(
            state.time_ns,
            base=state.base[seats.places],
            positions=positions,
            velocities=velocities,
            twists=state.twists[seats.places],
        )
        targets[seats.targets] = self._bases.targets
        self._due = _Due(rows, positions, velocities, state.time_ns)

    def tell(self) -> None:
        """Publish what the last state made due."""
        if (due := self._due) is not None:
            self._due = None
            self._telling.tell(
                due.rows, positions=due.positions, velocities=due.velocities, time_ns=due.time_ns
            )

    def dismiss(self, member: Member) -> None:
        """Withdraw what a robot tells."""
        for topic, line in zip(self._telling.topics, member.lines, strict=False):
            topic.outlet.remove(line)
        member.lines = ()

    def close(self) -> None:
        """Withdraw what its robots share; they have been dismissed, or are in other squads."""
        self._telling.close()

    def _lines(self, member: Member) -> tuple[Line, ...]:
        named = self._telling.keys_of(member.topics)
        lines = []
        for topic, key in zip(self._telling.topics, named, strict=True):
            lines.append(Line(key, topic, node=member.node))
            topic.outlet.add(lines[-1])
        return tuple(lines)

    def _recut_topics(self, members: Sequence[Member], before: IntArray) -> None:
        new = [member for member in members if not member.templates]
        models = {id(one.claim.model): one.claim.model for one in new}
        written = {key: self._telling.templates_of(model) for key, model in models.items()}
        for one in new:
            one.templates = written[id(one.claim.model)]
            one.shared_tf = self._telling.shared_template(one.claim.model, one.claim.namespace)
        for number, topic in enumerate(self._telling.topics):
            topic.recut(
                [member.lines[number] for member in members],
                [member.templates[number] for member in members],
                before,
            )
        shared = [one.shared_tf for one in members if one.shared_tf is not None]
        self._telling.recut_shared(shared, before)
