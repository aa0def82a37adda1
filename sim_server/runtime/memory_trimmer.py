"""Gives memory back that clients made the server use: malloc keeps what is free."""

import threading
from collections.abc import Callable
from typing import Final

from zensim.proto.process_memory import read_resident_bytes, trim_memory

EXCESS_BYTES: Final = 24 << 20
"""Memory above that at the start from which trimming may be worth its time."""
WORTH_BYTES: Final = 4 << 20
PERIOD_S: Final = 2.0
MAX_PERIOD_S: Final = 512.0


class MemoryTrimmer:
    """Trims the memory of this process from time to time, less often while little is free."""

    def __init__(
        self,
        read_bytes: Callable[[], int] = read_resident_bytes,
        trim: Callable[[], object] = trim_memory,
    ) -> None:
        self._read_bytes = read_bytes
        self._trim = trim
        self._start_bytes = read_bytes()
        self._period_s = PERIOD_S
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="memory", daemon=True)

    def start(self) -> None:
        """Start the thread that trims."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._is_closed.set()
        self._thread.join()

    def poll(self) -> float:
        """Trim if that may be worth its time; return when to poll again [s]."""
        before = self._read_bytes()
        if before < self._start_bytes + EXCESS_BYTES:
            self._period_s = PERIOD_S
            return self._period_s
        self._trim()
        is_worth_it = before - self._read_bytes() >= WORTH_BYTES
        self._period_s = PERIOD_S if is_worth_it else min(2.0 * self._period_s, MAX_PERIOD_S)
        return self._period_s

    def _run(self) -> None:
        wait_s = PERIOD_S
        while not self._is_closed.wait(wait_s):
            wait_s = self.poll()
