"""Numbers of bytes, as options write them."""

from typing import Final

MEBI: Final = 1 << 20
UNITS: Final = {"": 1, "k": 1000, "m": 1000**2, "g": 1000**3, "ki": 1024, "mi": MEBI, "gi": 1024**3}
MAX_BYTES: Final = 1e18


def parse_size(option: str, text: str) -> int:
    """Read a number of bytes, such as `500MB`, `64MiB` or `1048576`.

    Raises:
        ValueError: It is not one.
    """
    word = text.strip().lower().removesuffix("b")
    digits = word.rstrip("kmgi")
    unit = UNITS.get(word[len(digits) :])
    try:
        number = float(digits)
    except ValueError:
        number = -1.0
    if unit is None or not 0 <= number < MAX_BYTES:
        raise ValueError(f"{option} {text[:40]!r} is not a size; use bytes, or 500MB, or 64MiB")
    return round(number * unit)
