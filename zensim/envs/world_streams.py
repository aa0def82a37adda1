"""WorldStreams: random numbers of many worlds, in arrays."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zensim.api.argument_checks import check_whole
from zensim.proto.se3 import FloatArray
from zensim.proto.sensor_noise import draw_uniforms, draw_words

IntArray = npt.NDArray[np.intp]
SEED_SHIFT = np.uint64(2)
MAX_SEED = (1 << 128) - 1
"""Greatest entropy that NumPy draws."""


class WorldStreams:
    """A key and a counter of each world: what a world draws does not depend on the others."""

    def __init__(self, worlds: int) -> None:
        """Seed all worlds by chance."""
        self._keys = np.zeros(worlds, np.uint64)
        self._counters = np.zeros(worlds, np.uint64)
        self.seed(None, np.arange(worlds))

    def seed(self, seed: int | None, worlds: IntArray) -> None:
        """Start some worlds (m,) anew: a world has the same numbers, whatever their number.

        Raises:
            Invalid: The seed is not a whole number >= 0.
        """
        roots = np.full(len(worlds), _make_root(seed))
        self._keys[worlds] = draw_words(roots, worlds.astype(np.uint64), 1)[:, 0]
        self._counters[worlds] = 0

    def seed_each(self, seeds: Sequence[int | None]) -> None:
        """Start worlds anew, each as the first of its seed; None = a world goes on."""
        rows = [row for row, seed in enumerate(seeds) if seed is not None]
        roots = np.array([_make_root(seeds[row]) for row in rows], np.uint64)
        self._keys[rows] = draw_words(roots, 0, 1)[:, 0]
        self._counters[rows] = 0

    def draw(self, worlds: IntArray, count: int) -> FloatArray:
        """Draw numbers (m, count) in [0, 1) for some worlds (m,)."""
        return draw_uniforms(self._keys[worlds], self._advance(worlds), count)

    def draw_seeds(self, worlds: IntArray) -> list[int]:
        """Draw a seed of each of some worlds (m,), from 0 to 2^62 - 1."""
        words = draw_words(self._keys[worlds], self._advance(worlds), 1)[:, 0]
        return [int(word) for word in words >> SEED_SHIFT]

    def _advance(self, worlds: IntArray) -> npt.NDArray[np.uint64]:
        self._counters[worlds] += np.uint64(1)
        return self._counters[worlds]


def _make_root(seed: int | None) -> np.uint64:
    if seed is not None:
        check_whole("seed", seed, 0, MAX_SEED)
    root: np.uint64 = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
    return root
