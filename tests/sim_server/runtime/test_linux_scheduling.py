"""Short time slices, requested from the kernel in threads that end with the tests."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from zensim.sim_server.runtime.linux_scheduling import (
    TIME_SLICE_NS,
    read_time_slice_ns,
    request_short_time_slice,
)

T = TypeVar("T")
ORDINARY_NS = read_time_slice_ns()
"""0 where the kernel does not report it."""
SHORT_NS = min(TIME_SLICE_NS, ORDINARY_NS)
PRINT_SLICE = "from zensim.sim_server.runtime.linux_scheduling import read_time_slice_ns; print(read_time_slice_ns())"


def aside(call: Callable[[], T]) -> T:
    """Call in a new thread."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result()


def test_time_slices_are_short_when_requested() -> None:
    def asked() -> tuple[bool, int]:
        return request_short_time_slice(), read_time_slice_ns()

    found = aside(asked)

    assert found == (True, SHORT_NS)


def test_niceness_stays_with_short_time_slices() -> None:
    def asked() -> tuple[int, int]:
        os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, 0) + 1)
        before = os.getpriority(os.PRIO_PROCESS, 0)
        request_short_time_slice()
        return before, os.getpriority(os.PRIO_PROCESS, 0)

    before, after = aside(asked)

    assert after == before


def test_child_process_has_ordinary_time_slices() -> None:
    def started() -> int:
        request_short_time_slice()
        command = [sys.executable, "-c", PRINT_SLICE]
        return int(subprocess.run(command, capture_output=True, check=True).stdout)

    found = aside(started)

    assert found == ORDINARY_NS


def test_thread_with_a_policy_of_its_own_keeps_it() -> None:
    def asked() -> tuple[bool, int]:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        return request_short_time_slice(), os.sched_getscheduler(0)

    found = aside(asked)

    assert found == (False, os.SCHED_BATCH)
