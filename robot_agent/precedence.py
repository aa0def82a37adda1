"""Lets physics have the cores first while time runs faster than the wall clock.

Where the kernel shares cores among sessions, ten agents have ten shares and the server has one.
Nothing waits for an agent then, and what it answers late is late by simulated time only.
"""

import os
from collections.abc import Callable
from pathlib import Path

from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS

NICENESS = 19
"""Weighs a seventieth of what is ordinary: with a tenth, agents that wake up push physics aside."""
WINDOW_S = 0.5
"""Wall time between two looks at how fast time runs."""
FAST, SLOW = 1.5, 1.2
"""Real-time factors above which an agent stands back, and below which it comes forward again."""


class Precedence:
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
        if elapsed_s < WINDOW_S:
            return
        factor = (state.time_ns - self._since[1]) / NANOSECONDS / elapsed_s
        self._since = (now_s, state.time_ns)
        wanted = NICENESS if factor > FAST else 0 if factor < SLOW else self._niceness
        if wanted != self._niceness and self._be_nice(wanted):
            self._niceness = wanted


def be_nice(niceness: int, processes: Path = Path("/proc")) -> bool:
    """Give this process and its session a niceness; the session only when it is this process's own.

    Returns:
        False when it should be tried again: the kernel takes ten such wishes a second. True also
        when the right is lacking, as for most users who want a niceness back.
    """
    try:
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
        shares = processes / "self" / "autogroup"
        if os.getsid(0) == os.getpid() and shares.exists():
            shares.write_text(str(niceness), encoding="ascii")
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
