"""Numbers as descriptions write them: decimal, finite, separated by spaces."""

import math
import re

from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
LONGEST = 400
"""Characters of one number: a double written out in full has fewer."""


def read_numbers(
    text: str | None, *, counts: tuple[int, ...], where: str, slug: str
) -> tuple[float, ...]:
    """Read numbers separated by spaces.

    Args:
        text: As written.
        counts: How many there may be.
        where: Begins the error message, such as `link 'base', mass value`.
        slug: Of the error.

    Raises:
        ModelError: Not a decimal number, not finite, too many or too few.
    """
    words = (text or "").split()
    if len(words) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise ModelError(
            f"{where}: {shown(text)} has {len(words)} numbers; write {wanted}, apart by spaces",
            slug=slug,
        )
    return tuple(_number(word, where=where, slug=slug) for word in words)


def read_number(text: str | None, *, where: str, slug: str) -> float:
    """Read one number; as `read_numbers`."""
    return read_numbers(text, counts=(1,), where=where, slug=slug)[0]


def _number(word: str, *, where: str, slug: str) -> float:
    if len(word) > LONGEST or not _DECIMAL.fullmatch(word):
        raise ModelError(
            f"{where}: {shown(word)} is not a number; write one such as 0.5 or 1e-3", slug=slug
        )
    number = float(word)
    if not math.isfinite(number):
        raise ModelError(f"{where}: {shown(word)} is too large; write a finite number", slug=slug)
    return number
