"""Runs in processes: what a second run for a recording may do, and whose recording is named."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

import zensim
from tests.deploy.sweep.sweep_samples import SHORT, write_scenario
from tests.integration.processes import eventually
from tests.scenario.scenario_runs import run_alone
from zensim.deploy.scenario_process import (
    RUN_COMMAND,
    RunRequest,
    ScenarioWorker,
    make_launch_config,
    run_request,
)
from zensim.scenario.scenario_reader import read_scenario

WITHIN_S = 60.0

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
    report = run_alone(make_request(tmp_path, "pass"))

    assert [check.verdict for check in report.checks] == ["failed"]
    assert (report.error, report.recording) == ("", str(tmp_path / "failed.mcap"))
    assert zensim.Recording(report.recording).counts["/r/odom"] > 10


def test_verdict_stays_when_the_second_run_ends_its_process(tmp_path: Path) -> None:
    report = run_alone(make_request(tmp_path, "os._exit(3)"))

    assert [check.verdict for check in report.checks] == ["failed"]
    assert report.state_hash
    assert (report.error, report.recording) == ("", "")


def test_second_run_that_ends_in_another_state_is_an_error(tmp_path: Path) -> None:
    report = run_alone(make_request(tmp_path, "return [[0.3, 0.0]]"))

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
    assert "pip install 'zensim[server]'" in report.error
    assert contextlib.__file__ not in report.error


STATE_TEAM = """import os
from pathlib import Path
class Go:
    def __init__(self, sim, robots):
        with (Path(__file__).parent / "processes").open("a") as file:
            file.write(f"{os.getpid()}\\n")
    def step(self, now, state):
        return [[0.3, 0.0]]
"""


def list_copies() -> list[psutil.Process]:
    """List the copies that the processes of this process have made."""
    family = psutil.Process().children(recursive=True)
    workers = {one.pid for one in family if RUN_COMMAND[-1] in one.cmdline()}
    return [one for one in family if one.ppid() in workers]


@pytest.fixture
def worker() -> Iterator[ScenarioWorker]:
    made = ScenarioWorker()
    yield made
    made.close()


def test_runs_without_code_share_a_copy_that_is_replaced_when_it_is_killed(
    tmp_path: Path, worker: ScenarioWorker
) -> None:
    request = RunRequest(write_scenario(tmp_path))
    first = worker.run(request)
    (copy,) = list_copies()
    second = worker.run(request)

    assert list_copies() == [copy]
    assert first.is_passed
    assert second.state_hash == first.state_hash

    copy.kill()
    eventually(lambda: copy.status() == psutil.STATUS_ZOMBIE, WITHIN_S, "its end")
    third = worker.run(request)

    assert (third.error, third.state_hash) == ("", first.state_hash)
    assert list_copies() != [copy]


def test_each_run_with_code_has_a_copy_of_its_own(tmp_path: Path, worker: ScenarioWorker) -> None:
    (tmp_path / "state_team.py").write_text(STATE_TEAM)
    text = SHORT.replace("do: drive, v: 0.3", "do: python, call: 'state_team:Go'")
    request = RunRequest(write_scenario(tmp_path, text=text))

    reports = [worker.run(request) for _ in range(2)]

    assert [report.error for report in reports] == ["", ""]
    assert len(set((tmp_path / "processes").read_text().split())) == 2
    assert list_copies() == []


PARENT_TEAM = """import subprocess, sys, time
from pathlib import Path
class Go:
    def __init__(self, sim, robots):
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        (Path(__file__).parent / "child").write_text(str(child.pid))
    def step(self, now, state):
        time.sleep(600)
"""


def test_child_of_the_authors_code_ends_with_a_run_that_is_late(
    tmp_path: Path, worker: ScenarioWorker
) -> None:
    (tmp_path / "parent_team.py").write_text(PARENT_TEAM)
    text = SHORT.replace("do: drive, v: 0.3", "do: python, call: 'parent_team:Go'")

    report = worker.run(RunRequest(write_scenario(tmp_path, text=text), timeout_s=4.0))

    child = int((tmp_path / "child").read_text())
    assert report.error.startswith("timeout")
    eventually(lambda: not psutil.pid_exists(child) or is_zombie(child), WITHIN_S, "its end")


def is_zombie(process_id: int) -> bool:
    return psutil.Process(process_id).status() == psutil.STATUS_ZOMBIE


@pytest.mark.parametrize(("given", "on_miss"), [((), "wait"), (("time.on_miss=hold",), "hold")])
def test_server_of_a_run_waits_for_slow_agents(
    tmp_path: Path, given: tuple[str, ...], on_miss: str
) -> None:
    scenario = read_scenario(write_scenario(tmp_path), given)

    assert make_launch_config(scenario).server.lockstep.on_miss == on_miss
