"""What is left of a sweep is run, and every row is kept at once."""

import signal
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.deploy.sweep.sweep_samples import SHORT, make_report, make_run, write_scenario
from zensim.deploy.scenario_process import RunRequest, run_request
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


def test_file_that_a_run_cannot_read_is_named_with_its_error(folder: SweepFolder) -> None:
    def run(_: Sequence[RunRequest]) -> EndedRuns:
        yield 0, make_report(sha256="", error="EMFILE")

    with pytest.raises(ScenarioChanged, match="EMFILE"):
        run_sweep(RUNS, REQUESTS, folder, run, lambda _: None)


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
    usual = RunRequest(request.file, ("behaviours=[]",))
    run_within_time(usual)  # imports what an alarm must not interrupt
    began_s = time.monotonic()

    report = run_within_time(request)

    assert report.error.startswith("timeout")
    assert report.sha256 == make_plan(request.file).runs[0].sha256
    assert time.monotonic() - began_s >= 3.0
    assert not run_within_time(usual).error


def test_command_that_repeats_a_run_allows_no_more_than_the_run() -> None:
    request = RunRequest("a.scenario.yaml", ("time.seed=3",), allows_python=False)

    assert request.repeat == "zensim test a.scenario.yaml --set time.seed=3 --no-python"
    assert RunRequest("a.scenario.yaml").repeat == "zensim test a.scenario.yaml"


def test_command_that_repeats_a_run_has_the_timeout_of_the_command_line() -> None:
    request = RunRequest("a.scenario.yaml", timeout_s=2.5, has_own_timeout=True)

    assert request.repeat == "zensim test a.scenario.yaml --timeout 2.5"


def test_alarm_of_the_caller_is_kept(tmp_path: Path) -> None:
    request = RunRequest(write_scenario(tmp_path))
    before_s, _ = signal.setitimer(signal.ITIMER_REAL, 1000.0)

    run_within_time(request)

    left_s, _ = signal.setitimer(signal.ITIMER_REAL, before_s)
    assert 0.0 < left_s < 1000.0


@pytest.mark.parametrize("timeout_s", [1e-6, 600.0], ids=["no time left", "time left"])
def test_failed_run_is_recorded_only_where_time_is_left(timeout_s: float, tmp_path: Path) -> None:
    recording = tmp_path / "failed.mcap"
    file = write_scenario(tmp_path)
    request = RunRequest(
        file, ("behaviours.go.v=0.1",), timeout_s=timeout_s, failure_recording=str(recording)
    )

    report = run_request(request)

    assert [check.verdict for check in report.checks] == ["failed"]
    assert recording.exists() == bool(report.recording) == (timeout_s == 600.0)
