"""Gamepads by the joystick interface of Linux: events of sticks and buttons as a direction.

Source: Documentation/input/joydev/joystick-api.rst of Linux; numbers of axes and buttons as the
drivers xpad and hid-playstation give them.
"""

import os
import struct
from pathlib import Path
from typing import Final

from zensim.spawner.teleop.key_bindings import STILL, Direction

EVENT: Final = struct.Struct("<IhBB")
"""Time [ms], value, type, number."""
BUTTON, AXIS = 0x01, 0x02
"""Types of events."""
STATE: Final = 0x80
"""Added to the type of a state: of everything, when a gamepad is opened, or events were lost."""
FULL: Final = 32767
DEAD_ZONE: Final = 0.1
"""Share of the deflection in which a stick is at rest."""
LEFT_X, LEFT_Y, RIGHT_X, PAD_X, PAD_Y = 0, 1, 3, 6, 7
STOP_BUTTON, SLOWER_BUTTON, FASTER_BUTTON = 1, 4, 5
"""B or circle; left and right shoulder."""
DEVICES: Final = Path("/dev/input")


class PadState:
    """Sticks and buttons, as of the last event."""

    def __init__(self, *, enable_button: int | None = None) -> None:
        """Start with everything at rest.

        Args:
            enable_button: The sticks act only while it is held; None = always.
        """
        self._enable_button = enable_button
        self._axes: dict[int, float] = {}
        self._buttons: set[int] = set()
        self._pending = b""
        self._is_stopped = False
        """Whether nothing is commanded until all sticks were at rest."""
        self._has_events = False
        """Whether more came than the states at the time of opening."""

    def feed(self, data: bytes) -> list[int]:
        """Take events, which may be cut anywhere; return the buttons that were pressed."""
        data = self._pending + data
        whole = len(data) - len(data) % EVENT.size
        self._pending = data[whole:]
        pressed: list[int] = []
        for _, value, kind, number in EVENT.iter_unpack(data[:whole]):
            self._has_events |= not kind & STATE
            if not self._has_events:
                self.stop()  # a stick that is held already moves nothing
            if kind & ~STATE == AXIS:
                self._axes[number] = _apply_dead_zone(value / FULL)
            elif kind & ~STATE == BUTTON:
                self._note_button(number, is_down=bool(value))
                if kind == BUTTON and value:
                    pressed.append(number)
        return pressed

    def find_direction(self, *, is_holonomic: bool) -> Direction:
        """Find the direction of the sticks; the left one turns, or moves robots sideways."""
        axes = self._axes
        # Sticks count to the right and down; minus from 0.0, which gives no -0.0.
        ahead = 0.0 - (axes.get(LEFT_Y, 0.0) or axes.get(PAD_Y, 0.0))
        aside = 0.0 - (axes.get(LEFT_X, 0.0) or axes.get(PAD_X, 0.0))
        turn = 0.0 - axes.get(RIGHT_X, 0.0)
        found = (
            Direction(ahead, aside, turn) if is_holonomic else Direction(ahead, turn=turn or aside)
        )
        if not found:
            self._is_stopped = False
        is_enabled = self._enable_button is None or self._enable_button in self._buttons
        return found if is_enabled and not self._is_stopped else STILL

    def stop(self) -> None:
        """Command nothing until all sticks were at rest."""
        self._is_stopped = True

    def _note_button(self, number: int, *, is_down: bool) -> None:
        if is_down:
            self._buttons.add(number)
        else:
            self._buttons.discard(number)
        if is_down and number == STOP_BUTTON:
            self.stop()


def _apply_dead_zone(share: float) -> float:
    """Scale what is beyond the dead zone to -1 to 1; values at rest are 0."""
    size = (abs(share) - DEAD_ZONE) / (1.0 - DEAD_ZONE)
    return 0.0 if size <= 0.0 else min(size, 1.0) * (1.0 if share > 0.0 else -1.0)


def find_gamepad() -> Path | None:
    """Find the first gamepad that this user may read; None if there is none."""
    found = sorted(DEVICES.glob("js*"))
    return next((path for path in found if os.access(path, os.R_OK)), None)


def open_gamepad(path: Path) -> int:
    """Open a device, or a FIFO with its events, without waiting; the caller closes it.

    Raises:
        OSError: It cannot be read.
    """
    return os.open(path, os.O_RDONLY | os.O_NONBLOCK)


def read_gamepad(descriptor: int) -> bytes | None:
    """Read the events that wait; None if the gamepad is gone."""
    try:
        return os.read(descriptor, EVENT.size * 64) or None
    except BlockingIOError:
        return b""
    except OSError:
        return None
