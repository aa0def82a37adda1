"""Request short time slices from the Linux scheduler, so that other programs delay steps less."""

import ctypes
import os
import platform
import struct
import sys

TIME_SLICE_NS = 100_000
"""Shortest slice that the kernel grants."""
SCHED_ATTR = struct.Struct("=IIQiIQQQ")
"""`struct sched_attr`: size, policy, flags, niceness, priority, time slice [ns], 0, 0."""
RESET_ON_FORK = 1
SYSCALLS = {"x86_64": (314, 315), "aarch64": (274, 275)}
"""Numbers of sched_setattr and sched_getattr, by machine."""


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
    return _call_kernel(0, setting, 0) == 0


def read_time_slice_ns() -> int:
    """Read the time slice of the calling thread; 0 if the kernel does not report it."""
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
