"""Command line of programs that measure sections and write a page."""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from benchmarks import machine
from benchmarks.benchmark_report import Section, page
from zensim.proto.process_limits import PARENT_PID_VARIABLE


class Make(Protocol):
    """Makes one section."""

    def __call__(self, name: str, *, is_short: bool) -> Section:
        """Measure, and tell what was found."""


@dataclass(frozen=True, kw_only=True)
class Document:
    """What can be measured, and where all of it is written."""

    program: str
    """As it is run: the module."""
    names: Sequence[str]
    make: Make
    short: str
    """What the short form says."""
    path: Path
    head: str

    def write(self) -> list[Section]:
        """Read the command line and measure what it names; everything at full length: the page."""
        arguments = self._parse_arguments()
        # What it starts ends with it, even when it is killed.
        os.environ[PARENT_PID_VARIABLE] = str(os.getpid())
        load_before, sections = machine.load(), []
        for name in arguments.names or self.names:
            sections.append(self.make(name, is_short=arguments.short))
            sys.stdout.write(sections[-1].text + "\n")
            sys.stdout.flush()
        if not arguments.names and not arguments.short:
            self.path.write_text(page(sections, load_before, self.head), encoding="utf-8")
        return sections

    def _parse_arguments(self) -> argparse.Namespace:
        known = ", ".join(self.names)
        parser = argparse.ArgumentParser(prog=f"python -m {self.program}")
        parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {known}")
        parser.add_argument("--short", action="store_true", help=self.short)
        arguments = parser.parse_args()
        if unknown := set(arguments.names) - set(self.names):
            parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {known}")
        return arguments
