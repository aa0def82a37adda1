"""`python -m tests.chaos [NAME ...] [--short]`: break things, print, and rewrite docs/chaos.md.

The page is written only when everything ran at full length; the status is 1 when a figure was
missed.
"""

import argparse
import os
import sys
from importlib import import_module

from deploy.parent import PARENT
from tests.benchmark import machine
from tests.benchmark.figures import Figure, missed, table
from tests.benchmark.report import Section, page

NAMES = (
    "agents",
    "takeover",
    "router",
    "stopped",
    "names",
    "churn",
    "terminate",
    "lockstep",
    "killed",
    "history",
    "damage",
)
PAGE = machine.ROOT / "docs" / "chaos.md"
HEAD = """# Faults

`make chaos` causes all of these faults anew and rewrites this page; the command under a heading
causes those of that section alone. *n* is the number of samples.
"""


def suffer(name: str, *, is_short: bool) -> Section:
    """Cause one family of faults, and tell what came of it."""
    module = import_module(f"tests.chaos.chaos_{name}")
    rows: list[Figure] = list(module.rows(is_short=is_short))
    title, _, method = str(module.__doc__).partition("\n")
    command = f"`.venv/bin/python -m tests.chaos {name}`"
    return Section(
        f"## {title}\n\n{command}\n\n{method.strip()}\n\n{table(rows)}",
        tuple(missed(row) for row in rows if row.is_missed),
    )


def main() -> None:
    """Read the command line and cause what it names."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--short", action="store_true", help="a few faults each")
    wish = parser.parse_args()
    if unknown := set(wish.names) - set(NAMES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    os.environ[PARENT] = str(os.getpid())
    load_before, sections = machine.load(), []
    for name in wish.names or NAMES:
        sections.append(suffer(name, is_short=wish.short))
        sys.stdout.write(sections[-1].text + "\n")
        sys.stdout.flush()
    if not wish.names and not wish.short:
        PAGE.write_text(page(sections, load_before, head=HEAD), encoding="utf-8")
    if any(section.missed for section in sections):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
