"""Garbage collection of an agent with many robots."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager

FREEZE_AFTER_S = 2.0
"""Wait after the last change of robots: what is made for a new one is there by then."""
LEAST_GONE = 50
"""Robots that have gone until they are collected: a collection takes 20 ms at least."""


class CollectedObjects:
    """Keeps the garbage collector from visiting the objects of robots that stay.

    A full collection visits all objects: with 5000 robots it takes 0.1 to 0.3 s, in which no state
    is answered. An agent of few robots does without, as it may share its process.
    """

    def __init__(
        self,
        freeze: Callable[[], None] = gc.freeze,
        unfreeze: Callable[[], None] = gc.unfreeze,
        collect: Callable[[], object] = gc.collect,
        pause: Callable[[], None] = gc.disable,
        resume: Callable[[], None] = gc.enable,
    ) -> None:
        """Freeze nothing yet.

        Args:
            freeze: Excludes all present objects from collections, as `gc.freeze` does.
            unfreeze: Includes them again.
            collect: Collects all that nothing uses.
            pause: Makes no collections from now on.
            resume: Makes them again.
        """
        self._freeze, self._unfreeze, self._collect = freeze, unfreeze, collect
        self._pause, self._resume = pause, resume
        self._gone = self._uncollected = 0
        self._due_s: float | None = None

    @contextmanager
    def adding(self, now_s: float) -> Iterator[None]:
        """Collect nothing while robots are added; freeze their objects then, and in some time."""
        self._pause()
        try:
            yield
        finally:
            self._freeze()
            self._resume()
            self._due_s = now_s + FREEZE_AFTER_S

    def note_gone_robots(self, gone: int, left: int, now_s: float) -> None:
        """Include all objects in collections when as many robots have gone as are left.

        What a robot leaves refers to itself. Where others come within `FREEZE_AFTER_S`, it would
        be frozen again and never collected, so that it is collected here once it is enough.
        """
        self._gone += gone
        self._uncollected += gone
        if self._gone >= left:
            self._gone = 0
            self._unfreeze()
            if self._uncollected >= max(left, LEAST_GONE):
                self._uncollected = 0
                self._collect()
            self._due_s = now_s + FREEZE_AFTER_S

    def poll(self, now_s: float) -> None:
        """Freeze if it is due."""
        if self._due_s is not None and now_s >= self._due_s:
            self._due_s = None
            self._freeze()
