"""Delay of a driven robot's next step, as seen by a subscriber."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

from benchmarks.bodies import CONFIG
from benchmarks.circling_driver import AGENT, WORLD
from benchmarks.ten_robots import MILLISECONDS, POLL_S
from zensim.proto.bus import Bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.topic_catalog import DRIVE_STATE

DEPTH = 4096
PERIOD_S = CONFIG.control_steps * CONFIG.step_ns * 1e-9


class Lateness:
    """Arrival times of drive states."""

    def __init__(self) -> None:
        self._came: list[tuple[float, float]] = []

    def note(self, now_s: float, time_s: float) -> None:
        """Record the arrival and simulation time of a state."""
        self._came.append((now_s, time_s))

    def longest_ms(self, start_s: float, end_s: float) -> float:
        """Find the maximum delay of a state, including one missing at the end.

        Raises:
            IndexError: No state arrived before the end.
        """
        came = [(now_s, time_s) for now_s, time_s in self._came if now_s <= end_s]
        came.append((end_s, came[-1][1] + PERIOD_S))
        waits = [
            (after[0] - before[0]) - (after[1] - before[1])
            for before, after in pairwise(came)
            if after[0] >= start_s
        ]
        return max(waits) * MILLISECONDS


@contextmanager
def record_lateness(bus: Bus) -> Iterator[Lateness]:
    """Record the drive states of the circling robots, at real-time factor 1."""
    states, seen, is_over = bus.subscribe(DRIVE_STATE.key(WORLD, AGENT), DEPTH), Lateness(), False

    def listen() -> None:
        while not is_over:
            for sample in states.take():
                state = decode(DriveState, sample.payload, sample.encoding)
                seen.note(time.perf_counter(), state.time_ns * 1e-9)
            time.sleep(POLL_S)

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    try:
        yield seen
    finally:
        is_over = True
        thread.join()
        states.close()
