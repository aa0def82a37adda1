"""Memory of this process: arenas of malloc, resident bytes, what is given back."""

import ctypes
import mmap
import sys
from pathlib import Path

STATM = Path("/proc/self/statm")
M_ARENA_MAX = -8
"""Number of the parameter in glibc's malloc.h."""
MALLOC_ARENAS = 2


def limit_malloc_arenas() -> bool:
    """Let threads share two arenas of malloc; return whether they do. Call it before they start.

    By default glibc has eight for each core, and an arena keeps what other threads have freed.
    """
    if sys.platform != "linux":
        return False
    library = ctypes.CDLL(None)
    has_arenas = hasattr(library, "gnu_get_libc_version")
    return has_arenas and bool(library.mallopt(M_ARENA_MAX, MALLOC_ARENAS))


def read_resident_bytes() -> int:
    """Read the resident memory of this process; 0 where there is no /proc."""
    try:
        return int(STATM.read_text(encoding="ascii").split()[1]) * mmap.PAGESIZE
    except OSError:
        return 0


def trim_memory() -> bool:
    """Give free memory of malloc back to the system; return whether there was any."""
    if sys.platform != "linux":
        return False
    library = ctypes.CDLL(None)
    return hasattr(library, "malloc_trim") and bool(library.malloc_trim(0))
