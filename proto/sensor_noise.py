"""Noise of sensors without a stream: keyed by seed, entity and sensor, counted by step and ray.

The noise of a measurement is a pure function of its key and step: it is the same in every process,
in any order and in any batch, after a reset, and whenever the robot was claimed.
"""

import math
from collections.abc import Sequence
from hashlib import blake2b
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.drive_messages import Compat
from zensim.proto.messages.model_messages import Sensor
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.sensor_messages import Noise
from zensim.proto.messages.standard_messages import NANOSECONDS

FloatArray = npt.NDArray[np.float64]
KeyArray = npt.NDArray[np.uint64]

KEY_BYTES = 8
WORD = 1 << 64
GOLDEN_GAMMA = 0x9E3779B97F4A7C15
"""2^64 divided by the golden ratio, odd. Source: SplitMix64 (Steele, Lea, Flood 2014)."""
MIX_FACTORS = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
MIX_SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31))
MANTISSA_SHIFT = np.uint64(11)
UNIT = 2.0**-53
WHITE, FIXED_BIAS, COIN, DYNAMIC_BIAS, UNIFORM = range(5)
"""Purposes of draws; each has numbers of its own."""
BLOCK_TIMES = 32.0
"""Correlation times after which a dynamic bias counts as forgotten: e^-32 is 1e-14."""


def make_noise_key(seed: int, entity: str, sensor: Sensor) -> int:
    """Make the key of a sensor's noise, below 2^64.

    Args:
        seed: Of the world; see `Environment.seed`.
        entity: Name of the robot.
        sensor: Identified by its link and name.
    """
    parts = (str(seed), entity, sensor.link, sensor.name)
    text = "".join(f"{len(part)}:{part}" for part in parts)
    return int.from_bytes(blake2b(text.encode(), digest_size=KEY_BYTES).digest(), "little")


Counter: TypeAlias = int | KeyArray
"""One counter for all keys, or one for each (n,)."""


def draw_uniforms(keys: KeyArray, counter: Counter, count: int) -> FloatArray:
    """Draw numbers (n, count) in [0, 1), which do not depend on those of other keys."""
    return _to_unit(draw_words(keys, counter, count))


def draw_words(keys: KeyArray, counter: Counter, count: int) -> KeyArray:
    """Draw words (n, count) of 64 random bits; see `draw_uniforms`."""
    return _draw_bits(keys, counter, count, UNIFORM)


def draw_normals(keys: KeyArray, counter: Counter, count: int, purpose: int = WHITE) -> FloatArray:
    """Draw numbers of the standard normal distribution, by Box-Muller from SplitMix64.

    Args:
        keys: (n,).
        counter: Step since the epoch began.
        count: Numbers of each key: one per ray or axis.
        purpose: One of the constants of this module.

    Returns:
        (n, count); number i of a key does not depend on the count or on other keys.
    """
    pairs = (count + 1) // 2
    bits = _draw_bits(keys, counter, 2 * pairs, purpose)
    # 1 - u is in (0, 1]: its logarithm is finite.
    radius = np.sqrt(-2.0 * np.log(1.0 - _to_unit(bits[:, :pairs])))
    angle = (2.0 * math.pi) * _to_unit(bits[:, pairs:])
    found = np.empty((len(keys), pairs, 2))
    found[:, :, 0] = radius * np.cos(angle)
    found[:, :, 1] = radius * np.sin(angle)
    return found.reshape(len(keys), 2 * pairs)[:, :count]


