"""Asks the kernel for turns that are short and come at once: other programs hold steps up less.

Linux since 6.12 lets a thread choose how long its turns on a core are; one with shorter turns takes
the core from one with longer turns as soon as it wakes. Any user may ask; older kernels pass over
it.
"""

import ctypes
import os
import platform
import struct
import sys

TURN_NS = 100_000
"""The shortest that the kernel grants."""
SETTING = struct.Struct("=IIQiIQQQ")
"""Size, policy, flags, niceness, priority, and for this policy the length of turns [ns]; 0, 0."""
NOT_INHERITED = 1
SYSCALLS = {"x86_64": (314, 315), "aarch64": (274, 275)}
"""To set and to get, by machine."""


def ask_for_short_turns() -> bool:
    """Ask for the calling thread; say whether the kernel took it.

    What the thread starts has ordinary turns. A thread with a policy of its own keeps that.
    """
    if not _is_ordinary():
        return False
    setting = SETTING.pack(
        SETTING.size,
        os.SCHED_OTHER,
        NOT_INHERITED,
        os.getpriority(os.PRIO_PROCESS, 0),
        0,
        TURN_NS,
        0,
        0,
    )
    return _call(0, setting, 0) == 0


def turn_ns() -> int:
    """Ask how long turns of the calling thread are; 0 when the kernel does not tell."""
    room = ctypes.create_string_buffer(SETTING.size)
    if not _is_ordinary() or _call(1, room, SETTING.size, 0) != 0:
        return 0
    return int(SETTING.unpack(room.raw)[5])


def _is_ordinary() -> bool:
    if sys.platform != "linux" or platform.machine() not in SYSCALLS:
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


def _call(which: int, *arguments: object) -> int:
    number = SYSCALLS[platform.machine()][which]
    return int(ctypes.CDLL(None).syscall(number, 0, *arguments))
