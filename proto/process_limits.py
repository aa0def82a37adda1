"""What depends on the operating system: limits, priority, file locks, a process's end.

No other module imports fcntl, msvcrt or resource. Where a system lacks something, its function does
nothing, and says so.
"""

import os
import socket
import stat
import time
from contextlib import suppress
from importlib import import_module
from math import ceil
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from zensim.proto.process_memory import STATM

DEFAULT_FILE_LIMIT = 512
"""Open files of a process where the system does not report its limit."""
MAX_FILE_LIMIT = 1 << 16


def _import_if_there(name: str) -> ModuleType | None:
    try:
        return import_module(name)
    except ModuleNotFoundError:
        return None


resource = _import_if_there("resource")
fcntl, msvcrt = _import_if_there("fcntl"), _import_if_there("msvcrt")
"""Modules of the standard library; None where the system lacks them: Windows has msvcrt alone."""

LOCKED_OFFSET = 1 << 30
"""Offset of the byte that Windows locks: beyond the end, so that others can read the file."""
KILLED_STATUS, OUT_OF_CPU_TIME_STATUS = -9, -24
"""Exit status of a process that was killed, or ended by its limit of CPU time."""


class ResourceLimits(NamedTuple):
    """Limits of a process that handles untrusted input; there is never a core dump."""

    extra_memory_bytes: int
    """Address space beyond what the process has when the limits are set."""
    total_cpu_s: int | None = None
    """CPU time since the process started; the kernel kills it afterwards."""
    is_sandboxed: bool = False
    """Whether new file descriptors, file data, processes and threads are refused."""


def set_resource_limits(limits: ResourceLimits) -> None:
    """Set hard limits; they cannot be raised again.

    Windows has none, and where there is no /proc, memory is not limited.
    """
    if resource is None:
        return
    # Reading it needs a file descriptor.
    used_bytes = _find_address_space_bytes()
    if limits.is_sandboxed:
        for kind in (resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE, resource.RLIMIT_NPROC):
            resource.setrlimit(kind, (0, 0))
    if limits.total_cpu_s is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (limits.total_cpu_s, limits.total_cpu_s))
    if used_bytes is not None:
        max_bytes = used_bytes + limits.extra_memory_bytes
        resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def allow_cpu_time(seconds: int) -> None:
    """Allow this much CPU time from now on, in whole seconds; SIGXCPU follows. May be repeated.

    Windows has no limit of CPU time.
    """
    if resource is None:
        return
    total_s = ceil(time.process_time()) + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (total_s, resource.RLIM_INFINITY))


def limit_unacknowledged_time(port: int, milliseconds: int) -> bool:
    """Close connections to a port of this process whose peer takes no data for some time.

    Returns:
        Whether this process listens at the port, and the system can do it (Linux).
    """
    descriptors = Path("/proc/self/fd")
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    if option is None or not descriptors.is_dir():
        return False
    found = False
    for entry in list(descriptors.iterdir()):
        if (listener := _open_listener(int(entry.name), port)) is not None:
            with listener:  # accepted connections inherit it
                listener.setsockopt(socket.IPPROTO_TCP, option, milliseconds)
            found = True
    return found


def _open_listener(descriptor: int, port: int) -> socket.socket | None:
    """Open a duplicate of a descriptor if it listens at a TCP port."""
    try:
        if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
            return None
        duplicate = os.dup(descriptor)
    except OSError:
        return None
    opened = socket.socket(fileno=duplicate)
    try:
        is_tcp = opened.family in {socket.AF_INET, socket.AF_INET6}
        is_listening = is_tcp and opened.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
        if is_listening and opened.getsockname()[1] == port:
            return opened
    except OSError:
        pass
    opened.close()
    return None


def raise_file_limit() -> int:
    """Raise the limit of open files of this process as far as it may; return the limit."""
    if resource is None:
        return DEFAULT_FILE_LIMIT
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    # Some systems have no hard limit, and refuse to have no limit.
    wanted = MAX_FILE_LIMIT if hard == resource.RLIM_INFINITY else min(hard, MAX_FILE_LIMIT)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
            soft = wanted
    return MAX_FILE_LIMIT if soft == resource.RLIM_INFINITY else int(soft)


def set_niceness(niceness: int, process_id: int = 0, proc: Path = Path("/proc")) -> bool:
    """Set the niceness of a process, and of its session if the process leads the session.

    The kernel may share cores among sessions first; niceness then counts only inside of one.

    Args:
        niceness: -20 to 19.
        process_id: 0 is this process.
        proc: Mount point of the process file system.

    Returns:
        False if the kernel is busy (it accepts ten changes a second) and a later try may succeed.
        True also if the permission is lacking, as for most users who lower a niceness, and on
        Windows, which has no niceness.
    """
    if not hasattr(os, "setpriority"):
        return True
    try:
        os.setpriority(os.PRIO_PROCESS, process_id, niceness)
        session_share = proc / (str(process_id) if process_id else "self") / "autogroup"
        is_leader = os.getsid(process_id) == (process_id or os.getpid())
        if is_leader and session_share.exists():
            session_share.write_text(str(niceness), encoding="ascii")
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def raise_niceness(least: int) -> bool:
    """Set the niceness of this process unless it is as great; see `set_niceness`."""
    if not hasattr(os, "getpriority"):
        return True
    return set_niceness(max(least, os.getpriority(os.PRIO_PROCESS, 0)))


def lock_file(descriptor: int) -> None:
    """Lock an open file for this process until the descriptor is closed.

    Raises:
        OSError: Another process has locked it.
    """
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    elif msvcrt is not None:
        os.lseek(descriptor, LOCKED_OFFSET, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)


def sync_folder(folder: Path) -> None:
    """Make the entries of a folder durable; Windows has no such call, and journals them itself."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def count_usable_cores() -> int:
    """Count the cores that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return cores or 1


def _find_address_space_bytes() -> int | None:
    """Find how much address space this process has; None where the system does not report it."""
    try:
        pages = int(STATM.read_text(encoding="ascii").split()[0])
    except OSError:
        return None
    return pages * (resource.getpagesize() if resource is not None else 0)
