"""Names that resemble a mistyped one, for messages."""

from collections.abc import Iterable
from itertools import islice
from typing import Final

MOST_COMPARED: Final = 1000
"""Comparing takes 10 us a name."""
CUTOFF: Final = 0.5
MOST_NAMED: Final = 5


def list_near(name: str, known: Iterable[str], *, most: int = MOST_NAMED) -> list[str]:
    """List the names that resemble a name, the nearest first."""
    from difflib import get_close_matches  # noqa: PLC0415 - for a mistake only

    return get_close_matches(name, list(islice(known, MOST_COMPARED)), most, CUTOFF)


def name_choices(name: str, known: Iterable[str], *, most: int = MOST_NAMED) -> str:
    """Name what there is instead of a name, as 'r1, r2 and 8 more': those like it first.

    Returns:
        Names, and how many are left out; empty if there is none.
    """
    names = list(dict.fromkeys(known))
    near = list_near(name, names, most=most)
    shown = [*near, *(one for one in names if one not in near)][:most]
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(shown)}{more}"
