"""The bodies of a clustered world by number: arrays of where each is and how far it may go."""

import heapq
from dataclasses import dataclass, field

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.clusters.discs import IntArray
from zensim.sim_server.physics.clusters.reach import Reach
from zensim.sim_server.physics.engine import FloatArray

EVERYWHERE = -1
"""Cell of what never moves: it has a copy in each."""
NOWHERE = -2
FIRST = 64


@dataclass
class Member:
    """A body.

    Attributes:
        targets: Where its targets stand among all.
        copies: Of what never moves: its number in each cell that there is.
        base: Of what never moves: its row (13,), as it was read.
    """

    model: Model
    reach: Reach
    targets: slice
    copies: dict[int, int] = field(default_factory=dict)
    base: FloatArray | None = None


class Members:
    """Which bodies there are; arrays by number.

    Attributes:
        cell: (m,) where each is.
        inner: (m,) its number there.
        place: (m, 2) where it was last known to be.
        rigid_m: (m,) how far it reaches while nothing slides.
        radius: (m,) how far it reached at the last look [m].
        arm: (m,) from root to centre of mass [m].
        bound: (m,) the speed that it was thought to have at most [m/s].
        kick: (m,) what pushes gave it since [m/s].
        told: (m,) whether its targets were set since it was at rest.
        is_due: (m,) whether they are still to be told to its cell.
        targets: of all, body by body.
        moving_count: How many move.
        concealed: Numbers of those that wait until others are made too.
        version: Changes whenever somebody comes, goes or moves to another cell.
    """

    def __init__(self) -> None:
        self.version = self.moving_count = 0
        self.by_number: dict[int, Member] = {}
        self.concealed: set[int] = set()
        self.cell: IntArray = np.full(FIRST, NOWHERE, np.intp)
        self.inner: IntArray = np.zeros(FIRST, np.intp)
        self.place: FloatArray = np.zeros((FIRST, 2))
        self.rigid_m: FloatArray = np.zeros(FIRST)
        self.radius: FloatArray = np.zeros(FIRST)
        self.arm: FloatArray = np.zeros(FIRST)
        self.bound: FloatArray = np.zeros(FIRST)
        self.kick: FloatArray = np.zeros(FIRST)
        self.told = np.zeros(FIRST, np.bool_)
        self.is_due = np.zeros(FIRST, np.bool_)
        self.targets: FloatArray = np.zeros(FIRST)
        self.levers: FloatArray = np.zeros(FIRST)
        self._free: list[int] = []
        self._gaps: dict[int, list[slice]] = {}
        self._targets_end = 0

    @property
    def moving(self) -> IntArray:
        """Numbers of what moves, ascending."""
        return np.flatnonzero(self.cell >= 0)

    @property
    def present(self) -> IntArray:
        """Numbers of what moves and is not concealed, ascending."""
        moving = self.moving
        return np.setdiff1d(moving, list(self.concealed)) if self.concealed else moving

    def show(self, number: int, *, is_concealed: bool) -> None:
        """Note that a body takes part, or does not."""
        (self.concealed.add if is_concealed else self.concealed.discard)(number)
        self.version += 1

    def admit(self, model: Model, reach: Reach, *, cell: int, inner: int) -> int:
        """Give a new body the least number that is free."""
        number = heapq.heappop(self._free) if self._free else len(self.by_number)
        while number >= len(self.cell):
            self._grow()
        member = Member(model, reach, self._room_for(len(reach.levers)))
        self.by_number[number] = member
        self.cell[number], self.inner[number] = cell, inner
        self.rigid_m[number] = self.radius[number] = reach.radius_m
        self.arm[number], self.bound[number] = reach.arm_m, 0.0
        self.moving_count += cell >= 0
        self.levers[member.targets] = reach.levers
        self.forget_targets(number)
        self.version += 1
        return number

    def dismiss(self, number: int) -> Member:
        """Forget a body."""
        member = self.by_number.pop(number)
        self.moving_count -= int(self.cell[number]) >= 0
        self.cell[number] = NOWHERE
        self.concealed.discard(number)
        self.kick[number] = 0.0
        self.told[number] = self.is_due[number] = False
        width = member.targets.stop - member.targets.start
        self._gaps.setdefault(width, []).append(member.targets)
        heapq.heappush(self._free, number)
        self.version += 1
        return member

    def move(self, number: int, *, cell: int, inner: int) -> None:
        """Note that a body went to another cell: its targets are to be told there."""
        self.cell[number], self.inner[number] = cell, inner
        self.is_due[number] = self.told[number]
        self.version += 1

    def targets_of(self, numbers: IntArray) -> tuple[IntArray, IntArray]:
        """Find where the targets of bodies start, and how many each has."""
        found = [self.by_number[number].targets for number in numbers.tolist()]
        starts = np.array([one.start for one in found], np.intp)
        return starts, np.array([one.stop for one in found], np.intp) - starts

    def forget_targets(self, number: int) -> None:
        """Note that a body has none but those of a body at rest."""
        self.told[number] = self.is_due[number] = False
        self.kick[number] = 0.0
        self.targets[self.by_number[number].targets] = 0.0

    def forget_gone(self) -> None:
        """Number bodies, and place their targets, as if nobody had ever gone."""
        if not self.by_number:
            self._free.clear()
            self._gaps.clear()
            self._targets_end = 0

    def _room_for(self, width: int) -> slice:
        if gaps := self._gaps.get(width):
            return gaps.pop()
        start, self._targets_end = self._targets_end, self._targets_end + width
        while self._targets_end > len(self.targets):
            self.targets = np.concatenate([self.targets, np.zeros_like(self.targets)])
            self.levers = np.concatenate([self.levers, np.zeros_like(self.levers)])
        return slice(start, self._targets_end)

    def _grow(self) -> None:
        for name in (
            "inner",
            "place",
            "rigid_m",
            "radius",
            "arm",
            "bound",
            "kick",
            "told",
            "is_due",
        ):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.zeros_like(array)]))
        self.cell = np.concatenate([self.cell, np.full(len(self.cell), NOWHERE, np.intp)])
