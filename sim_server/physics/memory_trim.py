"""Return zero-filled pages of large malloc blocks to the kernel; Linux with glibc, single-threaded processes only."""

import ctypes
import mmap
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

MIN_BLOCK_BYTES = 1 << 19
"""Blocks from this size on are mapped by themselves."""
RELEASE_CHUNK_BYTES = 1 << 16
"""Looked at, and given back, at once."""
M_MMAP_THRESHOLD, MADV_DONTNEED = -3, 4
MALLOC_IS_MMAPPED, MALLOC_FLAGS = 2, 7
"""Of the word that malloc writes before a block: its size, and what kind it is."""
MALLOC_HEADER_BYTES = 2 * ctypes.sizeof(ctypes.c_size_t)


def use_mmap_for_large_blocks() -> bool:
    """Have malloc map each large block by itself from now on; say whether it does."""
    return _is_glibc() and bool(ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, MIN_BLOCK_BYTES))


def release_zero_pages() -> int:
    """Give pages of zeros back; say how many bytes. Nothing, where there are other threads."""
    if not _is_glibc() or len(list(Path("/proc/self/task").iterdir())) > 1:
        return 0
    advise = ctypes.CDLL(None).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    given = 0
    for start, end in [block for area in _anonymous_areas() for block in _mmapped_blocks(*area)]:
        for at in range(start, end - RELEASE_CHUNK_BYTES + 1, RELEASE_CHUNK_BYTES):
            if _is_zero(at) and advise(at, RELEASE_CHUNK_BYTES, MADV_DONTNEED) == 0:
                given += RELEASE_CHUNK_BYTES
    return given


def _is_zero(at: int) -> bool:
    words = RELEASE_CHUNK_BYTES // ctypes.sizeof(ctypes.c_uint64)
    return not np.ctypeslib.as_array((ctypes.c_uint64 * words).from_address(at)).any()


def _anonymous_areas() -> Iterator[tuple[int, int]]:
    """List memory of this process that is no file's, nobody else's, and has no name.

    The kernel tells apart what lies side by side and is only treated otherwise: that is one area.
    """
    first = last = 0
    for line in Path("/proc/self/maps").read_text(encoding="ascii").splitlines():
        place, rights, _, _, inode, *name = line.split()
        if rights == "rw-p" and inode == "0" and not name:
            start, end = (int(number, 16) for number in place.split("-"))
            if start != last:
                yield first, last
                first = start
            last = end
    yield first, last


def _mmapped_blocks(start: int, end: int) -> Iterator[tuple[int, int]]:
    """List the whole pages of blocks that malloc has mapped one after the other from a place on."""
    while start + MALLOC_HEADER_BYTES <= end:
        before, word = (ctypes.c_size_t * 2).from_address(start)
        size = word & ~MALLOC_FLAGS
        is_block = (
            before == 0 and word & MALLOC_FLAGS == MALLOC_IS_MMAPPED and size % mmap.PAGESIZE == 0
        )
        if not is_block or size < MIN_BLOCK_BYTES or start + size > end:
            return
        yield start + mmap.PAGESIZE, start + size
        start += size


def _is_glibc() -> bool:
    return sys.platform == "linux" and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")
