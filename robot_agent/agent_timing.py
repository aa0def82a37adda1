"""When an agent polls, how long it accepts late commands, and its process priority."""

import math
from collections.abc import Callable

from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS

MIN_PERIOD_S = 0.002
"""Between two answers while time runs freely: more often a command does nothing but cost."""
LEAD_S = 0.002
"""So long before the next state is due it is looked for."""
POLL_S = 0.001
"""Pause between looks around then."""
MAX_PAUSE_S = 0.01
"""Pause in which everything else may wait."""
MAX_COMMAND_PAUSE_S = 0.0035
"""Pause in which a command may wait that could change the last answer."""
IDLE_AFTER_S, IDLE_S = 0.5, 0.003
"""When no state has come for so long, time stands: the first one then may wait a little."""
EAGER_S, EAGER_POLL_S = 0.02, 0.0003
"""So long after an awaited state the next one is near, and time stands until it is answered."""
PERIOD_GROWTH = 1.1
"""How fast the beat is forgotten when states come less often."""


class PollSchedule:
    """Learns the wall time between drive states."""

    def __init__(self, longest_s: float = MAX_PAUSE_S) -> None:
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
        self._period_s = min(gap_s, PERIOD_GROWTH * max(self._period_s, MIN_PERIOD_S))
        if is_awaited:
            self._eager_until_s = now_s + EAGER_S

    def pause_s(self, now_s: float) -> float:
        """Find how long to sleep [s]."""
        if now_s < self._eager_until_s:
            return EAGER_POLL_S
        passed_s = now_s - self._state_s
        if passed_s > IDLE_AFTER_S:
            return IDLE_S
        left_s = max(MIN_PERIOD_S, self._period_s - LEAD_S) - passed_s
        return min(left_s, self._longest_s) if left_s > 0.0 else POLL_S


NICENESS = 19
"""Weighs a seventieth of what is ordinary: with a tenth, agents that wake up push physics aside."""
RTF_WINDOW_S = 0.5
"""Wall time between two looks at how fast time runs."""
FAST_RTF, SLOW_RTF = 1.5, 1.2
"""Real-time factors above which an agent stands back, and below which it comes forward again."""


class ProcessPriority:
    """Watches how fast simulation time runs, and stands back while it runs fast."""

    def __init__(self, be_nice: Callable[[int], bool]) -> None:
        """Stand where every process does.

        Args:
            be_nice: Sets the niceness of this process; says whether that can be told as done.
        """
        self._be_nice = be_nice
        self._niceness = 0
        self._since: tuple[float, int] | None = None

    def note_state(self, now_s: float, state: DriveState) -> None:
        """Take note of a state that has come at a moment of the wall's time."""
        if self._since is None or state.is_awaited or state.time_ns < self._since[1]:
            self._since = (now_s, state.time_ns)
            return
        elapsed_s = now_s - self._since[0]
        if elapsed_s < RTF_WINDOW_S:
            return
        factor = (state.time_ns - self._since[1]) / NANOSECONDS / elapsed_s
        self._since = (now_s, state.time_ns)
        wanted = NICENESS if factor > FAST_RTF else 0 if factor < SLOW_RTF else self._niceness
        if wanted != self._niceness and self._be_nice(wanted):
            self._niceness = wanted


WINDOW_PERIODS = 2.0
"""So long after a state a new command is heeded, in times between two; later, time stands."""
MIN_WINDOW_S, MAX_WINDOW_S = 0.05, 1.0
"""The same in seconds."""


class LateCommandWindow:
    """Lets the answer to the newest state be revised once.

    Where time waits for agents, or is made step by step, each state has one answer: what comes
    later is for the next, so that the same requests give the same bytes.
    """

    def __init__(self) -> None:
        self._state: DriveState | None = None
        self._came_s = self._until_s = -math.inf

    def note_state(self, state: DriveState, now_s: float) -> None:
        """Take note of a state that was answered."""
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
        """Whether a command that comes now may change the answer."""
        return now_s < self._until_s

    def close(self) -> None:
        """Take note that the answer was revised."""
        self._until_s = -math.inf
