"""Numbers that two processes see: memory that is gone when both are."""

import mmap
import os
from collections.abc import Sequence

import numpy as np

from zensim.sim_server.physics.engine import FloatArray

MOST_NUMBERS = 1 << 23
"""Room on a board: what is not written takes no memory."""


class Board:
    """An array of numbers in memory that is shared by its file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, 8 * MOST_NUMBERS)
        self._numbers: FloatArray = np.frombuffer(self._memory, dtype=np.float64)

    def write(self, arrays: Sequence[FloatArray]) -> None:
        """Write arrays one after the other.

        Raises:
            ValueError: There is no room for them.
        """
        if (count := sum(array.size for array in arrays)) > MOST_NUMBERS:
            raise ValueError(f"{count} numbers do not fit; a board has room for {MOST_NUMBERS}")
        at = 0
        for array in arrays:
            self._numbers[at : at + array.size] = array.reshape(-1)
            at += array.size

    def read(self, sizes: Sequence[int]) -> list[FloatArray]:
        """Copy arrays of these sizes, which were written one after the other."""
        ends = np.cumsum(sizes, dtype=np.intp)
        return np.split(self._numbers[: int(ends[-1]) if len(ends) else 0].copy(), ends[:-1])

    def close(self) -> None:
        """Let go of the memory."""
        self._numbers = np.zeros(0)
        self._memory.close()
        os.close(self.descriptor)


def new_board() -> Board:
    """Make memory for a board."""
    descriptor = os.memfd_create("zensim", os.MFD_CLOEXEC)
    os.ftruncate(descriptor, 8 * MOST_NUMBERS)
    return Board(descriptor)
