"""What the loop hands to the journal's thread: values that nobody changes any more."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.sim_server.journal.rows import AnswerRow, ClockRow, MotionRow, WorldRow
from zensim.sim_server.physics.engine import BodyStates
from zensim.sim_server.reading.descriptions import Reading as TextReading
from zensim.sim_server.world.entity import Entity


@dataclass(frozen=True)
class Kept:
    """An entity as the journal knows it."""

    ordinal: int
    entity: Entity
    bond: str = ""
    reading: TextReading | None = None
    """What its model was read from."""

    def is_same(self, other: "Kept") -> bool:
        """Whether a row of this would be that of the other: bodies of an engine are not kept."""
        one, two = self.entity, other.entity
        if (self.ordinal, self.bond) != (other.ordinal, other.bond):
            return False
        return one is two or (
            (one.name, one.namespace, one.born_ns) == (two.name, two.namespace, two.born_ns)
            and one.belongs_to_world == two.belongs_to_world
            and (one.info, one.description) == (two.info, two.description)
            and one.model == two.model
            and np.array_equal(one.initial, two.initial)
        )


@dataclass(frozen=True)
class Change:
    """What became of one name; None where there was or is no entity."""

    name: str
    before: Kept | None
    after: Kept | None


@dataclass(frozen=True)
class Motion:
    """Where all entities were at one step; the arrays are the reading's own."""

    epoch: int
    steps: int
    names: tuple[str, ...]
    joint_counts: npt.NDArray[np.intp]
    reading: BodyStates

    def row(self) -> MotionRow:
        """Write it as its row."""
        return MotionRow(
            epoch=self.epoch,
            steps=self.steps,
            names=self.names,
            base=self.reading.base.tobytes(),
            joint_counts=tuple(self.joint_counts.tolist()),
            joint_positions=self.reading.joint_positions.tobytes(),
        )


@dataclass(frozen=True)
class Record:
    """What happened since the record before; all of it is kept, or nothing."""

    generation: int
    """Goes up when records could not be written: those of older ones are void."""
    position: int
    changes: tuple[Change, ...] = ()
    world: WorldRow | None = None
    clock: ClockRow | None = None
    motion: Motion | None = None
    answer: AnswerRow | None = None
    forgotten: tuple[tuple[str, bytes], ...] = ()
    """Answers that no retry gets any more: service and request id."""

    is_asked: bool = False
    """Whether a request changed it: it is undone when it cannot be kept."""
    former: Motion | None = None
    """Where all were before, for those that are put back."""
