"""Pauses of a loop between states that come periodically.

A loop polls for states, or pauses until an `ArrivalSignal` ends the pause.
"""

import math

MIN_PERIOD_S = 0.002
"""Minimum wall time between two answers while time runs freely."""
LEAD_S = 0.002
"""Time before the next state is due at which polling starts."""
POLL_S = 0.001
"""Polling period from `LEAD_S` before a state on."""
MAX_PAUSE_S = 0.01
"""Maximum pause; everything else may wait as long."""
IDLE_AFTER_S, IDLE_S = 0.5, 0.003
"""Time without states after which time is taken as stopped, and the period then; the first state
may wait one pause."""
EAGER_S, EAGER_POLL_S = 0.02, 0.0003
"""Time of fast polling after an awaited state, and its period: time waits for the next answer."""
PERIOD_GROWTH = 1.1
"""Growth of the expected period per state when states come less often."""


class PollSchedule:
    """Pauses between polls, from the wall time between states."""

    def __init__(self, longest_s: float = MAX_PAUSE_S, *, is_woken: bool = False) -> None:
        """Start without a known period.

        Args:
            longest_s: Maximum pause [s].
            is_woken: Whether what arrives ends a pause.
        """
        self._longest_s = longest_s
        self._is_woken = is_woken
        self._state_s = self._eager_until_s = -math.inf
        self._period_s = 0.0

    def note_state(self, now_s: float, *, is_awaited: bool) -> None:
        """Note the arrival of a state."""
        gap_s = now_s - self._state_s
        self._state_s = now_s
        self._period_s = min(gap_s, PERIOD_GROWTH * max(self._period_s, MIN_PERIOD_S))
        if is_awaited:
            self._eager_until_s = now_s + EAGER_S

    def minimum_pause_s(self, now_s: float) -> float:
        """Find the part of the pause that no arrival ends [s]: it limits the rate of answers."""
        if not self._is_woken or now_s < self._eager_until_s:
            return 0.0
        return min(MIN_PERIOD_S, max(0.0, MIN_PERIOD_S - (now_s - self._state_s)))

    def pause_s(self, now_s: float) -> float:
        """Find the pause until the next poll [s], of a loop that polls."""
        if now_s < self._eager_until_s:
            return EAGER_POLL_S
        passed_s = now_s - self._state_s
        if passed_s > IDLE_AFTER_S:
            return IDLE_S
        left_s = max(MIN_PERIOD_S, self._period_s - LEAD_S) - passed_s
        return min(left_s, self._longest_s) if left_s > 0.0 else POLL_S
