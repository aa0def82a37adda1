"""Text that people read: without control characters, whatever a description or a name contains."""

import logging
import sys
from typing import Final

LAYOUT: Final = "\n\t"


def printable(text: str) -> str:
    r"""Write control characters, and others that are not visible, as `\u001b`; also line ends."""
    return text if text.isprintable() else "".join(map(_escape, text))


def printable_lines(text: str) -> str:
    r"""Write control characters as `\u001b`, but not those between lines and columns.

    JSON remains the same JSON.
    """
    if text.isprintable():
        return text
    return "".join(one if one in LAYOUT else _escape(one) for one in text)


def print_lines(text: object = "", *, err: bool = False, nl: bool = True) -> None:
    """Print lines to standard output, or to standard error; every command prints through this."""
    stream = sys.stderr if err else sys.stdout
    stream.write(printable_lines(str(text)) + ("\n" if nl else ""))
    stream.flush()


class PrintableFormatter(logging.Formatter):
    """Formats each log message as one line without control characters."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  as in logging
        """Format the line before a traceback."""
        record.message = printable(record.message)
        return super().formatMessage(record)

    def format(self, record: logging.LogRecord) -> str:
        """Format a record and its traceback."""
        return printable_lines(super().format(record))


def _escape(letter: str) -> str:
    if letter.isprintable():
        return letter
    units = letter.encode("utf-16-be", "surrogatepass")
    pairs = (units[index : index + 2] for index in range(0, len(units), 2))
    return "".join(f"\\u{pair.hex()}" for pair in pairs)
