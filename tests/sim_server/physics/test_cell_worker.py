"""Release of zero pages."""

import os
import subprocess
import sys
import threading

from zensim.sim_server.physics.cell_worker import ZeroPages

PROGRAM = """
import numpy as np, psutil
from zensim.sim_server.physics.cell_worker import ZeroPages, use_mmap_for_large_blocks
held = lambda: psutil.Process().memory_full_info().uss
assert use_mmap_for_large_blocks()
blank, full, mixed = np.empty(1 << 20), np.empty(1 << 20), np.empty(1 << 20)
blank[:], full[:], mixed[:] = 0.0, 1.5, 0.0
mixed[::200_000] = 2.5
before = held()
pages = ZeroPages()
given = pages.release()
print(given, before - held())
assert not blank.any() and (full == 1.5).all()
assert mixed.sum() == 6 * 2.5 and (mixed[::200_000] == 2.5).all()
blank[:] = 3.5
assert (blank == 3.5).all()
blank[:] = 0.0
assert pages.release() < 1 << 20
pages.forget()
assert pages.release() > 7 << 20
"""


def test_zero_pages_of_new_blocks_are_released_and_others_stay() -> None:
    done = subprocess.run(
        (sys.executable, "-c", PROGRAM),
        capture_output=True,
        text=True,
        check=True,
        timeout=50,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )

    given, freed = map(int, done.stdout.split())
    assert given > 14 << 20
    assert freed > 13 << 20


def test_nothing_is_released_with_other_threads() -> None:
    is_over = threading.Event()
    thread = threading.Thread(target=is_over.wait)
    thread.start()
    try:
        assert ZeroPages().release() == 0
    finally:
        is_over.set()
        thread.join()