def _draw_bits(keys: KeyArray, counter: Counter, count: int, purpose: int) -> KeyArray:
    """Draw (n, count) words; the two of a pair of numbers are count / 2 columns apart."""
    start = keys + np.uint64((purpose + 1) * GOLDEN_GAMMA % WORD)
    if isinstance(counter, int):
        steps: np.uint64 | KeyArray = np.uint64((counter + 1) * GOLDEN_GAMMA % WORD)
    else:
        steps = (counter + np.uint64(1)) * np.uint64(GOLDEN_GAMMA)
    state = _mix(_mix(start) + steps)
    # Words 1, 3, 5, ..., then 2, 4, 6, ...: pair i is the same, whatever the count.
    order = np.arange(1, count + 1, dtype=np.uint64)
    order = np.concatenate([order[::2], order[1::2]]) * np.uint64(GOLDEN_GAMMA)
    return _mix(state[:, None] + order)


def _mix(bits: KeyArray) -> KeyArray:
    """Mix words in place, so that each bit depends on all. Source: SplitMix64."""
    bits ^= bits >> MIX_SHIFTS[0]
    bits *= MIX_FACTORS[0]
    bits ^= bits >> MIX_SHIFTS[1]
    bits *= MIX_FACTORS[1]
    bits ^= bits >> MIX_SHIFTS[2]
    return bits


def _to_unit(bits: KeyArray) -> FloatArray:
    """Convert words to numbers in [0, 1), in an array of their own."""
    return np.asarray((bits >> MANTISSA_SHIFT).astype(np.float64) * UNIT)


def draw_fixed_biases(noises: Sequence[Noise], keys: KeyArray, compat: Compat) -> FloatArray:
    """Draw the biases (n, quantities) that a sensor has throughout.

    Args:
        noises: One per quantity.
        keys: (n,).
        compat: With gazebo11 the sign of a bias is drawn, too, even without a spread.
    """
    mean = np.array([noise.bias_mean for noise in noises])
    spread = np.array([noise.bias_stddev for noise in noises])
    found = mean + spread * draw_normals(keys, 0, len(noises), FIXED_BIAS)
    if compat != "gazebo11":
        return found
    return np.where(draw_normals(keys, 0, len(noises), COIN) < 0.0, -found, found)


