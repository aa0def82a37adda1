"""What keys and gamepad command: direction, speeds, stop and end. No terminal, no network."""

from collections.abc import Iterable
from typing import Final, Literal

import msgspec

from zensim.proto.terminal_keys import KeyEvent
from zensim.spawner.teleop.drive_twists import DriveStyle, Speeds
from zensim.spawner.teleop.gamepad import FASTER_BUTTON, SLOWER_BUTTON, PadState
from zensim.spawner.teleop.held_keys import FIRST_HOLD_S, HeldKeys
from zensim.spawner.teleop.key_bindings import (
    END_KEYS,
    FASTER,
    MOTION_OF_KEY,
    SLOWER,
    SPEED_OF_KEY,
    SUSPEND_KEY,
    Direction,
)

FocusLoss = Literal["end", "stop", "ignore"]
Ending = Literal["", "keys", "focus", "terminal", "signal"]
PAD_SPEEDS: Final = {FASTER_BUTTON: FASTER, SLOWER_BUTTON: SLOWER}


class TeleopSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How keys and gamepad act."""

    speeds: Speeds = Speeds()
    first_hold_s: float = FIRST_HOLD_S
    """How long a key acts whose repeats have not come yet."""
    focus_loss: FocusLoss = "end"
    """What happens when the terminal loses the focus of the keyboard."""
    enable_button: int | None = None
    """Button of the gamepad that has to be held; None = none."""


class TeleopState:
    """The command of a user, from events of keys and of a gamepad."""

    def __init__(self, settings: TeleopSettings, styles: Iterable[DriveStyle]) -> None:
        """Start at rest.

        Args:
            settings: How keys act.
            styles: Of the robots that are driven; all steered ones keep moving while steered.
        """
        of_robots = tuple(styles)
        self.speeds = settings.speeds
        self.ending: Ending = ""
        self.pad = PadState(enable_button=settings.enable_button)
        self._is_suspended = False
        self._focus_loss = settings.focus_loss
        self._is_holonomic = any(style.is_holonomic for style in of_robots)
        self._keys = HeldKeys(
            first_hold_s=settings.first_hold_s,
            is_steered=bool(of_robots) and all(style.is_steered for style in of_robots),
        )

    def handle_keys(self, events: Iterable[KeyEvent], now_s: float) -> None:
        """Act on keys; those that stand for nothing stop the robots."""
        for event in events:
            if event.key in MOTION_OF_KEY or event.kind == "release":
                self._keys.handle(event, now_s)
            else:
                self._act(event.key)

    def take_suspension(self) -> bool:
        """Take whether a key asked to suspend this process, as no terminal does that reports it."""
        is_suspended, self._is_suspended = self._is_suspended, False
        return is_suspended

    def handle_pad(self, data: bytes) -> None:
        """Act on events of the gamepad."""
        for button in self.pad.feed(data):
            factor = PAD_SPEEDS.get(button, 1.0)
            self.speeds = self.speeds.scale(factor, factor)

    def lose_pad(self) -> None:
        """Note that the gamepad is gone."""
        self.pad = PadState()

    def stop(self) -> None:
        """Command nothing until a new key, or until the sticks were at rest."""
        self._keys.release_all()
        self.pad.stop()

    def find_direction(self, now_s: float) -> Direction:
        """Find the direction commanded now; the gamepad counts while no key does."""
        of_keys = self._keys.find_direction(now_s)
        return of_keys or self.pad.find_direction(is_holonomic=self._is_holonomic)

    def _act(self, key: str) -> None:
        if key in SPEED_OF_KEY:
            self.speeds = self.speeds.scale(*SPEED_OF_KEY[key])
        elif key == "focus_out":
            self._lose_focus()
        elif key != "focus_in":
            self.stop()
            self._is_suspended |= key == SUSPEND_KEY
            self.ending = "keys" if key in END_KEYS else self.ending

    def _lose_focus(self) -> None:
        if self._focus_loss == "ignore":
            return
        self.stop()
        if self._focus_loss == "end":
            self.ending = "focus"
