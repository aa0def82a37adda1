"""Command line of programs that measure sections and write a page."""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from benchmarks import machine
from benchmarks.benchmark_report import Section
from benchmarks.measured_page import format_page, read_sections
from zensim.proto.parent_death import PARENT_PID_VARIABLE


class Make(Protocol):
    """Function that makes one section."""

    def __call__(self, name: str, *, is_short: bool) -> Section:
        """Measure, and return the section."""


@dataclass(frozen=True, kw_only=True)
class Document:
    """The sections of a page in their order, and its path."""

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
        """Measure the named sections; write each into the page once it ran at full length."""
        arguments = self._parse_arguments()
        # Child processes end with this one, even if it is killed, and do not compile modules anew.
        os.environ[PARENT_PID_VARIABLE] = str(os.getpid())
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        is_written = not arguments.short and (arguments.write or not arguments.names)
        usual = self.short_names if arguments.short and self.short_names else self.names
        sections = []
        for name in arguments.names or usual:
            origin = machine.describe_run()
            sections.append(self.make(name, is_short=arguments.short))
            sys.stdout.write(sections[-1].text + "\n")
            sys.stdout.flush()
            if is_written:
                self._replace(name, f"{sections[-1].text}\n{origin}\n")
        return sections

    def _replace(self, name: str, text: str) -> None:
        before = self.path.read_text(encoding="utf-8") if self.path.exists() else ""
        sections = {**read_sections(before), name: text}
        page = format_page(self.head, machine.describe_machine(), sections, self.names)
        self.path.write_text(page, encoding="utf-8")

    def _parse_arguments(self) -> argparse.Namespace:
        known = ", ".join(self.names)
        parser = argparse.ArgumentParser(prog=f"python -m {self.program}")
        parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {known}")
        length = parser.add_mutually_exclusive_group()
        length.add_argument("--short", action="store_true", help=self.short)
        length.add_argument(
            "--write", action="store_true", help=f"replace the sections in {self.path.name}"
        )
        arguments = parser.parse_args()
        if unknown := set(arguments.names) - set(self.names):
            parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {known}")
        return arguments
