"""NewestMessages: a subscription that keeps the newest message of each key until it is taken."""

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

from zensim.proto.network_protocols import Sample

Received = TypeVar("Received")


class NewestMessages(Generic[Received]):
    """The newest message of each key, and all of some keys; the others are not copied."""

    def __init__(
        self,
        receive: Callable[[], Iterable[tuple[str, Received]]],
        copy: Callable[[list[Received]], list[Sample]],
        close: Callable[[], None],
        keeps_all: Callable[[str], bool],
    ) -> None:
        """Keep nothing yet.

        Args:
            receive: Takes what is queued, oldest first, with its keys.
            copy: Copies what is taken.
            close: Ends the subscription.
            keeps_all: Whether all messages of a key are kept.
        """
        self._receive, self._copy, self._keeps_all = receive, copy, keeps_all
        self.close = close
        self._newest: dict[str, Received] = {}
        self._all: list[Received] = []

    def collect(self) -> None:
        """Take what is queued, so that the queue does not fill."""
        newest = self._newest
        for key, message in self._receive():
            if key in newest or not self._keeps_all(key):
                newest[key] = message
            else:
                self._all.append(message)

    def take(self) -> list[Sample]:
        """Take the newest message of each key; of keys that keep all, all messages."""
        self.collect()
        kept = [*self._all, *self._newest.values()]
        self._all, self._newest = [], {}
        return self._copy(kept)
