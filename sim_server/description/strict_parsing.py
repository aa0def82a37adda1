"""Strict parsing of untrusted text: XML without DTD, numbers, flags; quotes for messages."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence


MAX_QUOTE_LENGTH = 80
MAX_LINE_LENGTH = 200
MAX_QUOTED_NAMES = 5
FLAG_TEXTS = {"true": True, "1": True, "false": False, "0": False}
_UNEXPANDED = re.compile(r"\$\(\s*(\w*)|\$\{")
_REMEDIES = {
    "arg": "give its value, as --xacro-arg NAME:=VALUE of zensim spawn FILE",
    "env": "set the environment variable where zensim spawn FILE runs",
    "optenv": "spawn the file by zensim spawn FILE, which has the environment",
    "find": "write package://NAME",
}
"""What expands a substitution argument; clients do, the server has no environment of a user."""
_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
MAX_NUMBER_LENGTH = 400
"""Characters; a double written in full has fewer."""


def quote(text: str | None) -> str:
    """Quote a text, cut to 80 characters."""
    written = text or ""
    return repr(
        written if len(written) <= MAX_QUOTE_LENGTH else written[: MAX_QUOTE_LENGTH - 3] + "..."
    )


def quote_names(names: Sequence[str]) -> str:
    """Quote the first five names."""
    quoted = ", ".join(quote(name) for name in names[:MAX_QUOTED_NAMES])
    left_out = len(names) - MAX_QUOTED_NAMES
    return f"{quoted} and {left_out} more" if left_out > 0 else quoted


def to_single_line(text: str) -> str:
    """Join a message of another library to one line of at most 200 characters."""
    return " ".join(text.split())[:MAX_LINE_LENGTH]


def parse_flag(text: str | None) -> bool | None:
    """Parse true, false, 1 or 0 in any case; None for other texts."""
    return FLAG_TEXTS.get((text or "").strip().lower())


def check_expanded(text: str | None, where: str) -> None:
    """Refuse a text with substitution arguments or expressions of xacro, such as `$(arg x)`.

    Raises:
        ModelError: It has one.
    """
    if found := _UNEXPANDED.search(text or ""):
        raise ModelError(
            f"{where}: {quote(text)} is not expanded; "
            f"{_REMEDIES.get(found[1] or '', 'run xacro first')}",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="urdf.xacro",
        )


def read_numbers(
    text: str | None, *, counts: tuple[int, ...], where: str, slug: str
) -> tuple[float, ...]:
    """Read finite decimal numbers separated by spaces.

    Args:
        text: As written.
        counts: Allowed counts.
        where: Start of the error message, such as `link 'base', mass value`.
        slug: Of the error.

    Raises:
        ModelError: Not such numbers, too many or too few.
    """
    check_expanded(text, where)
    words = (text or "").split()
    if len(words) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise ModelError(
            f"{where}: {quote(text)} has {len(words)} numbers; write {wanted}, separated by spaces",
            slug=slug,
        )
    return tuple(_read_decimal(word, where=where, slug=slug) for word in words)


def read_number(text: str | None, *, where: str, slug: str) -> float:
    """Read one number like `read_numbers`."""
    return read_numbers(text, counts=(1,), where=where, slug=slug)[0]


def _read_decimal(word: str, *, where: str, slug: str) -> float:
    if len(word) > MAX_NUMBER_LENGTH or not _DECIMAL.fullmatch(word):
        raise ModelError(
            f"{where}: {quote(word)} is not a number; write one such as 0.5 or 1e-3", slug=slug
        )
    number = float(word)
    if not math.isfinite(number):
        raise ModelError(f"{where}: {quote(word)} is too large; write a finite number", slug=slug)
    return number
