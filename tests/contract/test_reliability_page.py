"""docs/reliability.md has the commands that there are."""

import re

from benchmarks import benchmark_report
from tests.chaos import __main__ as chaos
from tests.contract.repository import ROOT, text_of

PAGE = ROOT / "docs" / "reliability.md"
PROGRAMS = {"tests.chaos": set(chaos.NAMES), "benchmarks": set(benchmark_report.NAMES)}
COMMAND = re.compile(r"`python -m ([a-z.]+)((?: [a-z_]+)*)")


def list_commands() -> set[tuple[str, str]]:
    found = COMMAND.findall(text_of(PAGE))
    return {(program, name) for program, names in found for name in names.split()}


def test_commands_exist() -> None:
    assert not {
        (program, name) for program, name in list_commands() if name not in PROGRAMS[program]
    }


def test_page_names_every_fault() -> None:
    named = {name for program, name in list_commands() if program == "tests.chaos"}

    assert named == set(chaos.NAMES)
