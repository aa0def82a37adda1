"""Where the bodies of a sequence are found, and their numbers in the arrays: made once, kept."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.tiers.grid import IntArray
from zensim.sim_server.physics.tiers.rows import At, Rows, Tier, at_rows, spans

KEPT = 4096


@dataclass(frozen=True)
class Half:
    """The bodies of a sequence that are in one tier.

    Attributes:
        rows: Theirs.
        places: (n,) where they stand in the sequence.
        joints, targets: Where their numbers stand among all joints and targets of the sequence.
    """

    rows: IntArray
    places: IntArray
    joints: IntArray
    targets: IntArray


@dataclass(frozen=True)
class Mapping:
    """A sequence of bodies, parted by tier.

    Attributes:
        count: How many there are.
        joint_count: Of all of them.
        at: Where the rows of the kinematic half are.
        bodies: Of the full engine.
        pooled_joints: Where the joints of the kinematic half are in the pool.
        held: The rows of those robots that may be kinematic.
        pooled_targets: Where their targets are in the pool.
        held_targets: And among the targets of the sequence.
    """

    count: int
    joint_count: int
    kinematic: Half
    full: Half
    at: At
    bodies: tuple[int, ...]
    pooled_joints: IntArray
    held: tuple[int, ...]
    pooled_targets: IntArray
    held_targets: IntArray


def mapping_of(rows: Rows, numbers: IntArray) -> Mapping:
    """Part bodies (n,) by tier."""
    joints, widths = rows.joint_count[numbers], rows.width[numbers]
    joint_at, target_at = np.cumsum(joints) - joints, np.cumsum(widths) - widths
    is_kinematic = rows.tier[numbers] == Tier.KINEMATIC

    def half(places: IntArray) -> Half:
        return Half(
            numbers[places],
            places,
            spans(joint_at[places], joints[places]),
            spans(target_at[places], widths[places]),
        )

    kinematic, full = half(np.flatnonzero(is_kinematic)), half(np.flatnonzero(~is_kinematic))
    is_held = rows.is_held[numbers]
    held = numbers[is_held]
    return Mapping(
        count=len(numbers),
        joint_count=int(joints.sum()),
        kinematic=kinematic,
        full=full,
        at=at_rows(kinematic.rows),
        bodies=tuple(rows.full[full.rows].tolist()),
        pooled_joints=spans(rows.joint_start[kinematic.rows], rows.joint_count[kinematic.rows]),
        held=tuple(held.tolist()),
        pooled_targets=spans(rows.target_start[held], rows.width[held]),
        held_targets=spans(target_at[is_held], widths[is_held]),
    )


class Mappings:
    """Mappings of sequences that are asked for again and again."""

    def __init__(self, rows: Rows) -> None:
        self._known = rows
        self._kept: OrderedDict[int, tuple[Sequence[int], IntArray, Mapping | None]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def of(self, bodies: Sequence[int]) -> Mapping:
        """Part bodies by tier."""
        if not isinstance(bodies, tuple):
            return mapping_of(self._known, np.array(bodies, np.intp))
        # A tuple never changes: while it is kept here, no other has its number.
        kept = self._kept.get(id(bodies))
        if kept is not None and kept[2] is not None:
            return kept[2]
        numbers = kept[1] if kept else np.array(bodies, np.intp)
        mapping = mapping_of(self._known, numbers)
        self._kept[id(bodies)] = (bodies, numbers, mapping)
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return mapping

    def forget(self) -> None:
        """Note that bodies changed tiers, came or went; what nobody asked for since is gone."""
        kept = list(self._kept.items())
        self._kept.clear()
        for number, (bodies, numbers, mapping) in kept:
            if mapping is not None:
                self._kept[number] = (bodies, numbers, None)
