"""Entities that a visitor has deleted, and could still keep."""

from collections.abc import Iterable
from typing import Final

UNDO_S: Final = 5.0
"""Time in which a deletion can be undone; the entity is deleted after it."""


class PendingDeletions:
    """Deletions that take effect after `UNDO_S`; times are monotonic [s]."""

    def __init__(self) -> None:
        """Have none."""
        self._due: dict[str, float] = {}

    def add(self, entities: Iterable[str], now_s: float) -> None:
        """Delete entities later; those that are pending keep their time."""
        for entity in entities:
            self._due.setdefault(entity, now_s + UNDO_S)

    def undo(self) -> tuple[str, ...]:
        """Keep all entities, and return their names."""
        kept, self._due = tuple(self._due), {}
        return kept

    def take_due(self, now_s: float) -> tuple[str, ...]:
        """Take the entities whose time has passed."""
        due = tuple(name for name, at_s in self._due.items() if now_s >= at_s)
        for name in due:
            del self._due[name]
        return due

    def take_all(self) -> tuple[str, ...]:
        """Take all entities, as nothing can be undone any more."""
        return self.undo()
