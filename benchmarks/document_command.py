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
    """Function that makes one section."""

    def __call__(self, name: str, *, is_short: bool) -> Section:
        """Measure, and return the section."""


@dataclass(frozen=True, kw_only=True)
class Document:
    """The sections of a page, and its path."""

    program: str
    """Module to run."""
    names: Sequence[str]
    make: Make
    short: str
    """Help text of the short form."""
    path: Path
    head: str
    short_names: Sequence[str] = ()
    """Sections of the short form when none are named; all if empty."""

    def write(self) -> list[Section]:
        """Measure the named sections; write the page after all ran at full length."""
        arguments = self._parse_arguments()
        # Child processes exit with this one, even if it is killed.
        os.environ[PARENT_PID_VARIABLE] = str(os.getpid())
        load_before, sections = machine.load(), []
        usual = self.short_names if arguments.short and self.short_names else self.names
        for name in arguments.names or usual:
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
