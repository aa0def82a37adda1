"""What an agent does now and then besides driving; in wall time."""

from typing import Protocol

ANNOUNCE_S = 0.2
COMPLAIN_S = 1.0


class Kept(Protocol):
    """Robots that are looked after."""

    def answer(self) -> None:
        """Tell last values to those who have asked."""

    def announce(self) -> None:
        """Publish what never changes to those who have begun to listen."""

    def complain(self) -> None:
        """Log which commands were malformed."""


class Upkeep:
    """Answers questions, greets new listeners, and says what was malformed."""

    def __init__(self, kept: Kept) -> None:
        self._kept = kept
        self._announce_s = self._complain_s = 0.0

    def poll(self, now_s: float) -> None:
        """Answer, and do what else is due."""
        self._kept.answer()
        if now_s >= self._announce_s:
            self._announce_s = now_s + ANNOUNCE_S
            self._kept.announce()
        if now_s >= self._complain_s:
            self._complain_s = now_s + COMPLAIN_S
            self._kept.complain()
