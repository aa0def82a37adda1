"""Text that people read: without control characters, whatever a description or a name contains."""

import logging
import re
import sys
from typing import Final

INVISIBLE: Final = (
    "\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f"
)
"""C1 controls, invisible characters, those that change the direction of text, and surrogates."""
CONTROL: Final = re.compile(f"[\x00-\x1f{INVISIBLE}]")
CONTROL_IN_LINES: Final = re.compile(f"[\x00-\x08\x0b-\x1f{INVISIBLE}]")


def printable(text: str) -> str:
    r"""Write control characters as `\u001b`, also those that end a line."""
    return text if text.isprintable() else CONTROL.sub(_escape, text)


def printable_lines(text: str) -> str:
    r"""Write control characters as `\u001b`, but not those between lines and columns.

    JSON remains the same JSON.
    """
    return text if text.isprintable() else CONTROL_IN_LINES.sub(_escape, text)


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


def _escape(found: "re.Match[str]") -> str:
    units = found[0].encode("utf-16-be", "surrogatepass")
    pairs = (units[index : index + 2] for index in range(0, len(units), 2))
    return "".join(f"\\u{pair.hex()}" for pair in pairs)
