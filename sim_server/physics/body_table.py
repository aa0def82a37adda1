"""Numbers of bodies: the only ones, from the world down to each engine, cell and worker."""

import heapq


class BodyNumbers:
    """Hands out numbers of bodies, the least free one first.

    Columns of bodies are indexed by these numbers, so that they stay short.
    """

    def __init__(self) -> None:
        self._free: list[int] = []
        """Heap of the numbers below `_end` that no body has."""
        self._end = 0

    def take(self) -> int:
        """Take the least free number."""
        if self._free:
            return heapq.heappop(self._free)
        self._end += 1
        return self._end - 1

    def give_back(self, body: int) -> None:
        """Let another body have a number."""
        heapq.heappush(self._free, body)
