"""The bodies of all cells: their table, their order, and their indices within cells."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.body_reach import BodyReach
from zensim.sim_server.physics.engine import BodyStates, FloatArray
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges

ALL_CELLS = -1
"""Cell of a body that cannot move: each cell has it."""
NO_CELL = -2
INITIAL_CAPACITY = 64


@dataclass
class CellBody:
    """A body of the celled engine.

    Attributes:
        targets: Slice of its targets among all.
        base: Of a body that cannot move: its state row (13,).
    """

    model: Model
    reach: BodyReach
    targets: slice
    base: FloatArray | None = None


class CellBodyTable:
    """All bodies; arrays are indexed by their number.

    Attributes:
        cell: (m,) cell of each, `ALL_CELLS` or `NO_CELL`.
        place: (m, 2) last known position.
        rigid_m: (m,) radius with prismatic joints at zero.
        radius: (m,) radius [m] at the last regrouping.
        com_offset_m: (m,) from root link to centre of mass.
        speed_bound: (m,) speed [m/s] assumed at the last regrouping.
        load_speed: (m,) speed [m/s] added by loads since.
        is_commanded: (m,) whether its targets were set since it was at rest.
        is_due: (m,) whether its cell still lacks them.
        is_concealed: (m,) whether it is hidden.
        joint_count: (m,) number of its joints.
        target_start: (m,) index of its first target in `targets`.
        width: (m,) number of its targets.
        targets: Of all bodies, body by body.
        levers: Likewise: speed [m/s] of the body per unit of each target.
        moving_count: Number of bodies that move.
        concealed: Numbers of hidden bodies.
        sliding: Indices of the prismatic joints of bodies that have any, by number.
        version: Changes whenever a body comes, goes or changes its cell.
    """

    def __init__(self) -> None:
        self.version = self.moving_count = 0
        self.by_number: dict[int, CellBody] = {}
        self.concealed: set[int] = set()
        self.sliding: dict[int, tuple[int, ...]] = {}
        self.cell: IntArray = np.full(INITIAL_CAPACITY, NO_CELL, np.intp)
        self.place: FloatArray = np.zeros((INITIAL_CAPACITY, 2))
        self.rigid_m: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.radius: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.com_offset_m: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.speed_bound: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.load_speed: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.is_commanded = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.is_due = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.is_concealed = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.joint_count: IntArray = np.zeros(INITIAL_CAPACITY, np.intp)
        self.target_start: IntArray = np.zeros(INITIAL_CAPACITY, np.intp)
        self.width: IntArray = np.zeros(INITIAL_CAPACITY, np.intp)
        self.targets: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.levers: FloatArray = np.zeros(INITIAL_CAPACITY)
        self._gaps: dict[int, list[slice]] = {}
        self._targets_end = 0

    @property
    def moving(self) -> IntArray:
        """Numbers of bodies that move, ascending."""
        return np.flatnonzero(self.cell >= 0)

    @property
    def present(self) -> IntArray:
        """Numbers of bodies that move and are not hidden, ascending."""
        return np.flatnonzero((self.cell >= 0) & ~self.is_concealed)

    def set_concealed(self, number: int, *, is_concealed: bool) -> None:
        """Mark a body as hidden or shown."""
        (self.concealed.add if is_concealed else self.concealed.discard)(number)
        self.is_concealed[number] = is_concealed
        self.version += 1

    def add(self, number: int, model: Model, reach: BodyReach, *, cell: int) -> None:
        """Add a body."""
        while number >= len(self.cell):
            self._grow()
        member = CellBody(model, reach, self._allocate_targets(len(reach.levers)))
        self.by_number[number] = member
        self.cell[number] = cell
        self.rigid_m[number] = self.radius[number] = reach.radius_m
        self.com_offset_m[number], self.speed_bound[number] = reach.com_offset_m, 0.0
        self.joint_count[number] = len(model.joints)
        self.target_start[number], self.width[number] = member.targets.start, len(reach.levers)
        if reach.slides:
            self.sliding[number] = reach.slides
        self.moving_count += cell >= 0
        self.levers[member.targets] = reach.levers
        self.forget_targets(number)
        self.version += 1

    def remove(self, number: int) -> None:
        """Remove a body."""
        member = self.by_number.pop(number)
        self.moving_count -= int(self.cell[number]) >= 0
        self.cell[number] = NO_CELL
        self.concealed.discard(number)
        self.is_concealed[number] = False
        self.sliding.pop(number, None)
        self.load_speed[number] = 0.0
        self.is_commanded[number] = self.is_due[number] = False
        width = member.targets.stop - member.targets.start
        self._gaps.setdefault(width, []).append(member.targets)
        self.version += 1

    def move(self, number: int, *, cell: int) -> None:
        """Record the new cell of a body; its targets become due there."""
        self.cell[number] = cell
        self.is_due[number] = self.is_commanded[number]
        self.version += 1

    def find_square_distances(self, place: FloatArray) -> FloatArray:
        """Find the squares (m,) of the distances of all bodies from a place (2,)."""
        away = self.place - place
        return np.asarray(np.einsum("ij,ij->i", away, away))

    def find_target_ranges(self, numbers: IntArray) -> tuple[IntArray, IntArray]:
        """Find the starts and lengths (n,) of the target ranges of bodies."""
        return self.target_start[numbers], self.width[numbers]

    def forget_targets(self, number: int) -> None:
        """Reset the targets of a body to zero."""
        self.is_commanded[number] = self.is_due[number] = False
        self.load_speed[number] = 0.0
        self.targets[self.by_number[number].targets] = 0.0

    def _allocate_targets(self, width: int) -> slice:
        if gaps := self._gaps.get(width):
            return gaps.pop()
        start, self._targets_end = self._targets_end, self._targets_end + width
        while self._targets_end > len(self.targets):
            self.targets = np.concatenate([self.targets, np.zeros_like(self.targets)])
            self.levers = np.concatenate([self.levers, np.zeros_like(self.levers)])
        return slice(start, self._targets_end)

    def _grow(self) -> None:
        for name in (
            "place",
            "rigid_m",
            "radius",
            "com_offset_m",
            "speed_bound",
            "load_speed",
            "is_commanded",
            "is_due",
            "is_concealed",
            "joint_count",
            "target_start",
            "width",
        ):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.zeros_like(array)]))
        self.cell = np.concatenate([self.cell, np.full(len(self.cell), NO_CELL, np.intp)])


@dataclass(frozen=True)
class CellBodyOrder:
    """All n bodies that move, cell by cell: the order in which they are read and commanded.

    Attributes:
        cells: (c,) cells with such bodies.
        largest_first: The same, those with most bodies first.
        bodies: For each cell, its bodies.
        numbers: (n,) of the bodies.
        row: (m,) index in `numbers` by number; -1 = absent.
        joint_start: (n + 1,) index of the first joint of each.
        targets: (t,) indices of their targets in the table.
        target_starts: (d,) starts in `targets`, of bodies with targets.
        driven: (d,) rows of those bodies.
        cell_targets: (c + 1,) starts in `targets` by cell.
        slides: Row, and index among all joints, of each prismatic joint.
    """

    cells: tuple[int, ...]
    largest_first: tuple[int, ...]
    bodies: tuple[tuple[int, ...], ...]
    numbers: IntArray
    row: IntArray
    joint_start: IntArray
    targets: IntArray
    target_starts: IntArray
    driven: IntArray
    cell_targets: IntArray
    slides: tuple[IntArray, IntArray]


def make_body_order(members: CellBodyTable) -> CellBodyOrder:
    """Sort all bodies that move and are shown by cell."""
    moving = members.present
    numbers = moving[np.argsort(members.cell[moving], kind="stable")]
    cells, firsts = np.unique(members.cell[numbers], return_index=True)
    parts = np.split(numbers, firsts[1:]) if len(numbers) else []
    by_size = np.argsort([-len(part) for part in parts], kind="stable")
    row = np.full(len(members.cell), -1, np.intp)
    row[numbers] = np.arange(len(numbers))
    joint_start = np.concatenate([[0], np.cumsum(members.joint_count[numbers])]).astype(np.intp)
    starts, widths = members.find_target_ranges(numbers)
    slides = [
        (int(row[number]), joint_start[row[number]] + slide)
        for number, own in members.sliding.items()
        if row[number] >= 0
        for slide in own
    ]
    return CellBodyOrder(
        tuple(cells.tolist()),
        tuple(cells[by_size].tolist()),
        tuple(tuple(part.tolist()) for part in parts),
        numbers,
        row,
        joint_start,
        expand_ranges(starts, widths)[1],
        (np.cumsum(widths) - widths)[widths > 0].astype(np.intp),
        np.flatnonzero(widths > 0),
        np.concatenate([[0], np.cumsum(widths)])[[*firsts, len(numbers)]].astype(np.intp),
        (np.array([a for a, _ in slides], np.intp), np.array([b for _, b in slides], np.intp)),
    )


@dataclass(frozen=True)
class CellIndexMap:
    """Indices of n selected bodies in a `CellBodyOrder` and among the targets.

    Attributes:
        rows: (k,) of the order.
        into: (k,) rows of the result that they fill; the others cannot move.
        base: (n, 13) the result for bodies that cannot move.
        joints: Joints of the order, in the order of the result.
        joints_into: Joints of the result that they fill.
        joint_count: Of the result.
        numbers: (n,) of the bodies.
        targets: Indices of their targets in the table.
        starts: Starts in `targets`, of bodies with targets.
        driven: Numbers of those bodies.
    """

    rows: IntArray
    into: IntArray
    base: FloatArray
    joints: IntArray
    joints_into: IntArray
    joint_count: int
    numbers: IntArray
    targets: IntArray
    starts: IntArray
    driven: IntArray

    def select(self, states: BodyStates) -> BodyStates:
        """Select their states from the states of the order."""
        base = self.base.copy()
        base[self.into] = states.base[self.rows]
        positions, velocities = np.zeros(self.joint_count), np.zeros(self.joint_count)
        positions[self.joints_into] = states.joint_positions[self.joints]
        velocities[self.joints_into] = states.joint_velocities[self.joints]
        return BodyStates(base, positions, velocities)


def make_index_map(
    bodies: Sequence[int], members: CellBodyTable, order: CellBodyOrder
) -> CellIndexMap:
    """Make the index map of some bodies."""
    numbers = np.array(bodies, np.intp)
    rows = order.row[numbers] if len(numbers) else numbers
    counts = members.joint_count[numbers]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    into = np.flatnonzero(rows >= 0)
    base = np.zeros((len(numbers), 13))
    for at in np.flatnonzero(rows < 0).tolist():
        base[at] = members.by_number[bodies[at]].base
    starts_in_table, widths = members.find_target_ranges(numbers)
    is_driven = widths > 0
    ends = np.cumsum(widths)
    return CellIndexMap(
        rows[into],
        into,
        base,
        expand_ranges(order.joint_start[rows[into]], counts[into])[1],
        expand_ranges(starts[into], counts[into])[1],
        int(starts[-1]),
        numbers,
        expand_ranges(starts_in_table, widths)[1],
        (ends - widths)[is_driven].astype(np.intp),
        numbers[is_driven],
    )
