"""Memory that another thread writes to before it is needed."""

import ctypes
import sys
import threading

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
MAX_HEAP_BLOCK_BYTES = 32 << 20
"""malloc maps larger blocks separately. It is what its own adjustment ends with."""


def is_glibc() -> bool:
    """Whether the C library of this process is glibc."""
    return sys.platform == "linux" and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")


class MemoryReserve:
    """Memory of malloc whose pages are there: what is allocated next causes no page faults.

    Without glibc, and of size 0, it does nothing.
    """

    def __init__(self, size_bytes: int) -> None:
        """Reserve nothing yet.

        Args:
            size_bytes: Less than `MAX_HEAP_BLOCK_BYTES`.
        """
        self._size_bytes = size_bytes if is_glibc() else 0
        self._address: int | None = None
        self._writing: threading.Thread | None = None

    def prepare(self) -> None:
        """Allocate the memory if it is not there, and begin to write to it; does not wait."""
        if self._writing is not None or not self._size_bytes:
            return
        libc = ctypes.CDLL(None)
        # Else the block is mapped separately, or returned to the system when it is freed.
        libc.mallopt(M_MMAP_THRESHOLD, MAX_HEAP_BLOCK_BYTES)
        libc.mallopt(M_TRIM_THRESHOLD, 2 * MAX_HEAP_BLOCK_BYTES)
        libc.malloc.restype = ctypes.c_void_p
        address = libc.malloc(ctypes.c_size_t(self._size_bytes))
        if address is None:
            return
        self._address = address
        # ctypes releases the interpreter's lock during the call.
        self._writing = threading.Thread(
            target=ctypes.memset, args=(address, 0, self._size_bytes), daemon=True
        )
        self._writing.start()

    def release(self) -> None:
        """Give the memory to what this thread allocates next; it must be that which prepared it."""
        if self._writing is None:
            return
        self._writing.join()
        ctypes.CDLL(None).free(ctypes.c_void_p(self._address))
        self._address = self._writing = None