class DynamicBiases:
    """Biases that walk at random: an Ornstein-Uhlenbeck process per row and quantity.

    Steps are divided into blocks much longer than the correlation time. The bias at the ends of a
    block is drawn from the stationary distribution N(0, stddev^2 * time / 2), and that in the
    middle of two known steps from its distribution between them, so that it is exact at each step
    and does not depend on the steps that were asked for before.
    """

    def __init__(self, noises: Sequence[Noise], keys: KeyArray, step_s: float) -> None:
        """Create the biases; a quantity without a correlation time has none.

        Args:
            noises: One per quantity.
            keys: (n,).
            step_s: Simulation time of a step; > 0.
        """
        times_s = np.array([noise.dynamic_bias_correlation_time_s for noise in noises])
        is_dynamic = times_s > 0.0
        self._times_steps = np.where(is_dynamic, times_s, 1.0) / step_s
        rates = np.array([noise.dynamic_bias_stddev for noise in noises])
        self._spread = np.where(is_dynamic, rates * np.sqrt(times_s / 2.0), 0.0)
        longest = float(self._times_steps.max(initial=1.0)) * BLOCK_TIMES
        self._block_steps = 1 << math.ceil(math.log2(max(longest, 1.0)))
        self._keys = keys
        self._ends: list[tuple[int, FloatArray]] = []
        """Known biases after `_start`, each with its step, the latest first."""
        self._start: tuple[int, FloatArray] | None = None
        """Known bias at or before the step of the last call."""

    def at(self, step: int) -> FloatArray:
        """Find the biases (n, quantities) at a step."""
        first, low = self._find_bracket(step)
        while first != step:
            last, high = self._ends[-1]
            if last == step:
                break
            middle = (first + last) // 2
            between = middle, self._draw_between(middle, last - first, low, high)
            if middle <= step:
                first, low = between
            else:
                self._ends.append(between)
        self._start = first, low
        return low if first == step else self._ends[-1][1]

    def _find_bracket(self, step: int) -> tuple[int, FloatArray]:
        """Find the nearest known bias at or before a step, with later ones in `_ends`."""
        start = self._start
        block = step // self._block_steps * self._block_steps
        if start is None or not block <= start[0] <= step:
            after = block + self._block_steps
            self._ends = [(after, self._draw_stationary(after))]
            return block, self._draw_stationary(block)
        while self._ends[-1][0] < step:
            start = self._ends.pop()
        return start

    def _draw_stationary(self, step: int) -> FloatArray:
        return self._spread * draw_normals(self._keys, step, len(self._spread), DYNAMIC_BIAS)

    def _draw_between(
        self, middle: int, length: int, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        kept = np.exp(-0.5 * length / self._times_steps)
        share, spread = kept / (1.0 + kept**2), np.sqrt((1.0 - kept**2) / (1.0 + kept**2))
        return (low + high) * share + spread * self._draw_stationary(middle)


class SensorNoise:
    """Noise of equal sensors, a row per sensor."""

    def __init__(
        self,
        noises: Sequence[Noise],
        keys: Sequence[int] | KeyArray,
        environment: Environment,
        compat: Compat = "fixed",
    ) -> None:
        """Create the noise.

        Args:
            noises: One per quantity; a single one holds for all columns, as for all rays.
            keys: One per sensor; see `make_noise_key`.
            environment: Of the world.
            compat: Of the sensors.
        """
        self._keys = np.array(keys, dtype=np.uint64)
        noises = [noise if noise.kind != "none" else Noise() for noise in noises]
        self.is_noisy = any(noise.kind != "none" for noise in noises)
        self._stddev = np.array([noise.stddev for noise in noises])
        fixed = draw_fixed_biases(noises, self._keys, compat)
        self._bias = fixed + np.array([noise.mean for noise in noises])
        self._precision = np.array(
            [noise.precision if noise.kind == "gaussian_quantized" else 0.0 for noise in noises]
        )
        self._dynamic: DynamicBiases | None = None
        if any(noise.dynamic_bias_correlation_time_s > 0.0 for noise in noises):
            step_s = environment.step_ns / NANOSECONDS
            self._dynamic = DynamicBiases(noises, self._keys, step_s)

    @property
    def is_counted_by_row(self) -> bool:
        """Whether each sensor may have a step of its own: it has no bias that walks."""
        return self._dynamic is None

    def apply(self, values: FloatArray, step: Counter) -> FloatArray:
        """Add noise to the measurements (n, columns) of a step; also rounds if quantized.

        Args:
            values: Measured exactly; not changed.
            step: Since the epoch began; of each sensor (n,) only if `is_counted_by_row`.

        Raises:
            ValueError: Sensors with a bias that walks have steps of their own.
        """
        if not self.is_noisy:
            return values
        found = values + self._bias
        if self._dynamic is not None:
            if not isinstance(step, int):
                raise ValueError("a bias that walks is that of one step of all sensors")
            found += self._dynamic.at(step)
        if self._stddev.any():
            found += self._stddev * draw_normals(self._keys, step, values.shape[1])
        return self._quantize(found)

    def apply_to_ranges(
        self, ranges: FloatArray, step: Counter, *, range_min_m: float, range_max_m: float
    ) -> FloatArray:
        """Add noise to finite ranges (n, rays) [m]; it never leaves the limits.

        Infinite ranges and NaN stay as they are.
        """
        if not self.is_noisy:
            return ranges
        is_measured = np.isfinite(ranges)
        exact = np.where(is_measured, ranges, 0.0)
        noisy = np.clip(self.apply(exact, step), range_min_m, range_max_m)
        return np.where(is_measured, noisy, ranges)

    def _quantize(self, values: FloatArray) -> FloatArray:
        if not self._precision.any():
            return values
        unit = np.where(self._precision > 0.0, self._precision, 1.0)
        return np.where(self._precision > 0.0, np.rint(values / unit) * unit, values)
