"""Priority of an agent's process while simulation time runs fast."""

from collections.abc import Callable

from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS

NICENESS = 19
"""A seventieth of the default CPU weight; with a tenth, agents that wake preempt physics."""
RTF_WINDOW_S = 0.5
"""Wall time over which the real-time factor is measured."""
FAST_RTF, SLOW_RTF = 1.5, 1.2
"""Real-time factors above which the priority is lowered, and below which it is restored."""
FAST_WINDOWS = 3
"""Successive windows with a factor above `FAST_RTF` after which the priority is lowered. After work
that took seconds, the newest state is later than the time that it is compared with: one window."""


class ProcessPriority:
    """Lowers the priority of the process while simulation time runs fast."""

    def __init__(self, set_niceness: Callable[[int], bool]) -> None:
        """Start with default priority.

        Args:
            set_niceness: Sets the niceness of this process; returns whether it is done.
        """
        self._set_niceness = set_niceness
        self._niceness = self._fast_windows = 0
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
        self._fast_windows = self._fast_windows + 1 if factor > FAST_RTF else 0
        is_fast = self._fast_windows >= FAST_WINDOWS
        wanted = NICENESS if is_fast else 0 if factor < SLOW_RTF else self._niceness
        if wanted != self._niceness and self._set_niceness(wanted):
            self._niceness = wanted
