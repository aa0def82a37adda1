"""What a sweep has shown: its runs by the values that varied."""

import json
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from zensim.deploy.check_report import format_markdown_table
from zensim.deploy.sweep.sweep_rows import SweepRow

DIGITS = 4


class MarginSummary(msgspec.Struct, frozen=True):
    """Margins of one check over several runs; null where no run has one."""

    worst: float | None
    mean: float | None


class SweepGroup(msgspec.Struct, frozen=True, kw_only=True):
    """Runs with equal values."""

    inputs: Mapping[str, Any]
    runs: int
    passed: int
    errors: int
    margins: Mapping[str, MarginSummary]
    cpu_s: float
    """Mean CPU time of a run."""


def group_rows(rows: Sequence[SweepRow], paths: Sequence[str]) -> list[SweepGroup]:
    """Group rows by the values of some key paths, sorted by these values."""
    groups: dict[str, list[SweepRow]] = {}
    for row in rows:
        key = json.dumps([row.inputs.get(path) for path in paths], sort_keys=True)
        groups.setdefault(key, []).append(row)
    made = [_make_group(members, paths) for members in groups.values()]
    return sorted(made, key=lambda one: [_make_sort_key(value) for value in one.inputs.values()])


def _make_group(rows: Sequence[SweepRow], paths: Sequence[str]) -> SweepGroup:
    names = dict.fromkeys(name for row in rows for name in row.margins)
    return SweepGroup(
        inputs={path: rows[0].inputs.get(path) for path in paths},
        runs=len(rows),
        passed=sum(row.is_passed for row in rows),
        errors=sum(bool(row.error) for row in rows),
        margins={name: _summarize([row.margins.get(name) for row in rows]) for name in names},
        cpu_s=statistics.fmean(row.cpu_s for row in rows),
    )


def _summarize(margins: Sequence[float | None]) -> MarginSummary:
    known = [one for one in margins if one is not None]
    if not known:
        return MarginSummary(None, None)
    return MarginSummary(min(known), statistics.fmean(known))


def _make_sort_key(value: object) -> tuple[int, float, str]:
    """Order numbers by size, and before texts."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return 0, float(value), ""
    return 1, 0.0, "" if value is None else json.dumps(value)


def format_groups(groups: Sequence[SweepGroup]) -> str:
    """Format groups as a Markdown table: worst and mean margin of each check."""
    paths = list(dict.fromkeys(path for one in groups for path in one.inputs))
    names = list(dict.fromkeys(name for one in groups for name in one.margins))
    head = (*paths, "runs", "passed", "errors", *(f"{name}: worst, mean" for name in names))
    rows = [(*head, "cpu_s")]
    rows += [
        (
            *(_write(one.inputs.get(path)) for path in paths),
            *(str(one.runs), str(one.passed), str(one.errors)),
            *(_write_margin(one.margins.get(name)) for name in names),
            _write(one.cpu_s),
        )
        for one in groups
    ]
    return "\n".join(format_markdown_table(rows))


def _write_margin(margin: MarginSummary | None) -> str:
    if margin is None or margin.worst is None:
        return "-"
    return f"{_write(margin.worst)}, {_write(margin.mean)}"


def _write(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    if isinstance(value, str):
        return value
    return "-" if value is None else json.dumps(value)
