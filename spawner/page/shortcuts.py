"""Keys of the page, for its help and its command palette."""

from typing import Final, Literal, NamedTuple

CommandKey = Literal["P", "N", "R", "X", "T", "G", "D", "Z"]


class Shortcut(NamedTuple):
    """Keys, and what they do."""

    keys: str
    what: str


DRIVE_SHORTCUTS: Final = (
    Shortcut("W S or arrows", "drive the selected robot forward, backward"),
    Shortcut("A D or arrows", "turn it left, right"),
    Shortcut("Q E", "move it left, right, if it can"),
    Shortcut("Space", "stop it"),
    Shortcut("Gamepad", "left stick: forward and sideways; right stick: turn"),
)
"""Held keys, handled by the page's own script while a robot is selected."""


class PageCommand(NamedTuple):
    """An entry of the command palette."""

    label: str
    key: CommandKey
    modifier: Literal["shift"] | None = None

    @property
    def keys(self) -> str:
        """Return the key as help texts show it."""
        return f"Shift+{self.key}" if self.modifier else self.key


PLAY_OR_PAUSE: Final = PageCommand("Play or pause", "P")
STEP_ONCE: Final = PageCommand("Step once", "N")
RESET: Final = PageCommand("Reset time and poses", "R", "shift")
STOP_ALL: Final = PageCommand("Stop all robots", "X")
TAKE_OVER: Final = PageCommand("Take over the selected robot", "T")
DRIVE_TO: Final = PageCommand("Drive to a click on the floor", "G")
DELETE: Final = PageCommand("Delete what is selected", "D", "shift")
UNDO: Final = PageCommand("Undo the deletion", "Z", "shift")
COMMANDS: Final = (PLAY_OR_PAUSE, STEP_ONCE, RESET, STOP_ALL, TAKE_OVER, DRIVE_TO, DELETE, UNDO)
SHORTCUTS: Final = (
    *DRIVE_SHORTCUTS,
    *(Shortcut(one.keys, one.label) for one in COMMANDS),
    Shortcut("Ctrl+K", "command palette"),
)
