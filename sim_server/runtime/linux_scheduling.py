"""Request short time slices from the Linux scheduler, so that other programs delay steps less."""

import ctypes
import os
import platform
import struct
import sys

TIME_SLICE_NS = 100_000
"""The shortest that the kernel grants."""
SCHED_ATTR = struct.Struct("=IIQiIQQQ")
"""Size, policy, flags, niceness, priority, and for this policy the length of turns [ns]; 0, 0."""
RESET_ON_FORK = 1
SYSCALLS = {"x86_64": (314, 315), "aarch64": (274, 275)}
"""To set and to get, by machine."""


def request_short_time_slice() -> bool:
    """Ask for the calling thread; say whether the kernel took it.

    What the thread starts has ordinary turns. A thread with a policy of its own keeps that.
    """
    if not _has_default_policy():
        return False
    setting = SCHED_ATTR.pack(
        SCHED_ATTR.size,
        os.SCHED_OTHER,
        RESET_ON_FORK,
        os.getpriority(os.PRIO_PROCESS, 0),
        0,
        TIME_SLICE_NS,
        0,
        0,
    )
    return _call_kernel(0, setting, 0) == 0


def read_time_slice_ns() -> int:
    """Ask how long turns of the calling thread are; 0 when the kernel does not tell."""
    room = ctypes.create_string_buffer(SCHED_ATTR.size)
    if not _has_default_policy() or _call_kernel(1, room, SCHED_ATTR.size, 0) != 0:
        return 0
    return int(SCHED_ATTR.unpack(room.raw)[5])


def _has_default_policy() -> bool:
    if sys.platform != "linux" or platform.machine() not in SYSCALLS:
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


def _call_kernel(which: int, *arguments: object) -> int:
    number = SYSCALLS[platform.machine()][which]
    return int(ctypes.CDLL(None).syscall(number, 0, *arguments))
