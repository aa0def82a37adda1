"""Gives memory back that holds nothing but zeros; Linux with glibc, in a process of one thread.

Each client of Bullet clears 20 MB for messages and pictures that nobody asks it for. A page of
zeros that is given back reads as zeros, and is there again when it is written to. Only blocks that
malloc has mapped by themselves are looked at: nothing else lives in their pages.
"""

import ctypes
import mmap
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

LEAST = 1 << 19
"""Blocks from this size on are mapped by themselves."""
PIECE = 1 << 16
"""Looked at, and given back, at once."""
MMAP_THRESHOLD, DONTNEED = -3, 4
IS_MAPPED, FLAGS = 2, 7
"""Of the word that malloc writes before a block: its size, and what kind it is."""
HEAD = 2 * ctypes.sizeof(ctypes.c_size_t)


def map_large_blocks() -> bool:
    """Have malloc map each large block by itself from now on; say whether it does."""
    return _is_glibc() and bool(ctypes.CDLL(None).mallopt(MMAP_THRESHOLD, LEAST))


def give_back_blank_pages() -> int:
    """Give pages of zeros back; say how many bytes. Nothing, where there are other threads."""
    if not _is_glibc() or len(list(Path("/proc/self/task").iterdir())) > 1:
        return 0
    advise = ctypes.CDLL(None).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    given = 0
    for start, end in [block for area in _areas() for block in _blocks(*area)]:
        for at in range(start, end - PIECE + 1, PIECE):
            if _is_blank(at) and advise(at, PIECE, DONTNEED) == 0:
                given += PIECE
    return given


def _is_blank(at: int) -> bool:
    words = PIECE // ctypes.sizeof(ctypes.c_uint64)
    return not np.ctypeslib.as_array((ctypes.c_uint64 * words).from_address(at)).any()


def _areas() -> Iterator[tuple[int, int]]:
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


def _blocks(start: int, end: int) -> Iterator[tuple[int, int]]:
    """List the whole pages of blocks that malloc has mapped one after the other from a place on."""
    while start + HEAD <= end:
        before, word = (ctypes.c_size_t * 2).from_address(start)
        size = word & ~FLAGS
        is_block = before == 0 and word & FLAGS == IS_MAPPED and size % mmap.PAGESIZE == 0
        if not is_block or size < LEAST or start + size > end:
            return
        yield start + mmap.PAGESIZE, start + size
        start += size


def _is_glibc() -> bool:
    return sys.platform == "linux" and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")
