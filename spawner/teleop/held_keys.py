"""The direction that keys command: which are held, for terminals with and without key releases.

Most terminals send nothing when a key is released, only repeats while it is held, and of the last
key alone. So a press acts for a while, long enough for the first repeat to come; after that, a
key acts for a few periods of repetition.
"""

import math
from collections.abc import Iterable
from typing import Final

from zensim.proto.terminal_keys import KeyEvent
from zensim.spawner.teleop.key_bindings import MOTION_OF_KEY, STILL, Direction

FIRST_HOLD_S: Final = 0.6
"""A press acts for so long: most terminals repeat after 0.25 to 0.6 s, X after 0.66 s at most."""
REPEAT_HOLD_S: Final = 0.2
"""A repeated key acts for so long: repeats come 10 to 33 times a second."""
SILENCE_S: Final = 1.0
"""Keys with releases act no longer than this after the last event: a lost link sends none."""


class HeldKeys:
    """The keys that are held, and since when nothing came of them."""

    def __init__(self, *, first_hold_s: float = FIRST_HOLD_S, is_steered: bool = False) -> None:
        """Start without keys.

        Args:
            first_hold_s: How long a press acts without a repeat.
            is_steered: Whether a robot with steered wheels is driven: it keeps moving while it
                is steered, as it cannot turn on the spot.
        """
        self._first_hold_s = first_hold_s
        self._is_steered = is_steered
        self._held: dict[str, str] = {}
        """Keys whose release will be reported, by their code: modifiers may change meanwhile."""
        self._has_releases = False
        self._last_event_s = -math.inf
        self._last_key, self._last_code = "", ""
        self._last_direction = STILL
        self._until_s = -math.inf

    def handle(self, event: KeyEvent, now_s: float) -> None:
        """Note an event of a key that stands for a motion, or the release of any key."""
        self._has_releases |= event.has_release
        self._last_event_s = now_s
        if event.kind == "release":
            self._release(event.code)
        elif self._has_releases:
            self._held[event.code] = event.key
        else:
            self._press(event, now_s)

    def _release(self, code: str) -> None:
        self._held.pop(code, None)
        if code == self._last_code:
            self._until_s = -math.inf

    def _press(self, event: KeyEvent, now_s: float) -> None:
        key = event.key
        is_repeat = key == self._last_key and now_s <= self._until_s
        if not is_repeat:
            self._last_direction = self._combine(MOTION_OF_KEY[key], now_s)
        self._last_key, self._last_code = key, event.code
        self._until_s = now_s + (REPEAT_HOLD_S if is_repeat else self._first_hold_s)

    def release_all(self) -> None:
        """Forget all keys."""
        self._held.clear()
        self._last_key, self._last_code, self._until_s = "", "", -math.inf

    def find_direction(self, now_s: float) -> Direction:
        """Find the direction that the keys command now."""
        if now_s - self._last_event_s > SILENCE_S:
            self._held.clear()
        directions = [MOTION_OF_KEY[key] for key in sorted(self._held.values())]
        if now_s <= self._until_s:
            directions.append(self._last_direction)
        return _add(directions)

    def _combine(self, pressed: Direction, now_s: float) -> Direction:
        before = self._last_direction
        if not self._is_steered or now_s > self._until_s:
            return pressed
        if pressed.turn and not pressed.ahead:
            return Direction(ahead=before.ahead, turn=pressed.turn)
        return pressed


def _add(directions: Iterable[Direction]) -> Direction:
    found = tuple(directions)
    return Direction(
        _clamp(sum(one.ahead for one in found)),
        _clamp(sum(one.left for one in found)),
        _clamp(sum(one.turn for one in found)),
    )


def _clamp(share: float) -> float:
    return max(-1.0, min(1.0, share)) + 0.0
