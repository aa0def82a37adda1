"""Rows of a sweep: what went into a run, and what came out."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from zensim.deploy.sweep.sweep_plan import SweepRun
from zensim.scenario.run_host import RunHost
from zensim.scenario.scenario_runner import RunReport

INPUT, MARGIN = "in.", "margin."
"""Beginnings of the names of columns."""
WHOLE_LIMIT = 2**63
"""Limit above all whole numbers of a column; larger ones are text."""


class SweepRow(msgspec.Struct, frozen=True, kw_only=True):
    """One run that has ended."""

    id: str
    seed: int
    number: int
    repeat: int
    inputs: dict[str, Any]
    is_passed: bool
    failed: tuple[str, ...] = ()
    """Names of the checks that failed."""
    error: str = ""
    """Why it did not run to its end; empty if it did."""
    digest: str = ""
    """Hash of the last state."""
    margins: dict[str, float | None] = {}
    """Worst margin of each check; null if it was never looked at, or never true."""
    robots: int = 0
    sim_time: float = 0.0
    wall_time_s: float = 0.0
    cpu_s: float = 0.0
    command: str = ""
    """Repeats the run."""
    recording: str = ""
    """Path in the folder of the sweep."""
    host: RunHost = RunHost()


def make_row(run: SweepRun, report: RunReport, recording: str = "") -> SweepRow:
    """Make the row of a run."""
    return SweepRow(
        id=run.id,
        seed=run.seed,
        number=run.number,
        repeat=run.repeat,
        inputs=dict(run.inputs),
        is_passed=report.is_passed,
        failed=tuple(check.name for check in report.checks if check.is_failure),
        # Bytes of paths that are no text cannot be written.
        error=report.error.encode(errors="replace").decode(),
        digest=report.state_hash,
        margins={
            check.name: check.margin if math.isfinite(check.margin) else None
            for check in report.checks
        },
        robots=report.robots,
        sim_time=report.sim_time,
        wall_time_s=report.wall_time_s,
        cpu_s=report.cpu_s,
        command=report.repeat,
        recording=recording,
        host=report.host,
    )


def find_unequal_repeats(rows: Iterable[SweepRow]) -> list[tuple[str, ...]]:
    """Find runs of equal content and seed that ended in unequal states, by their ids."""
    groups: dict[str, list[SweepRow]] = {}
    for row in rows:
        key = json.dumps([row.inputs, row.number, row.seed], sort_keys=True)
        if not row.error:
            groups.setdefault(key, []).append(row)
    return [
        tuple(row.id for row in group)
        for group in groups.values()
        if len({row.digest for row in group}) > 1
    ]


def make_columns(rows: Sequence[SweepRow]) -> dict[str, list[Any]]:
    """Make the columns of a table, with a value or None for each row."""
    columns: dict[str, list[Any]] = {
        "id": [row.id for row in rows],
        "seed": [row.seed for row in rows],
        "number": [row.number for row in rows],
        "repeat": [row.repeat for row in rows],
    }
    for path in _list_keys(row.inputs for row in rows):
        columns[INPUT + path] = _align([row.inputs.get(path) for row in rows])
    columns |= {
        "passed": [row.is_passed for row in rows],
        "failed": [", ".join(row.failed) for row in rows],
        "error": [row.error for row in rows],
        "digest": [row.digest for row in rows],
    }
    for name in _list_keys(row.margins for row in rows):
        columns[MARGIN + name] = [row.margins.get(name) for row in rows]
    for name in ("robots", "sim_time", "wall_time_s", "cpu_s", "command", "recording"):
        columns[name] = [getattr(row, name) for row in rows]
    for name in ("name", "system", "cpu"):
        columns[f"host.{name}"] = [getattr(row.host, name) for row in rows]
    for name in _list_keys(row.host.versions for row in rows):
        columns[f"version.{name}"] = [row.host.versions.get(name) for row in rows]
    return columns


def _list_keys(maps: Iterable[Mapping[str, Any]]) -> list[str]:
    """List all keys, in the order of their first appearance."""
    return list(dict.fromkeys(key for one in maps for key in one))


def _align(values: Sequence[Any]) -> list[Any]:
    """Give the values of a column one type: numbers, truth values, or text."""
    kinds = {type(one) for one in values if one is not None}
    fits = all(abs(one) < WHOLE_LIMIT for one in values if isinstance(one, int))
    if kinds <= {int, float} and fits:
        whole = kinds == {int}
        return [one if one is None or whole else float(one) for one in values]
    if kinds in ({str}, {bool}):
        return list(values)
    return [one if one is None or isinstance(one, str) else json.dumps(one) for one in values]
