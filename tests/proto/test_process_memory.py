"""Threads share arenas of malloc."""

import subprocess
import sys

from tests.contract.repository import ROOT
from zensim.proto.process_memory import MALLOC_ARENAS


def test_threads_share_arenas_of_malloc() -> None:
    script = (
        "import ctypes, threading; from zensim.proto import process_memory as memory\n"
        "memory.limit_malloc_arenas(); barrier = threading.Barrier(9); libc = ctypes.CDLL(None)\n"
        "libc.malloc.restype = ctypes.c_void_p\n"
        "def work(): libc.malloc(1000); barrier.wait()\n"
        "[threading.Thread(target=work).start() for _ in range(8)]; barrier.wait()\n"
        "libc.malloc_stats()"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)

    assert 1 <= done.stderr.count("Arena ") <= MALLOC_ARENAS
