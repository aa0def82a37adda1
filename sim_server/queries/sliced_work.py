"""Work of a request that is done in time slices, between the steps of the loop."""

from collections.abc import Callable, Iterator
from typing import TypeVar

import msgspec

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.service_parts import DeferredResponse, Pacing

SLICE_NS = 2 * NANOSECONDS // 1000
"""Least time that the work takes of each turn of the loop; a quarter of a step if that is more."""
MAX_WORK_S = 1.0
"""Most time that it may take in total."""

WorkResponse = TypeVar("WorkResponse", bound=msgspec.Struct)


class SlicedWork:
    """Work that goes on by one time slice at each turn of the loop, until it is done or too long.

    Attributes:
        is_too_long: Whether it was ended before it was done.
    """

    def __init__(self, steps: Iterator[None], pacing: Pacing) -> None:
        """Prepare the work.

        Args:
            steps: Do a short part of it each.
            pacing: Of the server.
        """
        self.is_too_long = False
        self._steps = steps
        self._now_ns = pacing.now_ns
        self._slice_ns = pacing.loop_stats.work_budget_ns(SLICE_NS)
        self._elapsed_ns = 0

    def respond(
        self, finish: Callable[[], WorkResponse]
    ) -> WorkResponse | DeferredResponse[WorkResponse]:
        """Do the first slice; respond now if that was all, or some turns later.

        Args:
            finish: Makes the response, or raises an error.
        """
        return finish() if self._advance() else DeferredResponse(self._advance, finish)

    def _advance(self) -> bool:
        """Work for one slice; return whether no more is to be done."""
        start_ns = self._now_ns()
        for _ in self._steps:
            passed_ns = self._now_ns() - start_ns
            if passed_ns >= self._slice_ns:
                self._elapsed_ns += passed_ns
                self.is_too_long = self._elapsed_ns > MAX_WORK_S * NANOSECONDS
                return self.is_too_long
        return True
