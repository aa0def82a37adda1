"""POSIX extended regular expressions, searched for in names: a few at each turn."""

from collections.abc import Iterator, Sequence

import re2

from zensim.sim_server.errors import SimError

MAX_CHARACTERS = 1024
MAX_BYTES = 1 << 16
"""Of memory for the automata of one pattern: bounds the time that each character takes."""
MOST_AT_ONCE = 256
INSTRUCTIONS_AT_ONCE = 4096
"""Of the automaton, times the names that it is run on before anybody else gets a turn."""


class PatternRefused(SimError):
    """A regular expression that is none."""

    slug = "filter.pattern"


class Pattern:
    """A regular expression that is looked for in names, anywhere within.

    Its engine knows no backtracking: time is linear in the names, whatever the pattern.

    Raises:
        PatternRefused: It is no POSIX extended regular expression, too long or too large.
    """

    def __init__(self, text: str) -> None:
        if len(text) > MAX_CHARACTERS:
            raise PatternRefused(
                f"{len(text)} characters are too many; use at most {MAX_CHARACTERS}"
            )
        try:
            re2.compile(text, _options())  # by itself, so that its brackets match within it
            self._lines = re2.compile(f"^.*({text}).*$", _options())
        except (re2.error, UnicodeEncodeError) as error:
            raise PatternRefused(
                f"{text[:80]!r} is no POSIX extended regular expression: {_reason(error)}"
            ) from error
        finally:
            re2.purge()

    def search(self, names: Sequence[str]) -> Iterator[list[str]]:
        """Name those that hold a match, from some names at each turn: fewer for large patterns."""
        count = INSTRUCTIONS_AT_ONCE // max(self._lines.programsize, 1)
        count = min(max(count, 1), MOST_AT_ONCE)
        for at in range(0, len(names), count):
            text = "\n".join(names[at : at + count]).encode()
            yield [match.group().decode() for match in self._lines.finditer(text)]


def _options() -> re2.Options:
    options = re2.Options()
    options.posix_syntax = True
    options.one_line = False
    options.never_nl = True
    options.never_capture = True
    options.log_errors = False
    options.max_mem = MAX_BYTES
    return options


def _reason(error: Exception) -> str:
    said = error.args[0] if error.args else ""
    return said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
