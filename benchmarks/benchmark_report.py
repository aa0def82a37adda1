"""Benchmark sections as a document."""

from importlib import import_module

import msgspec

from benchmarks import machine
from benchmarks.figures import Figure, missed
from benchmarks.limits import judge

NAMES = (
    "overview",
    "peers",
    "start",
    "cli",
    "accuracy",
    "mechanics",
    "wheels",
    "cmd_vel",
    "spawn",
    "reading",
    "recording",
    "neighbours",
    "secured_fleet",
    "secured_floods",
    "journal",
    "fleet",
    "fleet_physics",
    "fleet_10000",
    "everything",
    "world",
    "vda5050",
    "envs",
    "world_loading",
    "sensors",
    "page",
    "ros2",
)
HEAD = """# Results of benchmarks

All figures, section by section; [benchmarks](benchmarks.md) is the page of findings, and
[limits](limits.md) says which figures are judged. The command below a heading measures that
section; with `--write` it also replaces the section here. `make bench` does so with all. *n* is the
number of samples; a tenth of them is below p10, a tenth above p90.
"""


class Section(msgspec.Struct, frozen=True):
    """Result of one benchmark."""

    text: str
    missed: tuple[str, ...]


def measure(name: str, *, is_short: bool) -> Section:
    """Run one benchmark."""
    module = import_module(f"benchmarks.bench_{name}")
    additions_ms = machine.time_additions_ms()
    before, steal = machine.work(), machine.StealWatch()
    rows = list(judge(name, module.rows(is_short=is_short)))
    withheld, others = steal.end(), machine.others_cores(before, machine.work())
    additions_ms += machine.time_additions_ms()
    title, _, method = str(module.__doc__).partition("\n")
    command = f"`.venv/bin/python -m benchmarks {name}`"
    return Section(
        f"## {title}\n\n{command}\n\n{method.strip()}\n\n{module.table(rows)}\n"
        f"Other programs kept {others:.2f} cores busy meanwhile.\n"
        f"The host of this machine withheld {withheld}.\n"
        f"{machine.describe_additions(additions_ms)}\n",
        tuple(missed(row) for row in rows if isinstance(row, Figure) and row.is_missed),
    )
