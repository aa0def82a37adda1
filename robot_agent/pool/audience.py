"""Which publishers of a topic somebody listens to, asked a few at a time.

To ask takes longer than to put what nobody hears: who is new counts as heard until asked about.
"""

from typing import Generic, TypeVar

from zensim.proto.topic_endpoints import TransportPublisher

AT_ONCE = 32
"""Publishers that are asked about in one go: a tenth of a millisecond."""
Whose = TypeVar("Whose")


class Audience(Generic[Whose]):
    """Publishers by whose they are."""

    def __init__(self) -> None:
        self.heard: dict[Whose, TransportPublisher] = {}
        """Those to put on."""
        self._all: dict[Whose, TransportPublisher] = {}
        self._unasked: list[Whose] = []

    def add(self, whose: Whose, publisher: TransportPublisher) -> None:
        """Take a publisher in."""
        self._all[whose] = self.heard[whose] = publisher

    def remove(self, whose: Whose) -> None:
        """Withdraw a publisher."""
        if (publisher := self._all.pop(whose, None)) is not None:
            self.heard.pop(whose, None)
            publisher.close()

    def ask_some(self) -> None:
        """Ask about the next ones, round and round."""
        if not self._unasked:
            self._unasked = list(self._all)
        some, self._unasked = self._unasked[:AT_ONCE], self._unasked[AT_ONCE:]
        for whose in some:
            if (publisher := self._all.get(whose)) is None:
                continue
            if publisher.is_matched:
                self.heard[whose] = publisher
            else:
                self.heard.pop(whose, None)
