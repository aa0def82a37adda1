"""Results of robot checks as a table, as Markdown, as JSON values and as JUnit XML."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import msgspec

from zensim.deploy.robot_checks import CheckRow, DrivenPart, count_verdicts, find_ratio
from zensim.proto.printable_text import to_markdown, to_xml

if TYPE_CHECKING:
    from collections.abc import Sequence

HEADERS = (
    *("robot", "engine", "drive", "found by", "straight", "drift", "turn", "predicted"),
    *("tilt", "creep", "verdict", "remarks"),
)
MARKDOWN_HEADERS = (
    *("robot", "source", "engine", "drive", "found by", "straight", "drift", "turn", "predicted"),
    *("tilt", "creep", "verdict", "remarks"),
)
TOTAL_HEADERS = (
    *("engine", "robots", "mobile", "driven", "straight within 5 %", "turn within 5 %", "both"),
    "ok or as predicted",
)
KEPT_SHARE = 0.05
"""Share of the command by which a total allows speed or turn to deviate."""
MAX_REMARKS = 200
"""Characters of the remarks in a table."""


def format_cells(row: CheckRow) -> tuple[str, ...]:
    """Format a row; columns as in `HEADERS`."""
    result = row.result
    is_spawned = not result.error and bool(result.model)
    return (
        row.name,
        row.engine,
        result.drive.removesuffix("_drive") if result.drive else "-",
        result.drive_source or "-",
        _format_ratio(result.straight, 0, "m/s"),
        f"{result.straight.measured[2]:+.3f} rad/s" if result.straight else "-",
        _format_ratio(result.turn, 2, "rad/s"),
        _format_predicted(result.straight, result.turn),
        f"{math.degrees(result.tilt_rad):.1f}°" if is_spawned else "-",
        f"{result.creep_m_s * 1e3:.1f} mm/s" if is_spawned else "-",
        row.verdict,
        format_remarks(row),
    )


def _format_ratio(part: DrivenPart | None, axis: int, unit: str) -> str:
    if part is None:
        return "-"
    ratio = find_ratio(part, axis)
    share = "" if ratio is None else f" ({100.0 * ratio:.0f} %)"
    return f"{_plain(part.measured[axis])} of {_plain(part.commanded[axis])} {unit}{share}"


def _plain(number: float) -> str:
    # Adding 0 turns -0 into 0.
    return f"{round(number, 3) + 0.0:.3f}"


def _format_predicted(straight: DrivenPart | None, turn: DrivenPart | None) -> str:
    if straight is None or turn is None or not straight.predicted or not turn.predicted:
        return "-"
    return f"{_plain(straight.predicted[0])} m/s, {_plain(turn.predicted[2])} rad/s"


def format_remarks(row: CheckRow) -> str:
    """Join the reason of the verdict, the remarks of the report and that of the list."""
    parts = (row.reason, row.robot.remark, *row.result.remarks)
    text = " ".join("; ".join(dict.fromkeys(part for part in parts if part)).split())
    return text if len(text) <= MAX_REMARKS else f"{text[: MAX_REMARKS - 1]}…"


def format_table(rows: Sequence[CheckRow]) -> list[str]:
    """Format all rows as lines with aligned columns, and a line with the counts."""
    table = [HEADERS, *(format_cells(row) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip()
        for cells in table
    ]
    return [*lines, summarize(rows)]


def format_totals(rows: Sequence[CheckRow]) -> list[tuple[str, ...]]:
    """Count the robots of each engine that drive, and how well; a row of headers first.

    Mobile robots have a drive or wheels; speed and turn count as commanded within 5 %.
    """
    table: list[tuple[str, ...]] = [TOTAL_HEADERS]
    for engine in dict.fromkeys(row.engine for row in rows):
        own = [row for row in rows if row.engine == engine]
        driven = [row for row in own if row.result.straight and row.result.turn]
        straight = [row for row in driven if _is_kept(row.result.straight, 0)]
        turn = [row for row in driven if _is_kept(row.result.turn, 2)]
        counts = (
            len(own),
            len([row for row in own if row.result.drive or row.verdict == "no drive"]),
            len(driven),
            len(straight),
            len(turn),
            len([row for row in straight if row in turn]),
            len([row for row in driven if row.verdict in ("ok", "predicted")]),
        )
        table.append((engine, *map(str, counts)))
    return table


def _is_kept(part: DrivenPart | None, axis: int) -> bool:
    ratio = find_ratio(part, axis) if part else None
    return ratio is not None and abs(ratio - 1.0) <= KEPT_SHARE


def summarize(rows: Sequence[CheckRow]) -> str:
    """Count the verdicts in one line."""
    counts = ", ".join(f"{count} {verdict}" for verdict, count in count_verdicts(rows).items())
    return f"{len(rows)} checked: {counts}"


def format_markdown(rows: Sequence[CheckRow]) -> str:
    """Format totals, and all rows with their sources, as Markdown tables."""
    table: list[tuple[str, ...]] = [MARKDOWN_HEADERS]
    for row in rows:
        name, *cells = format_cells(row)
        table.append((name, row.robot.source or row.robot.path, *cells))
    lines = [*format_markdown_table(format_totals(rows)), "", *format_markdown_table(table)]
    return "\n".join([*lines, "", summarize(rows), ""])


def format_markdown_table(table: Sequence[tuple[str, ...]]) -> list[str]:
    """Format rows, the first of which is the head, as lines of a Markdown table."""
    head, *rows = table
    lines = [f"| {' | '.join(map(to_markdown, cells))} |" for cells in (head, *rows)]
    return [lines[0], f"|{' --- |' * len(head)}", *lines[1:]]


def to_json(rows: Sequence[CheckRow]) -> dict[str, object]:
    """Convert all rows to JSON values."""
    return {
        "rows": [{**msgspec.to_builtins(row), "is_passed": row.is_passed} for row in rows],
        "verdicts": dict(count_verdicts(rows)),
    }


def to_junit(rows: Sequence[CheckRow]) -> bytes:
    """Convert all rows to JUnit XML: a suite for each engine, a case for each robot.

    A case fails with an `error` if it could not be tried, else with a `failure`.
    """
    root = ElementTree.Element("testsuites", _count_cases(rows))
    for engine in dict.fromkeys(row.engine for row in rows):
        own = [row for row in rows if row.engine == engine]
        suite = ElementTree.SubElement(
            root, "testsuite", {"name": to_xml(f"zensim check {engine}"), **_count_cases(own)}
        )
        for row in own:
            _add_case(suite, row)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _count_cases(rows: Sequence[CheckRow]) -> dict[str, str]:
    kinds = [_choose_tag(row) for row in rows]
    return {
        "tests": str(len(rows)),
        "failures": str(kinds.count("failure")),
        "errors": str(kinds.count("error")),
    }


def _choose_tag(row: CheckRow) -> str:
    if row.is_passed:
        return ""
    return "error" if row.verdict in ("refused", "crashed", "timeout") else "failure"


def _add_case(suite: ElementTree.Element, row: CheckRow) -> None:
    case = ElementTree.SubElement(
        suite, "testcase", {"name": to_xml(row.name), "classname": to_xml(row.robot.path)}
    )
    if tag := _choose_tag(row):
        ElementTree.SubElement(
            case, tag, {"type": row.verdict, "message": to_xml(row.reason or row.verdict)}
        )
    output = ElementTree.SubElement(case, "system-out")
    output.text = to_xml("\n".join(map(": ".join, zip(HEADERS, format_cells(row), strict=True))))
