"""`python -m tests.benchmark [NAME ...] [--short]`: measure, print, and rewrite docs/benchmarks.md.

The page is written only when everything was measured at full length.
"""

import argparse
import os
import sys

from deploy.parent import PARENT
from tests.benchmark import machine
from tests.benchmark.report import NAMES, measure, page

PAGE = machine.ROOT / "docs" / "benchmarks.md"


def main() -> None:
    """Read the command line and measure what it names."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmark")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--short", action="store_true", help="a few seconds each; says little")
    wish = parser.parse_args()
    if unknown := set(wish.names) - set(NAMES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    # What it starts ends with it, even when it is killed.
    os.environ[PARENT] = str(os.getpid())
    load_before, sections = machine.load(), []
    for name in wish.names or NAMES:
        sections.append(measure(name, is_short=wish.short))
        sys.stdout.write(sections[-1].text + "\n")
        sys.stdout.flush()
    if not wish.names and not wish.short:
        PAGE.write_text(page(sections, load_before), encoding="utf-8")


if __name__ == "__main__":
    main()
