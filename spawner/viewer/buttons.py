"""The buttons that act on the simulation."""

from typing import Final, Literal, get_args

Button = Literal["Play", "Pause", "Step", "Reset"]
BUTTONS: Final[tuple[Button, ...]] = get_args(Button)
