"""Publishers by owner, and those of them that have subscribers."""

from collections.abc import Set
from typing import Generic, TypeVar

from zensim.proto.network_protocols import Publisher

MAX_CHECKED_AT_ONCE = 32
"""Publishers whose matching status is read in one call: 0.1 ms."""
OwnerT = TypeVar("OwnerT")


class MatchedPublishers(Generic[OwnerT]):
    """Publishers by owner, and those of them that have subscribers."""

    def __init__(self) -> None:
        self.matched: dict[OwnerT, Publisher] = {}
        """Publishers that had subscribers at the last check."""
        self._all: dict[OwnerT, Publisher] = {}
        self._unchecked: list[OwnerT] = []

    def add(self, owner: OwnerT, publisher: Publisher) -> None:
        """Add a publisher."""
        self._all[owner] = self.matched[owner] = publisher

    def remove(self, owner: OwnerT) -> None:
        """Undeclare a publisher."""
        if (publisher := self._all.pop(owner, None)) is not None:
            self.matched.pop(owner, None)
            publisher.close()

    def remove_except(self, owners: Set[OwnerT]) -> list[OwnerT]:
        """Undeclare the publishers of all others; return these."""
        others = [owner for owner in self._all if owner not in owners]
        for owner in others:
            self.remove(owner)
        return others

    def check_all(self) -> None:
        """Check all publishers."""
        self.matched = {owner: one for owner, one in self._all.items() if one.is_matched}

    def check_some(self) -> None:
        """Check the next publishers, in turn."""
        if not self._unchecked:
            self._unchecked = list(self._all)
        some, self._unchecked = (
            self._unchecked[:MAX_CHECKED_AT_ONCE],
            self._unchecked[MAX_CHECKED_AT_ONCE:],
        )
        for owner in some:
            if (publisher := self._all.get(owner)) is None:
                continue
            if publisher.is_matched:
                self.matched[owner] = publisher
            else:
                self.matched.pop(owner, None)
