"""Position in a replay by wall time: rate, pause, seek."""

from typing import Final

from zensim.proto.messages.standard_messages import NANOSECONDS

UNLIMITED_NS: Final = (1 << 63) - 1
"""Position of a replay that goes as fast as it can."""


class ReplayClock:
    """Position [ns] since the start of a recording, by wall time [s]."""

    def __init__(self, rate: float, now_s: float, *, is_paused: bool = False) -> None:
        """Start at position 0.

        Args:
            rate: Recorded time per wall time; 0 = as fast as possible.
            now_s: Wall time.
            is_paused: Whether time stands still until `resume`.

        Raises:
            ValueError: The rate is negative or not finite.
        """
        self._rate = check_rate(rate)
        self._is_paused = is_paused
        self._anchor_s = now_s
        self._anchor_ns = 0

    @property
    def rate(self) -> float:
        """Recorded time per wall time; 0 = as fast as possible."""
        return self._rate

    @property
    def is_paused(self) -> bool:
        """Whether time stands still."""
        return self._is_paused

    @property
    def is_paced(self) -> bool:
        """Whether each position has a wall time."""
        return bool(self._rate) and not self._is_paused

    def read(self, now_s: float) -> int:
        """Read the position; `UNLIMITED_NS` at rate 0."""
        if self._is_paused:
            return self._anchor_ns
        if now_s < self._anchor_s:
            return self._anchor_ns - 1
        if not self._rate:
            return UNLIMITED_NS
        return self._anchor_ns + round((now_s - self._anchor_s) * self._rate * NANOSECONDS)

    def find_due_s(self, position_ns: int) -> float:
        """Find the wall time of a position; infinite while paused."""
        if self._is_paused:
            return float("inf")
        if not self._rate:
            return self._anchor_s
        return self._anchor_s + (position_ns - self._anchor_ns) / (self._rate * NANOSECONDS)

    def move(self, position_ns: int, now_s: float) -> None:
        """Continue from a position at a wall time."""
        self._anchor_ns, self._anchor_s = position_ns, now_s

    def pause(self, position_ns: int, now_s: float) -> None:
        """Stop at a position."""
        self.move(position_ns, now_s)
        self._is_paused = True

    def resume(self, now_s: float) -> None:
        """Continue from where it was paused."""
        if self._is_paused:
            self._anchor_s = now_s
        self._is_paused = False

    def set_rate(self, rate: float, position_ns: int, now_s: float) -> None:
        """Change the rate at a position.

        Raises:
            ValueError: It is negative or not finite.
        """
        self._rate = check_rate(rate)
        self.move(position_ns, now_s)


MAX_RATE: Final = 1e6


def check_rate(rate: float) -> float:
    """Return the rate if it is valid.

    Raises:
        ValueError: It is negative, above a million, or not a number.
    """
    if 0.0 <= rate <= MAX_RATE:
        return rate
    raise ValueError(f"rate {rate:g} is not valid; use 0 (as fast as possible) to {MAX_RATE:g}")
