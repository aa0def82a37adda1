"""What keys stand for: directions of motion, changes of speed, stop and end."""

from typing import Final

import msgspec


class Direction(msgspec.Struct, frozen=True):
    """Where to move, as shares of the speeds: -1 to 1."""

    ahead: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    """Positive to the left."""

    def __bool__(self) -> bool:
        """Whether it is a motion."""
        return bool(self.ahead or self.left or self.turn)


STILL: Final = Direction()
AHEAD, BACK = Direction(ahead=1.0), Direction(ahead=-1.0)
LEFT, RIGHT = Direction(left=1.0), Direction(left=-1.0)
TURN_LEFT, TURN_RIGHT = Direction(turn=1.0), Direction(turn=-1.0)

MOTION_OF_KEY: Final[dict[str, Direction]] = {
    **dict.fromkeys(("w", "up", "i", "W", "shift+up", "I"), AHEAD),
    **dict.fromkeys(("s", "down", ",", "S", "shift+down", "<"), BACK),
    **dict.fromkeys(("a", "left", "j"), TURN_LEFT),
    **dict.fromkeys(("d", "right", "l"), TURN_RIGHT),
    **dict.fromkeys(("A", "shift+left", "J"), LEFT),
    **dict.fromkeys(("D", "shift+right", "L"), RIGHT),
    "u": Direction(ahead=1.0, turn=1.0),
    "o": Direction(ahead=1.0, turn=-1.0),
    "m": Direction(ahead=-1.0, turn=-1.0),
    ".": Direction(ahead=-1.0, turn=1.0),
    "U": Direction(ahead=1.0, left=1.0),
    "O": Direction(ahead=1.0, left=-1.0),
    "M": Direction(ahead=-1.0, left=1.0),
    ">": Direction(ahead=-1.0, left=-1.0),
}
"""The keys around `k` are those of teleop_twist_keyboard, with its signs."""
FASTER, SLOWER = 1.1, 0.9
SPEED_OF_KEY: Final[dict[str, tuple[float, float]]] = {
    "q": (FASTER, FASTER),
    "z": (SLOWER, SLOWER),
    "r": (FASTER, 1.0),
    "x": (SLOWER, 1.0),
    "e": (1.0, FASTER),
    "c": (1.0, SLOWER),
}
"""Factors of the speeds ahead and of turning; `r` is `w` of teleop_twist_keyboard."""
END_KEYS: Final = frozenset({"ctrl+c", "ctrl+d", "ctrl+\\"})
SUSPEND_KEY: Final = "ctrl+z"
HELP: Final = (
    "w s ahead, back     a d turn      A D sideways (shift; holonomic robots)",
    "arrows the same, as u i o j k l m , . of teleop_twist_keyboard",
    "q z all speeds +10 % -10 %   r x of driving   e c of turning",
    "space or any other key: stop      Ctrl-C: stop and end",
)
