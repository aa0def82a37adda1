"""Loose bodies that lie on one another: what keeps a stack of them where it is."""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

STACK_CHECK_S = 0.02
"""Time between searches for bodies that touch."""

ReadContacts = Callable[[int], Iterable[Sequence[Any]] | None]


class StackedBodies:
    """Loose bodies, and which of them touch one another.

    Friction stops a sliding speed, not what is left of it when the solver ends: stacks creep. Such
    bodies have friction anchors, by which Bullet corrects a contact's displacement. They are not on
    other bodies, as a block that slid to a stop would be pulled back by a millimetre.

    Attributes:
        anchored: Those with friction anchors.
        are_moving: Whether some touch that are awake.
    """

    def __init__(self, dt_s: float) -> None:
        self._loose: set[int] = set()
        self._steps = max(round(STACK_CHECK_S / dt_s), 1)
        self._next = 0
        self.anchored: frozenset[int] = frozenset()
        self.are_moving = False

    def add(self, body: int) -> None:
        """Add a loose body."""
        self._loose.add(body)

    def forget(self, body: int) -> bool:
        """Forget a body; return whether it was anchored."""
        self._loose.discard(body)
        was_anchored = body in self.anchored
        self.anchored -= {body}
        return was_anchored

    def is_due(self) -> bool:
        """Whether a search is due in this step; asked for once in each."""
        is_single = len(self._loose) <= 1
        if is_single and not self.anchored:
            self.are_moving = False
            return False
        self._next = (self._next + 1) % self._steps
        return self._next == 0

    def search(self, read_contacts: ReadContacts, asleep: Collection[int]) -> frozenset[int]:
        """Search for bodies that touch; return those whose anchors change.

        Args:
            read_contacts: Reads the contact points of a body.
            asleep: Bodies asleep; they keep what they have.
        """
        touching: set[int] = set()
        for body in self._loose.difference(asleep):
            others = {point[2] for point in read_contacts(body) or ()} & self._loose
            if others:
                touching |= {body, *others}
        self.are_moving = bool(touching)
        former, self.anchored = self.anchored, frozenset(touching | self.anchored & set(asleep))
        return former ^ self.anchored
