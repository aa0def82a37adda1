"""Keys that a terminal sends, as events: letters, arrows, changes of focus, and key releases."""

import re
from typing import Final, Literal

import msgspec

UNKNOWN: Final = "unknown"
KeyKind = Literal["press", "repeat", "release"]

SEQUENCE: Final = re.compile(rb"\x1b(?:\[([0-9;:<=>?]*)([@-~])|O([@-~]))")
"""CSI with parameters and final byte, or SS3 with a final byte."""
UNFINISHED: Final = re.compile(rb"\x1b(?:\[[0-9;:<=>?]{0,32}|O)?\Z")
NAME_OF_FINAL: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
NAME_OF_CODE: Final = {27: "escape", 13: "enter", 9: "tab", 127: "backspace"}
FOCUS: Final = {"I": "focus_in", "O": "focus_out"}
KINDS: Final[dict[str, KeyKind]] = {"1": "press", "2": "repeat", "3": "release"}
SHIFT, CTRL = 1, 4
"""Bits of the modifiers that a terminal reports, plus one."""
LOCKS_AND_SHIFT: Final = SHIFT | 64 | 128
MODIFIER_CODES: Final = range(57358, 57455)
"""Codes of shift, ctrl, locks and media keys alone."""
LAST_CONTROL: Final = 0x1F
REPORT_FOCUS, IGNORE_FOCUS = "\x1b[?1004h", "\x1b[?1004l"
"""Requests of xterm: the terminal sends `ESC [ I` and `ESC [ O`."""
REPORT_RELEASES, IGNORE_RELEASES = "\x1b[>11u", "\x1b[<u"
"""Requests of the keyboard protocol of kitty: all keys as `CSI CODE ; MODIFIERS : KIND u`."""


class KeyEvent(msgspec.Struct, frozen=True):
    """A key was pressed, repeats or was released."""

    key: str
    """A character, or `up`, `shift+up`, `ctrl+c`, `escape`, `focus_out`; others are `unknown`."""
    kind: KeyKind = "press"
    has_release: bool = False
    """Whether the terminal reports when this key is released."""
    base: str = ""
    """Name of an `unknown` key without its modifiers; empty where `key` says it."""

    @property
    def code(self) -> str:
        """Name of the key itself: equal whatever modifiers are held with it."""
        name = self.base or self.key.removeprefix("ctrl+").removeprefix("shift+")
        return UNSHIFTED.get(name, name.lower())


class KeyParser:
    """Splits the bytes of a terminal into keys; a sequence may come in parts."""

    def __init__(self) -> None:
        self._pending = b""

    @property
    def has_pending(self) -> bool:
        """Whether an unfinished sequence waits: `flush` makes a key of it."""
        return bool(self._pending)

    def feed(self, data: bytes) -> list[KeyEvent]:
        """Take bytes, and return the keys that are whole."""
        self._pending += data
        events: list[KeyEvent] = []
        while self._pending and not UNFINISHED.match(self._pending):
            event = self._take_key()
            if event is not None:
                events.append(event)
        return events

    def flush(self) -> list[KeyEvent]:
        """Take what waits for an end that did not come: the escape key alone."""
        had_some, self._pending = self._pending, b""
        return [KeyEvent("escape")] if had_some else []

    def _take_key(self) -> KeyEvent | None:
        found = SEQUENCE.match(self._pending)
        if found is not None:
            self._pending = self._pending[found.end() :]
            parameters, final, single = (part or b"" for part in found.groups())
            return _read_sequence(parameters.decode(), (final or single).decode())
        first, self._pending = self._pending[0], self._pending[1:]
        return KeyEvent(_name_byte(first))


def _name_byte(code: int) -> str:
    if code in NAME_OF_CODE:
        return NAME_OF_CODE[code]
    return f"ctrl+{chr(code + 0x60)}" if code <= LAST_CONTROL else chr(code)


def _read_sequence(parameters: str, final: str) -> KeyEvent | None:
    """Read a sequence; None for keys that stand for nothing alone, such as shift."""
    if final in FOCUS and not parameters:
        return KeyEvent(FOCUS[final])
    fields = parameters.split(";")
    modifiers, _, kind_code = (fields[1] if len(fields) > 1 else "").partition(":")
    bits = max(0, int(modifiers) - 1) if modifiers.isdigit() else 0
    kind = KINDS.get(kind_code, "press")
    code = fields[0].partition(":")[0]
    if final == "u" and code.isdigit():
        number = int(code)
        if number in MODIFIER_CODES:
            return None
        name = _name_code(number, bits)
        base = _name_code(number, 0) if name == UNKNOWN else ""
        return KeyEvent(name, kind, has_release=True, base="" if base == UNKNOWN else base)
    if final in NAME_OF_FINAL:
        name = NAME_OF_FINAL[final]
        named = f"shift+{name}" if bits & SHIFT else name
        return KeyEvent(named, kind, has_release=bool(kind_code))
    return KeyEvent(UNKNOWN, kind)


def _name_code(code: int, bits: int) -> str:
    if code in NAME_OF_CODE:
        return NAME_OF_CODE[code]
    if code > 0xFFFF:  # noqa: PLR2004  beyond the characters of keyboards
        return UNKNOWN
    letter = chr(code)
    if bits & CTRL:
        return f"ctrl+{letter}"
    if bits & ~LOCKS_AND_SHIFT:
        return UNKNOWN
    return SHIFTED.get(letter, letter.upper()) if bits & SHIFT else letter


SHIFTED: Final = {",": "<", ".": ">"}
"""Characters that are no letters, on a keyboard of the US."""
UNSHIFTED: Final = {shifted: plain for plain, shifted in SHIFTED.items()}
