"""What is left of a sweep is run, and every row is kept at once."""

import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import pytest

from tests.deploy.sweep.sweep_samples import SHORT, make_report, make_run, write_scenario
from zensim.deploy.scenario_process import RunRequest
from zensim.deploy.sweep.sweep_folder import SweepFolder
from zensim.deploy.sweep.sweep_plan import make_plan
from zensim.deploy.sweep.sweep_runner import (
    EndedRuns,
    ScenarioChanged,
    run_here,
    run_sweep,
    run_within_time,
)

RUNS = [make_run("a"), make_run("b")]
REQUESTS = [RunRequest("short.scenario.yaml")] * 2


@pytest.fixture
def folder(tmp_path: Path) -> SweepFolder:
    opened = SweepFolder(tmp_path / "short.sweep")
    opened.open(make_plan(write_scenario(tmp_path)))
    return opened


def test_row_is_kept_before_the_next_run_ends(folder: SweepFolder) -> None:
    kept: list[list[str]] = []

    def run_backwards(requests: Sequence[RunRequest]) -> EndedRuns:
        for number in reversed(range(len(requests))):
            kept.append([row.id for row in folder.read_rows(["a", "b"])])
            yield number, make_report()

    rows: list[str] = []
    run_sweep(RUNS, REQUESTS, folder, run_backwards, lambda row: rows.append(row.id))

    assert kept == [[], ["b"]]
    assert rows == ["b", "a"]


def test_runner_is_closed_when_a_row_cannot_be_used(folder: SweepFolder) -> None:
    closed = []

    def run(_: Sequence[RunRequest]) -> EndedRuns:
        try:
            yield 0, make_report(sha256="changed")
        finally:
            closed.append(True)

    with pytest.raises(ScenarioChanged):
        run_sweep(RUNS, REQUESTS, folder, run, lambda _: None)

    assert closed == [True]
    assert folder.read_rows(["a", "b"]) == []


def test_runs_here_are_those_of_the_plan(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{behaviours.go.v: [0.1, 0.3]}")
    runs = make_plan(file).runs

    reports = dict(run_here([RunRequest(file, run.settings) for run in runs]))

    assert [reports[number].sha256 for number in (0, 1)] == [run.sha256 for run in runs]
    assert [reports[number].is_passed for number in (0, 1)] == [False, True]
    assert all(one.cpu_s > 0.0 and one.host.name for one in reports.values())


def test_run_in_this_process_ends_at_its_time(tmp_path: Path) -> None:
    (tmp_path / "sleepy_team.py").write_text(
        "import threading\nclass Control:\n    def __init__(self, sim, robots):\n        pass\n"
        "    def step(self, now, state):\n        threading.Event().wait()\n"
    )
    text = SHORT.replace("do: drive, v: 0.3", "do: python, call: 'sleepy_team:Control'")
    request = RunRequest(write_scenario(tmp_path, text=text), timeout_s=3.0)
    began_s = time.monotonic()

    report = run_within_time(request)

    assert report.error.startswith("timeout")
    assert report.sha256 == make_plan(request.file).runs[0].sha256
    assert time.monotonic() - began_s >= 3.0
    again = run_within_time(msgspec.structs.replace(request, settings=("behaviours=[]",)))
    assert not again.error
