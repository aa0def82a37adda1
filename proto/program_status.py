"""What others read of a running program: its phase, the last turn of its loop, its metrics."""

import math
import os
import time
from collections.abc import Callable, Iterator
from typing import Final, Literal

import msgspec

from zensim.proto.metric_families import ListMetrics, MetricFamily
from zensim.proto.service_manager import ServiceManager

SERVER_TURN_S: Final = 5.0
"""Wall time after which the loop of a server counts as stuck without a turn."""
CLIENT_TURN_S: Final = 30.0
"""Turn of other programs: it may wait for some replies of a server that hangs, 5 s for each."""

Phase = Literal["starting", "restoring", "ready", "draining"]
WORDS: Final[dict[Phase, str]] = {
    "starting": "the program starts",
    "restoring": "the journal is restored",
    "draining": "the program ends",
}


class HealthCheck(msgspec.Struct, frozen=True):
    """Result of one check; without a fault it is passed."""

    name: str
    fault: str = ""

    @property
    def line(self) -> str:
        """One line of text."""
        return f"[-] {self.name}: {self.fault}" if self.fault else f"[+] {self.name}: ok"


class ProgramStatus:
    """Written by the thread of the program's loop, and read by other threads."""

    def __init__(
        self,
        now_s: Callable[[], float] = time.monotonic,
        manager: ServiceManager | None = None,
        *,
        max_turn_s: float = SERVER_TURN_S,
    ) -> None:
        """Start without a turn.

        Args:
            now_s: Wall time from any origin.
            manager: Is notified of phases, and of turns if it has a watchdog.
            max_turn_s: Wall time after which a loop without a turn counts as stuck.
        """
        self._max_turn_s = max_turn_s
        self._manager = manager
        self._notify_at_s = math.inf
        self.phase: Phase = "starting"
        self.world = ""
        """World of the program; a label of its metrics."""
        self.sources: list[ListMetrics] = []
        """Sources of metrics; other threads call them, at any time."""
        self._now_s = now_s
        self._turn_s: float | None = None

    def note_turn(self) -> None:
        """Note that the loop makes a turn; the first one ends the start."""
        now_s = self._now_s()
        if self._turn_s is None and self.phase != "draining":
            self.phase = "ready"
            self._begin_notifying(now_s)
        self._turn_s = now_s
        if now_s >= self._notify_at_s:
            self._notify("WATCHDOG=1")
            self._notify_at_s = now_s + self._watchdog_period_s

    def drain(self) -> None:
        """Note that the program ends; safe in a signal handler."""
        if self.phase != "draining":
            self.phase = "draining"
            self._notify("STOPPING=1")

    @property
    def _watchdog_period_s(self) -> float:
        period_s = self._manager.watchdog_period_s if self._manager is not None else None
        return math.inf if period_s is None else period_s

    def _begin_notifying(self, now_s: float) -> None:
        self._notify("READY=1")
        self._notify_at_s = now_s + self._watchdog_period_s

    def _notify(self, state: str) -> None:
        if self._manager is not None:
            self._manager.notify(state)

    def list_metrics(self) -> Iterator[MetricFamily]:
        """List the metrics of all sources now."""
        for source in tuple(self.sources):
            yield from source()

    def check_alive(self) -> HealthCheck:
        """Check that the loop is not stuck; before its first turn, and at the end, it is not."""
        # The end has a time limit of its own, and closes files after the last turn.
        turn_s = None if self.phase == "draining" else self._turn_s
        idle_s = 0.0 if turn_s is None else self._now_s() - turn_s
        fault = f"no turn for {idle_s:.1f} s" if idle_s > self._max_turn_s else ""
        return HealthCheck("loop", fault)

    def check_ready(self) -> HealthCheck:
        """Check that requests are accepted."""
        return HealthCheck("phase", WORDS.get(self.phase, ""))


def make_program_status(world: str, max_turn_s: float) -> ProgramStatus:
    """Make the status of this process, which notifies the service manager that started it."""
    status = ProgramStatus(manager=ServiceManager(os.environ), max_turn_s=max_turn_s)
    status.world = world
    return status
