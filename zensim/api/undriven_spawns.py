"""Spawns that ended with Timeout, as no agent drove the robots: the same call is their retry."""

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Final, Generic, TypeVar

from zensim.api.api_errors import Timeout

Spawned = TypeVar("Spawned")
MAX_KEPT: Final = 64


class UndrivenSpawns(Generic[Spawned]):
    """What was spawned, by the arguments of the call that waited in vain."""

    def __init__(self, exists: Callable[[Spawned], bool]) -> None:
        """Keep nothing yet.

        Args:
            exists: Whether the robots of a spawn are still there.
        """
        self._exists = exists
        self._kept: OrderedDict[str, Spawned] = OrderedDict()

    @contextmanager
    def retried(
        self, what: tuple[object, ...], options: Mapping[str, object], spawn: Callable[[], Spawned]
    ) -> Iterator[Spawned]:
        """Spawn, or take what the same call has spawned; the block waits until it is driven.

        Args:
            what: Arguments of the call.
            options: Its keyword arguments; the timeout may differ.
            spawn: Spawns.
        """
        given = sorted((name, repr(one)) for name, one in options.items() if name != "timeout_s")
        call = repr((what, given))
        found = self._kept.pop(call, None)
        if found is None or not self._exists(found):
            found = spawn()
        try:
            yield found
        except Timeout:
            self._kept[call] = found
            while len(self._kept) > MAX_KEPT:
                self._kept.popitem(last=False)
            raise
