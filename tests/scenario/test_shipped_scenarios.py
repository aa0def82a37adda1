"""The shipped scenarios pass."""

from pathlib import Path

import msgspec
import pytest

from tests.scenario.scenario_runs import run_alone
from zensim.deploy.scenario_process import RunRequest
from zensim.scenario.scenario_reader import (
    find_scenario_file,
    list_shipped_scenarios,
    read_scenario,
)

MOST_LINES = 25
ENDS = {"warehouse": ("end.at=4.5 s",)}
"""Settings of scenarios that are long; the others run to their ends."""


@pytest.mark.short_form
@pytest.mark.parametrize("name", list_shipped_scenarios())
def test_shipped_scenario_passes(name: str) -> None:
    report = run_alone(RunRequest(find_scenario_file(name), ENDS.get(name, ())))

    assert report.error == ""
    assert [msgspec.to_builtins(one) for one in report.checks if one.verdict != "passed"] == []


@pytest.mark.parametrize("name", list_shipped_scenarios())
def test_shipped_scenario_is_short_and_without_mistakes(name: str) -> None:
    file = find_scenario_file(name)

    assert read_scenario(file).name == name
    assert len(Path(file).read_text(encoding="utf-8").splitlines()) <= MOST_LINES
