"""Pages of measured sections: each section is replaced when it is measured again."""

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby

import msgspec

COMMAND = re.compile(r"^`\S*python -m \S+ (\w+)`$", re.MULTILINE)
"""The command below the heading of a section, which names it."""
HEADING = re.compile(r"^## ", re.MULTILINE)
MISSED = "**missed**"
ASKED, SEEN = "asked", "seen"
WIDTH = 100


def read_sections(text: str) -> dict[str, str]:
    """Split a page into its measured sections, by name.

    Headings without a command below them, such as that of what was missed, are not sections.
    """
    parts = [f"## {part.rstrip()}\n" for part in HEADING.split(text)[1:]]
    commands = ((COMMAND.search(part), part) for part in parts)
    return {found[1]: part for found, part in commands if found}


def format_page(
    head: str, facts: Sequence[tuple[str, str]], sections: Mapping[str, str], names: Sequence[str]
) -> str:
    """Format a page: head, facts of the machine, what was missed, and sections in this order."""
    ordered = [sections[name] for name in names if name in sections]
    machine = "".join(f"| {what} | {fact} |\n" for what, fact in facts)
    misses = [line for text in ordered for line in list_missed(text)]
    begin = f"{head}\n| machine | |\n|---|---|\n{machine}"
    return "\n".join([begin, f"## Missed\n\n{format_items(misses)}", *ordered])


def read_tables(section: str) -> Iterator[list[list[str]]]:
    """Read the tables of a section: head and rows of cells each."""
    for is_table, lines in groupby(section.splitlines(), lambda line: line.startswith("|")):
        if is_table:
            head, _rule, *rows = (_read_cells(line) for line in lines)
            yield [head, *rows]


def list_missed(section: str) -> Iterator[str]:
    """List the rows of a section's tables that have a figure beyond its limit, one line each."""
    for head, *rows in read_tables(section):
        yield from (_format_miss(head, row) for row in rows if any(MISSED in one for one in row))


class Judged(msgspec.Struct, frozen=True):
    """A figure with a limit, as a page has it."""

    figure: str
    asked: str
    seen: str
    is_missed: bool


def list_judged(section: str) -> Iterator[Judged]:
    """List the figures of a section that have a limit."""
    for head, *rows in read_tables(section):
        named = (dict(zip(head, row, strict=False)) for row in rows)
        for row in named:
            if asked := row.get(ASKED):
                seen = row[SEEN]
                yield Judged(row[head[0]], asked, _read_seen(seen), MISSED in seen)


def format_items(lines: Iterable[str]) -> str:
    """Format a Markdown list, or "Nothing." if it is empty."""
    items = (
        textwrap.fill(line, WIDTH, initial_indent="- ", subsequent_indent="  ") for line in lines
    )
    return "".join(f"{item}\n" for item in items) or "Nothing.\n"


def _format_miss(head: Sequence[str], row: Sequence[str]) -> str:
    named = dict(zip(head, row, strict=False))
    if named.get(ASKED) and SEEN in named:
        return f"{row[0]}: asked {named[ASKED]}, seen {_strip_verdict(named[SEEN])}"
    missed = (f"{name} {_strip_verdict(cell)}" for name, cell in named.items() if MISSED in cell)
    return f"{row[0]}: {', '.join(missed)}"


def _read_cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _read_seen(cell: str) -> str:
    return _strip_verdict(cell).removesuffix(", met")


def _strip_verdict(cell: str) -> str:
    return cell.replace(f" {MISSED}", "").rstrip(",")
