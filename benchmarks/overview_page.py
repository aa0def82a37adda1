"""docs/benchmarks.md, the findings of the results: fleets, plots, peers, and what is missed.

`python -m benchmarks.overview_page` makes the page and its plots from docs/benchmark_results.md;
with `--check` the status is 1 if they differ from what is there.
"""

import sys
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.__main__ import PAGE as RESULTS
from benchmarks.benchmark_report import NAMES
from benchmarks.limits import read_limits
from benchmarks.machine import ROOT
from benchmarks.measured_page import list_judged, read_sections, read_tables

PAGE = ROOT / "docs" / "benchmarks.md"
IMAGES = ROOT / "docs" / "images"
PLOTS: Mapping[str, tuple[str, str]] = {
    "benchmark_cpu": ("a robot and step [CPU us]", "CPU time a robot and step [us]"),
    "benchmark_spawn": ("spawned and claimed [s]", "robots spawned and claimed [s]"),
    "benchmark_memory": ("memory [MB]", "memory of server and pools [MB]"),
}
"""Image, column, and axis."""
INCHES = (4.2, 3.2)
HEAD = """# Benchmarks

How many robots run in real time, and what they take. [Results](benchmark_results.md) has all
figures, how each is measured, and the command that repeats it on your machine. Decisions also name
benchmarks of their time; those that are gone are in the history of the repository.
"""
FLEETS = """## Fleets in real time

{machine}.
`zensim serve`, two pools of agents, and a client that commands every robot once a second. A factor
of 1.00 is real time: the simulation keeps up. To measure it on your machine:
`.venv/bin/python -m benchmarks overview`.
"""
PEERS = """## Beside other simulators

The same robots on the same circles, each simulator with its own best settings and in one process;
the rows with a network count server and agents. `.venv/bin/python -m benchmarks peers` repeats it.
"""
UNMEASURED = "Not measured yet.\n"
LIMITS = """## Limits

{limits} figures have a [limit](limits.md), each with the reason why a user would notice it; all are
for two cores. {missed} of them are missed.
"""
CAUSES = ("figure", "asked", "seen", "cause")


def make_page(results: str) -> str:
    """Make the page from the results."""
    sections = read_sections(results)
    judged = [one for name in NAMES for one in list_judged(sections.get(name, ""))]
    missed = [one for one in judged if one.is_missed]
    cores, cpu = (find_fact(results, what) for what in ("cores", "CPU"))
    parts = [
        HEAD,
        FLEETS.format(machine=f"Measured on {cores} cores, {cpu}"),
        _format_table(find_table(sections, "overview")),
        "".join(f"![{axis}](images/{name}.svg)\n" for name, (_, axis) in PLOTS.items()),
        PEERS,
        _format_table(find_table(sections, "peers")) if "peers" in sections else UNMEASURED,
        LIMITS.format(limits=len(judged), missed=len(missed) or "None"),
    ]
    if missed:
        rows = [[one.figure, one.asked, one.seen, find_cause(one.figure)] for one in missed]
        parts.append(_format_table([list(CAUSES), *rows]))
    return "\n".join(parts)


def find_cause(figure: str) -> str:
    """Find the cause of a missed limit; empty if none is named."""
    limits = [section[figure] for section in read_limits().values() if figure in section]
    return next((one.cause for one in limits if one.cause), "")


def find_fact(results: str, what: str) -> str:
    """Find a fact of the machine."""
    row = next(line for line in results.splitlines() if line.startswith(f"| {what} |"))
    return row.split("|")[2].strip()


def find_table(sections: Mapping[str, str], name: str) -> list[list[str]]:
    """Find the first table of a section: its head, and its rows.

    Raises:
        KeyError: The section was not measured.
    """
    return next(read_tables(sections[name]))


def draw_plots(fleets: Sequence[Sequence[str]], folder: Path) -> None:
    """Draw what grows with the number of robots, a line for each kind of physics."""
    head, *rows = fleets
    for name, (column, axis) in PLOTS.items():
        with mpl.rc_context({"svg.hashsalt": "zensim", "svg.fonttype": "none", "font.size": 9.0}):
            figure = Figure(figsize=INCHES, layout="constrained")
            axes = figure.add_subplot()
            _draw(axes, head, rows, column)
            axes.set(xlabel="robots", ylabel=axis, xscale="log", yscale="log")
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})


def _draw(axes: Axes, head: Sequence[str], rows: Sequence[Sequence[str]], column: str) -> None:
    numbers = [dict(zip(head, row, strict=True)) for row in rows]
    for physics, some in groupby(numbers, lambda row: row["physics"]):
        points = [(float(row["robots"]), _read(row, column)) for row in some]
        axes.plot(*zip(*points, strict=True), marker="o", label=physics)
    axes.grid(visible=True, which="major", alpha=0.3)
    axes.legend(frameon=False)


def _read(row: Mapping[str, str], column: str) -> float:
    if column != "memory [MB]":
        return float(row[column])
    return float(row["server [MB]"]) + float(row["pools [MB]"])


def _format_table(table: Sequence[Sequence[str]]) -> str:
    head, *rows = table
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def write() -> None:
    """Write the page and its plots."""
    results = RESULTS.read_text(encoding="utf-8")
    PAGE.write_text(make_page(results), encoding="utf-8")
    draw_plots(find_table(read_sections(results), "overview"), IMAGES)


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        page = make_page(RESULTS.read_text(encoding="utf-8"))
        raise SystemExit(int(page != PAGE.read_text(encoding="utf-8")))
    write()
