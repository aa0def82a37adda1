"""Short time slices: of the thread that requests them, and of no other."""

import ctypes
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from zensim.sim_server.runtime.time_slice import SCHED_ATTR, TIME_SLICE_NS, request_short_time_slice

T = TypeVar("T")
SCHED_GETATTR = {"x86_64": 315, "aarch64": 275}


def read_time_slice_ns() -> int:
    """Read the time slice of the calling thread; 0 if the kernel does not report it."""
    data = ctypes.create_string_buffer(SCHED_ATTR.size)
    number = SCHED_GETATTR.get(platform.machine())
    if number is None or ctypes.CDLL(None).syscall(number, 0, data, SCHED_ATTR.size, 0) != 0:
        return 0
    return int(SCHED_ATTR.unpack(data.raw)[5])


ORDINARY_NS = read_time_slice_ns()
"""0 where the kernel does not report it."""
SHORT_NS = min(TIME_SLICE_NS, ORDINARY_NS)
PRINT_SLICE = f"from {__name__} import read_time_slice_ns; print(read_time_slice_ns())"


def call_in_thread(call: Callable[[], T]) -> T:
    """Call in a new thread."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result()


def test_time_slices_are_short_when_requested() -> None:
    def measure() -> tuple[bool, int]:
        return request_short_time_slice(), read_time_slice_ns()

    found = call_in_thread(measure)

    assert found == (True, SHORT_NS)


def test_niceness_stays_with_short_time_slices() -> None:
    def measure() -> tuple[int, int]:
        os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, 0) + 1)
        before = os.getpriority(os.PRIO_PROCESS, 0)
        request_short_time_slice()
        return before, os.getpriority(os.PRIO_PROCESS, 0)

    before, after = call_in_thread(measure)

    assert after == before


def test_child_process_has_ordinary_time_slices() -> None:
    def start_child() -> int:
        request_short_time_slice()
        command = [sys.executable, "-c", PRINT_SLICE]
        return int(subprocess.run(command, capture_output=True, check=True).stdout)

    found = call_in_thread(start_child)

    assert found == ORDINARY_NS


def test_thread_with_a_policy_of_its_own_keeps_it() -> None:
    def measure() -> tuple[bool, int]:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        return request_short_time_slice(), os.sched_getscheduler(0)

    found = call_in_thread(measure)

    assert found == (False, os.SCHED_BATCH)
