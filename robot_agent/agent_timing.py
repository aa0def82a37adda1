"""When an agent polls, how long it accepts late commands, and its process priority."""

import math
from collections.abc import Callable

from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS

MIN_PERIOD_S = 0.002
"""Minimum wall time between two answers while time runs freely."""
LEAD_S = 0.002
"""Polling starts this long before the next state is due."""
POLL_S = 0.001
"""Polling period from then on."""
MAX_PAUSE_S = 0.01
"""Maximum pause; everything else may wait as long."""
MAX_COMMAND_PAUSE_S = 0.0035
"""Maximum pause of an agent that applies late commands."""
IDLE_AFTER_S, IDLE_S = 0.5, 0.003
"""Without states for so long, time is taken as stopped; the first state may wait one pause."""
EAGER_S, EAGER_POLL_S = 0.02, 0.0003
"""After an awaited state, polling is fast for so long: time waits for the next answer."""
PERIOD_GROWTH = 1.1
"""Growth of the expected period per state when states come less often."""


class PollSchedule:
    """Pauses between polls, from the wall time between drive states."""

    def __init__(self, longest_s: float = MAX_PAUSE_S) -> None:
        """Start without a known period.

        Args:
            longest_s: Maximum pause [s].
        """
        self._longest_s = longest_s
        self._state_s = self._eager_until_s = -math.inf
        self._period_s = 0.0

    def note_state(self, now_s: float, *, is_awaited: bool) -> None:
        """Note the arrival of a state."""
        gap_s = now_s - self._state_s
        self._state_s = now_s
        self._period_s = min(gap_s, PERIOD_GROWTH * max(self._period_s, MIN_PERIOD_S))
        if is_awaited:
            self._eager_until_s = now_s + EAGER_S

    def pause_s(self, now_s: float) -> float:
        """Find the pause until the next poll [s]."""
        if now_s < self._eager_until_s:
            return EAGER_POLL_S
        passed_s = now_s - self._state_s
        if passed_s > IDLE_AFTER_S:
            return IDLE_S
        left_s = max(MIN_PERIOD_S, self._period_s - LEAD_S) - passed_s
        return min(left_s, self._longest_s) if left_s > 0.0 else POLL_S


NICENESS = 19
"""A seventieth of the default CPU weight; with a tenth, agents that wake preempt physics."""
RTF_WINDOW_S = 0.5
"""Wall time over which the real-time factor is measured."""
FAST_RTF, SLOW_RTF = 1.5, 1.2
"""Real-time factors above which the priority is lowered, and below which it is restored."""


class ProcessPriority:
    """Lowers the priority of the process while simulation time runs fast."""

    def __init__(self, set_niceness: Callable[[int], bool]) -> None:
        """Start with default priority.

        Args:
            set_niceness: Sets the niceness of this process; returns whether it is done.
        """
        self._set_niceness = set_niceness
        self._niceness = 0
        self._since: tuple[float, int] | None = None

    def note_state(self, now_s: float, state: DriveState) -> None:
        """Note the arrival of a state at a wall time."""
        if self._since is None or state.is_awaited or state.time_ns < self._since[1]:
            self._since = (now_s, state.time_ns)
            return
        elapsed_s = now_s - self._since[0]
        if elapsed_s < RTF_WINDOW_S:
            return
        factor = (state.time_ns - self._since[1]) / NANOSECONDS / elapsed_s
        self._since = (now_s, state.time_ns)
        wanted = NICENESS if factor > FAST_RTF else 0 if factor < SLOW_RTF else self._niceness
        if wanted != self._niceness and self._set_niceness(wanted):
            self._niceness = wanted


WINDOW_PERIODS = 2.0
"""Duration of the window, in periods between states; after it, time is taken to be stopped."""
MIN_WINDOW_S, MAX_WINDOW_S = 0.05, 1.0
"""Limits of the duration [s]."""


class LateCommandWindow:
    """Time in which the answer to the newest state may be revised once.

    If time waits for agents or is stepped by requests, each state has one answer: later commands
    count for the next state, so that equal requests give equal bytes.
    """

    def __init__(self) -> None:
        self._state: DriveState | None = None
        self._came_s = self._until_s = -math.inf

    def note_state(self, state: DriveState, now_s: float) -> None:
        """Note a state that was answered."""
        before, self._state = self._state, state
        has_run = (
            before is not None
            and (before.epoch, before.claims) == (state.epoch, state.claims)
            and before.step < state.step
        )
        gap_s, self._came_s = now_s - self._came_s, now_s
        lasts_s = min(max(MIN_WINDOW_S, WINDOW_PERIODS * gap_s), MAX_WINDOW_S)
        self._until_s = now_s + lasts_s if has_run and not state.is_awaited else -math.inf

    def is_open(self, now_s: float) -> bool:
        """Whether a command may change the last answer now."""
        return now_s < self._until_s

    def close(self) -> None:
        """Note that the answer was revised."""
        self._until_s = -math.inf
