"""Tables and lines of the console have no control characters."""

import io
import os
from contextlib import suppress

import pytest
from rich.table import Table

from zensim.deploy.cli.command_session import PrintableConsole


def test_console_escapes_cells_and_lines() -> None:
    stream = io.StringIO()
    console = PrintableConsole(file=stream, width=200, markup=False)
    table = Table("name\x1b[2J", box=None)
    table.add_row("r1\x1b]0;title\x07\u202e")

    console.print(table)
    console.print("line \x9b\x1b[31m", highlight=False)

    assert all(line.isprintable() for line in stream.getvalue().splitlines())


def test_reader_that_has_read_enough_is_no_failure() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", encoding="utf-8") as closed:
        console = PrintableConsole(file=closed)

        with pytest.raises(BrokenPipeError):
            console.print("line\n" * 100)
        with suppress(BrokenPipeError):
            closed.close()
