"""Selectors of robots: names, `*`, `?`, number ranges `[1-4]`, and lists of them."""

import re
from collections.abc import Sequence
from functools import cache

_PART = re.compile(r"\[(\d{1,6})-(\d{1,6})\]|\*|\?|[A-Za-z0-9_/]+")


class SelectorInvalid(ValueError):
    """A selector that is no pattern, or that selects nothing."""


def select_robots(selector: str | Sequence[str], names: Sequence[str]) -> list[str]:
    """Select robots, in the order of `names`.

    Args:
        selector: A pattern, or a list of them; each must match.
        names: All robots.

    Raises:
        SelectorInvalid: A pattern is not valid, or matches no robot.
    """
    patterns = [selector] if isinstance(selector, str) else selector
    chosen: set[str] = set()
    for pattern in patterns:
        found = {name for name in names if matches(pattern, name)}
        if not found:
            known = ", ".join(names[:8]) + (", …" if len(names) > 8 else "")  # noqa: PLR2004
            raise SelectorInvalid(
                f"`{pattern}` matches no robot; robots: {known or 'there are none'}"
            )
        chosen |= found
    if not patterns:
        raise SelectorInvalid("selects no robot; an empty list")
    return [name for name in names if name in chosen]


def matches(pattern: str, name: str) -> bool:
    """Whether a pattern matches a name.

    Raises:
        SelectorInvalid: The pattern is not valid.
    """
    match = _compile(pattern).fullmatch(name)
    if match is None:
        return False
    bounds = _list_ranges(pattern)
    return all(
        low <= int(number) <= high
        for (low, high), number in zip(bounds, match.groups(), strict=True)
    )


@cache
def _list_ranges(pattern: str) -> list[tuple[int, int]]:
    found = (match.groups() for match in _PART.finditer(pattern))
    return [(int(low), int(high)) for low, high in found if low is not None]


@cache
def _compile(pattern: str) -> re.Pattern[str]:
    end, parts = 0, []
    for match in _PART.finditer(pattern):
        if match.start() != end:
            break
        end, word = match.end(), match.group()
        low, high = match.groups()
        if low is not None and int(low) > int(high):
            raise SelectorInvalid(f"`{word}` is an empty range; write [{high}-{low}]")
        known = {"*": ".*", "?": "."}
        parts.append(r"(\d{1,6})" if low is not None else known.get(word, re.escape(word)))
    if end != len(pattern) or not pattern:
        raise SelectorInvalid(f"`{pattern}` is no selector; use a name, cart*, cart? or cart[1-4]")
    return re.compile("".join(parts))
