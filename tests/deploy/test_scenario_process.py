"""Runs in processes: what a second run for a recording may do, and whose recording is named."""

import contextlib
import os
import sys
from pathlib import Path

import pytest

import zensim
from tests.deploy.sweep.sweep_samples import SHORT, write_scenario
from zensim.deploy.scenario_process import RunRequest, run_in_process, run_request

TEAM = """import os
from pathlib import Path
HERE = Path(__file__).parent
class Go:
    def __init__(self, sim, robots):
        self.is_second = (HERE / "ran").exists()
        (HERE / "ran").touch()
    def step(self, now, state):
        if self.is_second:
            {second}
        return [[0.1, 0.0]]
"""


def make_request(folder: Path, second: str) -> RunRequest:
    """Make a run that fails its check, and does something else when it runs again."""
    (folder / "twice_team.py").write_text(TEAM.format(second=second))
    text = SHORT.replace("do: drive, v: 0.3", "do: python, call: 'twice_team:Go'")
    recording = str(folder / "failed.mcap")
    return RunRequest(write_scenario(folder, text=text), failure_recording=recording)


def test_failed_run_is_recorded_by_a_second_run(tmp_path: Path) -> None:
    report = run_in_process(make_request(tmp_path, "pass"))

    assert [check.verdict for check in report.checks] == ["failed"]
    assert (report.error, report.recording) == ("", str(tmp_path / "failed.mcap"))
    assert zensim.Recording(report.recording).counts["/r/odom"] > 10


def test_verdict_stays_when_the_second_run_ends_its_process(tmp_path: Path) -> None:
    report = run_in_process(make_request(tmp_path, "os._exit(3)"))

    assert [check.verdict for check in report.checks] == ["failed"]
    assert report.state_hash
    assert (report.error, report.recording) == ("", "")


def test_second_run_that_ends_in_another_state_is_an_error(tmp_path: Path) -> None:
    report = run_in_process(make_request(tmp_path, "return [[0.3, 0.0]]"))

    assert report.error.startswith("not deterministic")
    assert report.recording


@pytest.mark.parametrize("world", ["empty", "no_such_world"])
def test_recording_of_an_earlier_run_is_not_named(world: str, tmp_path: Path) -> None:
    text = f"{SHORT}world: {{load: {world}}}\nrecord: {{to: run.mcap}}\n"
    file = write_scenario(tmp_path, text=text)
    recording = tmp_path / "run.mcap"
    recording.touch()
    long_ago_s = 1e9
    os.utime(recording, (long_ago_s, long_ago_s))

    report = run_request(RunRequest(file))

    assert bool(report.error) == (world == "no_such_world")
    assert report.recording == ("" if report.error else str(recording))


def test_engine_that_is_not_installed_is_an_error_that_names_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    file = write_scenario(tmp_path, text=f"{SHORT}engine: {{use: pybullet}}\n")

    report = run_request(RunRequest(file))

    assert report.error.startswith("Invalid: engine.missing: ")
    assert "pip install 'zensim[pybullet]'" in report.error
    assert contextlib.__file__ not in report.error
