"""Text that people read: without control characters, whatever a description or a name contains.

One function for each medium: terminals and logs, XML, HTML, Markdown, and names of files.
"""

import logging
import re
import sys
from html import escape
from typing import Final

LAYOUT: Final = "\n\t"
MAX_FILE_NAME: Final = 120
"""Characters of the name of a file that is made from another name."""
_NOT_IN_FILE_NAMES: Final = re.compile(r'[/\\:*?"<>|]|^[.-]')
_MARKDOWN: Final = re.compile(r"([\\`*\[\]|~])")


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


def to_xml(text: str) -> str:
    """Write the characters that XML does not allow as `printable_lines` does.

    A writer of XML replaces the others that have a meaning there.
    """
    return printable_lines(text)


def to_html(text: str) -> str:
    """Write a text as one line of HTML, also of an attribute in quotes, that shows it as it is."""
    return escape(printable(text))


def to_markdown(text: str) -> str:
    """Write a text as a cell of a table in Markdown, where HTML is no HTML."""
    return _MARKDOWN.sub(r"\\\1", escape(printable(text), quote=False))


def to_file_name(text: str) -> str:
    """Write a name as that of a file, in any file system; different names may become the same."""
    return _NOT_IN_FILE_NAMES.sub("_", printable(text))[:MAX_FILE_NAME] or "_"


def print_lines(text: object = "", *, err: bool = False, nl: bool = True) -> None:
    """Print lines to standard output, or to standard error; every command prints through this."""
    stream = sys.stderr if err else sys.stdout
    try:
        stream.write(printable_lines(str(text)) + ("\n" if nl else ""))
        stream.flush()
    except BrokenPipeError:
        # With a number, click would end with status 1; see `exit_on_closed_pipe`.
        raise BrokenPipeError from None


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
