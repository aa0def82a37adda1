"""Pieces of error messages: what was given, cut to a length that a line can hold."""

from collections.abc import Sequence

LONGEST = 80
LONGEST_LINE = 200
MOST_NAMES = 5


def shown(text: str | None) -> str:
    """Quote what was given, at most 80 characters of it."""
    written = text or ""
    return repr(written if len(written) <= LONGEST else written[: LONGEST - 3] + "...")


def listed(names: Sequence[str]) -> str:
    """Quote names, at most five of them."""
    quoted = ", ".join(shown(name) for name in names[:MOST_NAMES])
    left_out = len(names) - MOST_NAMES
    return f"{quoted} and {left_out} more" if left_out > 0 else quoted


def in_line(text: str) -> str:
    """Put what another library says in one line of at most 200 characters."""
    return " ".join(text.split())[:LONGEST_LINE]
