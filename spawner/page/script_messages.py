"""Messages that the page's own scripts send, such as velocities by keys and gamepad.

viser reports presses only; a held key, its end and a hidden tab are known to a script alone.
"""

from math import isfinite
from typing import Annotated, Final, Literal

import msgspec

Deflection = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]
HeadOrder = Literal[
    "Play", "Pause", "Step", "Reset time and poses", "Reset poses", "Reset time", "Reset all"
]
"""What the buttons of the head order for all visitors."""
OwnAct = Literal["Show all", "Give up"]
"""What concerns the visitor alone; the latter ends the wait for a click on the floor."""


class ZensimDrive(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """Keys or a gamepad are held; repeated each 50 ms until all are released, then zeros."""

    forward: Deflection
    left: Deflection
    turn: Deflection


class ZensimLeave(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """The tab was hidden or lost the focus."""


class ZensimSelect(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """An entity was chosen in the list, or the address of the page names it; empty = none."""

    entity: Annotated[str, msgspec.Meta(max_length=256)]
    is_added: bool = False
    """Whether the rest of the selection stays."""


class ZensimTheme(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """The visitor has chosen the dark theme, or the light one."""

    is_dark: bool


class ZensimModel(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """The visitor has pressed the picture of a model."""

    model: Annotated[str, msgspec.Meta(max_length=256)]


class ZensimAct(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """A button of the page's own controls was pressed, or Escape while a click is awaited."""

    act: HeadOrder | OwnAct


ScriptMessage = ZensimAct | ZensimDrive | ZensimLeave | ZensimModel | ZensimSelect | ZensimTheme
_MESSAGES: Final = msgspec.msgpack.Decoder(ScriptMessage)


def read_script_message(raw: bytes) -> ScriptMessage | None:
    """Read a message of the script; None if it is another message."""
    try:
        message: ScriptMessage = _MESSAGES.decode(raw)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
        return None
    if isinstance(message, ZensimDrive):
        numbers = (message.forward, message.left, message.turn)
        return message if all(map(isfinite, numbers)) else None
    return message


"""Script that only sends messages to its server; `DriveControl` stops the robot without them."""
