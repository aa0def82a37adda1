"""CPU time of one thread by part, excluding nested parts."""

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Stopwatch:
    """Accumulates the CPU time [ns] of this thread by part."""

    def __init__(self, now_ns: Callable[[], int] = time.thread_time_ns) -> None:
        self.spent_ns: dict[str, int] = {}
        self._now_ns = now_ns
        self._since_ns = now_ns()
        self._open: list[str] = []

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Attribute the time of a block to a part."""
        self._enter(name)
        try:
            yield
        finally:
            self._leave()

    def timed(self, name: str, call: Callable[P, T]) -> Callable[P, T]:
        """Wrap a function to attribute its time to a part."""

        def counted(*args: P.args, **kwargs: P.kwargs) -> T:
            self._enter(name)
            try:
                return call(*args, **kwargs)
            finally:
                self._leave()

        return counted

    def timed_each(
        self, name: str, call: Callable[P, Iterator[T]]
    ) -> Callable[P, Generator[T, None, None]]:
        """Wrap a generator function to attribute its own time to a part."""

        def counted(*args: P.args, **kwargs: P.kwargs) -> Generator[T, None, None]:
            items = self.timed(name, call)(*args, **kwargs)
            advance = self.timed(name, lambda: next(items, None))
            while (item := advance()) is not None:
                yield item

        return counted

    def _enter(self, name: str) -> None:
        self._charge()
        self._open.append(name)

    def _leave(self) -> None:
        self._charge()
        self._open.pop()

    def _charge(self) -> None:
        """Attribute the time since the last change to the innermost part."""
        now_ns = self._now_ns()
        if self._open:
            name = self._open[-1]
            self.spent_ns[name] = self.spent_ns.get(name, 0) + now_ns - self._since_ns
        self._since_ns = now_ns
