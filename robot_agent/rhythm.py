"""When to look for the next drive state: looking costs, and so does answering too often."""

import math

SOONEST_S = 0.002
"""Between two answers while time runs freely: more often a command does nothing but cost."""
EARLY_S = 0.002
"""So long before the next state is due it is looked for."""
LOOK_S = 0.001
"""Pause between looks around then."""
LONGEST_S = 0.01
"""Pause in which everything else may wait."""
COMMANDS_S = 0.0035
"""Pause in which a command may wait that could change the last answer."""
IDLE_AFTER_S, IDLE_S = 0.5, 0.003
"""When no state has come for so long, time stands: the first one then may wait a little."""
EAGER_S, EAGER_LOOK_S = 0.02, 0.0003
"""So long after an awaited state the next one is near, and time stands until it is answered."""
SLOWER = 1.1
"""How fast the beat is forgotten when states come less often."""


class Rhythm:
    """Learns the wall time between drive states."""

    def __init__(self, longest_s: float = LONGEST_S) -> None:
        """Know nothing yet.

        Args:
            longest_s: Pause in which nothing else is looked for.
        """
        self._longest_s = longest_s
        self._state_s = self._eager_until_s = -math.inf
        self._period_s = 0.0

    def note_state(self, now_s: float, *, is_awaited: bool) -> None:
        """Take note of a state that has come."""
        gap_s = now_s - self._state_s
        self._state_s = now_s
        self._period_s = min(gap_s, SLOWER * max(self._period_s, SOONEST_S))
        if is_awaited:
            self._eager_until_s = now_s + EAGER_S

    def pause_s(self, now_s: float) -> float:
        """Find how long to sleep [s]."""
        if now_s < self._eager_until_s:
            return EAGER_LOOK_S
        passed_s = now_s - self._state_s
        if passed_s > IDLE_AFTER_S:
            return IDLE_S
        left_s = max(SOONEST_S, self._period_s - EARLY_S) - passed_s
        return min(left_s, self._longest_s) if left_s > 0.0 else LOOK_S
