"""`python -m tests.chaos [NAME ...] [--short | --write]`: break things, and print.

Sections go to docs/chaos.md with `--write`, and if none is named; the status is 1 when a figure was
missed.
"""

import sys
from importlib import import_module

from benchmarks.benchmark_report import Section
from benchmarks.document_command import Document
from benchmarks.figures import Figure, missed_among, table, written
from benchmarks.machine import ROOT, describe_additions, time_additions_ms

NAMES = (
    "agents",
    "hung",
    "takeover",
    "router",
    "stopped",
    "names",
    "churn",
    "soak",
    "terminate",
    "lockstep",
    "killed",
    "restart",
    "sensors",
    "page",
    "scripts",
    "sessions",
    "history",
    "damage",
    "recording",
    "sweep",
)
HEAD = """# Faults

`make chaos` injects all of these faults and rewrites this page; the command below a heading injects
those of that section alone, and replaces the section with `--write`. *n* is the number of samples.
[Reliability](reliability.md) has further figures.
"""


def run_faults(name: str, *, is_short: bool) -> Section:
    """Inject one family of faults, and return its section.

    The short form ignores limits that depend on the load of the machine.
    """
    module = import_module(f"tests.chaos.chaos_{name}")
    additions_ms = time_additions_ms()
    rows: list[Figure] = []
    for row in module.rows(is_short=is_short):
        rows.append(row)
        sys.stderr.write(f"{row}: {written(row.value('median'))}\n")  # some run for hours
    speed = describe_additions(additions_ms + time_additions_ms())
    title, _, method = str(module.__doc__).partition("\n")
    command = f"`.venv/bin/python -m tests.chaos {name}`"
    return Section(
        f"## {title}\n\n{command}\n\n{method.strip()}\n\n{table(rows)}\n{speed}\n",
        missed_among(rows, is_short=is_short),
    )


DOCUMENT = Document(
    program="tests.chaos",
    names=NAMES,
    make=run_faults,
    short="a few faults each",
    path=ROOT / "docs" / "chaos.md",
    head=HEAD,
)

if __name__ == "__main__" and any(section.missed for section in DOCUMENT.write()):
    raise SystemExit(1)
