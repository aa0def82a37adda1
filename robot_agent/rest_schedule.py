"""How long the robots of an agent need no state: while nobody subscribes and no target changes."""

import math
from collections.abc import Callable
from typing import Final

from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS

QUIET_NS: Final = 500_000_000
"""Simulation time without a change after which an agent rests."""
LONGEST_REST_NS: Final = 100_000_000
"""Longest rest: a new subscriber waits so long for the first message."""


class RestSchedule:
    """Compares the answers of an agent."""

    def __init__(self) -> None:
        self._answer: tuple[object, ...] = ()
        self._since_ns = self._state_ns = 0
        self._period_ns = 0
        """Time between two states before the rest."""
        self.is_resting = False
        """Whether the agent needs no state soon, as of its last answer."""

    @property
    def longest_update_s(self) -> float:
        """Most time [s] that an update of a drive may count: none passes in a rest."""
        return self._period_ns / NANOSECONDS if self.is_resting else math.inf

    def find_rest_ns(self, state: DriveState, targets: bytes, is_idle: Callable[[], bool]) -> int:
        """Find how long no state is needed after this one; 0 = the next one is.

        Args:
            state: That was answered.
            targets: Of the answer.
            is_idle: Whether no robot has a subscriber, or anything else to do at each state.
        """
        answer = (state.epoch, state.claims, state.order, targets, state.is_awaited)
        gap_ns, self._state_ns = state.time_ns - self._state_ns, state.time_ns
        if answer != self._answer or state.is_awaited:
            self._answer, self._since_ns = answer, state.time_ns
            self.is_resting = False
            return 0
        was_resting, self.is_resting = (
            self.is_resting,
            state.time_ns - self._since_ns >= QUIET_NS and is_idle(),
        )
        if not self.is_resting:
            return 0
        if not was_resting:
            self._period_ns = gap_ns
        # Not at once for long: a late command counts for twice the time between two states.
        return min(LONGEST_REST_NS, 2 * gap_ns)

    def wake(self) -> None:
        """Note that a command came, so that the next states are needed."""
        self._answer = ()
