"""Return zero-filled pages of large malloc blocks to the kernel (Linux with glibc, one thread)."""

import ctypes
import mmap
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

MIN_BLOCK_BYTES = 1 << 19
"""malloc maps blocks of at least this size one by one."""
RELEASE_CHUNK_BYTES = 1 << 16
"""Compared with zero and released at once."""
M_MMAP_THRESHOLD, MADV_DONTNEED = -3, 4
MALLOC_IS_MMAPPED, MALLOC_FLAGS = 2, 7
"""Bits of the word before a block, which holds its size and flags."""
MALLOC_HEADER_BYTES = 2 * ctypes.sizeof(ctypes.c_size_t)


def use_mmap_for_large_blocks() -> bool:
    """Make malloc map each large block separately; return whether it does."""
    return _is_glibc() and bool(ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, MIN_BLOCK_BYTES))


def release_zero_pages() -> int:
    """Release pages of zeros; return how many bytes. Does nothing if there are other threads."""
    if not _is_glibc() or len(list(Path("/proc/self/task").iterdir())) > 1:
        return 0
    advise = ctypes.CDLL(None).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    released = 0
    for start, end in [block for area in _anonymous_areas() for block in _mmapped_blocks(*area)]:
        for address in range(start, end - RELEASE_CHUNK_BYTES + 1, RELEASE_CHUNK_BYTES):
            if _is_zero(address) and advise(address, RELEASE_CHUNK_BYTES, MADV_DONTNEED) == 0:
                released += RELEASE_CHUNK_BYTES
    return released


def _is_zero(address: int) -> bool:
    words = RELEASE_CHUNK_BYTES // ctypes.sizeof(ctypes.c_uint64)
    return not np.ctypeslib.as_array((ctypes.c_uint64 * words).from_address(address)).any()


def _anonymous_areas() -> Iterator[tuple[int, int]]:
    """List private anonymous memory of this process, adjacent mappings joined."""
    first = last = 0
    for line in Path("/proc/self/maps").read_text(encoding="ascii").splitlines():
        addresses, permissions, _, _, inode, *name = line.split()
        if permissions == "rw-p" and inode == "0" and not name:
            start, end = (int(number, 16) for number in addresses.split("-"))
            if start != last:
                yield first, last
                first = start
            last = end
    yield first, last


def _mmapped_blocks(start: int, end: int) -> Iterator[tuple[int, int]]:
    """List the whole pages of consecutive blocks that malloc mapped, from an address on."""
    while start + MALLOC_HEADER_BYTES <= end:
        previous_size, word = (ctypes.c_size_t * 2).from_address(start)
        size = word & ~MALLOC_FLAGS
        is_block = (
            previous_size == 0
            and word & MALLOC_FLAGS == MALLOC_IS_MMAPPED
            and size % mmap.PAGESIZE == 0
        )
        if not is_block or size < MIN_BLOCK_BYTES or start + size > end:
            return
        yield start + mmap.PAGESIZE, start + size
        start += size


def _is_glibc() -> bool:
    return sys.platform == "linux" and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")
