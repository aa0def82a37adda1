"""The reader's own time: goes on while it works or rests, and stands while others have the cores.

So a hang is found as soon as ever, and an honest file is not refused because the machine is busy.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

LOOK_EVERY_NS = 10_000_000
LONGEST_LOOK_NS = 1_000_000_000
"""Counted between two looks: who looks so seldom was stopped itself."""
LEAST_SHARE = 6
"""A sixth of wall time counts on any machine, so that an answer comes."""


def waited_ns(process_id: int) -> int:
    """Ask the kernel how long a process has waited for a core [ns]; 0 when it does not say."""
    try:
        text = Path(f"/proc/{process_id}/schedstat").read_text(encoding="ascii")
        return int(text.split()[1])
    except (OSError, IndexError, ValueError):
        return 0


class ReaderTime:
    """A clock for one reader after another."""

    def __init__(self, now_ns: Callable[[], int], waited: Callable[[int], int] = waited_ns) -> None:
        self._wall_ns = now_ns
        self._waited = waited
        self._process_id = 0
        self._seen_ns = now_ns()
        self._seen_waited_ns = self._counted_ns = self._own_ns = 0
        self.now_ns = 0
        """Since this clock was made; never goes back."""

    def watch(self, process_id: int) -> None:
        """Go by another process from now on."""
        self._process_id = process_id
        self._seen_waited_ns = self._waited(process_id)

    def look(self, every_ns: int = LOOK_EVERY_NS) -> bool:
        """Go on by what has passed since the last look, if that is enough; say whether it was."""
        now_ns = self._wall_ns()
        passed_ns = min(now_ns - self._seen_ns, LONGEST_LOOK_NS)
        if passed_ns < every_ns:
            return False
        waited_ns = self._waited(self._process_id)
        # The kernel adds a wait when it is over: what was counted until then is taken back.
        self._own_ns += passed_ns - (waited_ns - self._seen_waited_ns)
        self._counted_ns += passed_ns
        self._seen_ns, self._seen_waited_ns = now_ns, waited_ns
        self.now_ns = max(self.now_ns, self._own_ns, self._counted_ns // LEAST_SHARE)
        return True
