"""Memory that another thread writes to before it is needed."""

import ctypes
import subprocess
import sys

from tests.contract.repository import ROOT
from tests.page_faults import PAGE_BYTES, count_page_faults
from zensim.sim_server.physics.cells.memory_reserve import MemoryReserve

BLOCK_BYTES = 16 << 20


def write_to_new_block() -> None:
    libc = ctypes.CDLL(None)
    libc.malloc.restype = ctypes.c_void_p
    address = libc.malloc(ctypes.c_size_t(BLOCK_BYTES))
    ctypes.memset(address, 1, BLOCK_BYTES)
    libc.free(ctypes.c_void_p(address))


def count_faults_after_release() -> int:
    """Count page faults of memory that a reserve has released."""
    reserve = MemoryReserve(BLOCK_BYTES + (1 << 20))
    reserve.prepare()
    reserve.release()
    return count_page_faults(write_to_new_block)


def test_released_memory_is_used_without_page_faults() -> None:
    # In a process of its own: malloc prefers an older free block, whose pages may be gone.
    code = f"from {__name__} import *; print(count_faults_after_release())"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )

    assert int(done.stdout) < BLOCK_BYTES // PAGE_BYTES // 10


def test_reserve_is_prepared_once_until_it_is_released() -> None:
    reserve = MemoryReserve(BLOCK_BYTES)
    reserve.prepare()

    assert count_page_faults(reserve.prepare) < BLOCK_BYTES // PAGE_BYTES // 10
    reserve.release()
    reserve.release()


def test_reserve_of_no_size_does_nothing() -> None:
    reserve = MemoryReserve(0)

    reserve.prepare()
    reserve.release()
