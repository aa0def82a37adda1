"""What a process may use: CPU time, memory, files, priority; and its end with its parent."""

import ctypes
import os
import signal
import sys
import time
from collections.abc import Mapping
from math import ceil
from pathlib import Path
from typing import NamedTuple

if sys.platform != "win32":
    import resource

PARENT_PID_VARIABLE = "ZENSIM_PARENT"
"""Environment variable with the process id of the supervisor."""
PR_SET_PDEATHSIG = 1


class ResourceLimits(NamedTuple):
    """Limits of a process that handles untrusted input; there is never a core dump."""

    extra_memory_bytes: int
    """Address space beyond what the process has when the limits are set."""
    total_cpu_s: int | None = None
    """CPU time since the process started; the kernel kills it afterwards."""
    is_sandboxed: bool = False
    """Whether new file descriptors, file data, processes and threads are refused."""


def die_with_parent(signal_number: signal.Signals = signal.SIGKILL) -> None:
    """Make the kernel send this process a signal when its parent ends (Linux only)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal_number, 0, 0, 0)


def die_with_supervisor(environ: Mapping[str, str]) -> None:
    """Terminate this process when the supervisor that the environment names ends.

    Raises:
        SystemExit: It has ended already.
    """
    parent = environ.get(PARENT_PID_VARIABLE, "")
    if not parent.isdigit() or sys.platform != "linux":
        return
    die_with_parent(signal.SIGTERM)
    if os.getppid() != int(parent):
        sys.exit(1)


def set_resource_limits(limits: ResourceLimits) -> None:
    """Set hard limits; they cannot be raised again."""
    # Reading it needs a file descriptor.
    max_bytes = _address_space_bytes() + limits.extra_memory_bytes
    if limits.is_sandboxed:
        for kind in (resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE, resource.RLIMIT_NPROC):
            resource.setrlimit(kind, (0, 0))
    if limits.total_cpu_s is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (limits.total_cpu_s, limits.total_cpu_s))
    resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def allow_cpu_time(seconds: int) -> None:
    """Allow this much CPU time from now on, in whole seconds; SIGXCPU follows. May be repeated."""
    total_s = ceil(time.process_time()) + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (total_s, resource.RLIM_INFINITY))


def set_niceness(niceness: int, process_id: int = 0, proc: Path = Path("/proc")) -> bool:
    """Set the niceness of a process, and of its session if the process leads the session.

    The kernel may share cores among sessions first; niceness then counts only inside of one.

    Args:
        niceness: -20 to 19.
        process_id: 0 is this process.
        proc: Mount point of the process file system.

    Returns:
        False if the kernel is busy (it accepts ten changes a second) and a later try may succeed.
        True also if the permission is lacking, as for most users who lower a niceness.
    """
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


def _address_space_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return pages * resource.getpagesize()
