"""Time slices of threads: short ones for what must run soon after it is ready."""

import ctypes
import os
import platform
import struct

TIME_SLICE_NS = 100_000
"""Shortest slice that the kernel grants."""
SCHED_ATTR = struct.Struct("=IIQiIQQQ")
"""`struct sched_attr`: size, policy, flags, niceness, priority, time slice [ns], 0, 0."""
RESET_ON_FORK = 1
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""System call number of sched_setattr, by machine."""


def request_short_time_slice() -> bool:
    """Request short slices for the calling thread; return whether the kernel accepted.

    Threads and processes started later have ordinary slices. Other policies are left unchanged.
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
    number = SCHED_SETATTR[platform.machine()]
    return int(ctypes.CDLL(None).syscall(number, 0, setting, 0)) == 0


def _has_default_policy() -> bool:
    if not hasattr(os, "sched_getscheduler") or platform.machine() not in SCHED_SETATTR:
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
