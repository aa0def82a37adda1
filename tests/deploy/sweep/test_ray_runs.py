"""Runs on Ray: the digests of other places, a killed worker, and Ray only where it is asked for."""

import json
import subprocess
import sys
import threading
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from tests.deploy.sweep.sweep_samples import SHORT, write_scenario
from tests.integration.processes import command_line, without_libraries
from tests.integration.scraping import find_free_port
from zensim.deploy.scenario_process import RunRequest
from zensim.deploy.sweep.ray_cluster import PREFIX, SHORT_FOLDER
from zensim.deploy.sweep.ray_runs import StdoutOfThread
from zensim.deploy.sweep.sweep_plan import make_plan
from zensim.deploy.sweep.sweep_runner import run_here
from zensim.proto.exit_codes import ExitCode

TIMEOUT_S = 280.0
NO_RAY_VARIABLES = ("RAY_ADDRESS", "RAY_AUTH_MODE", "RAY_AUTH_TOKEN")
KILLER = """import os
import signal
from pathlib import Path
class Go:
    def __init__(self, sim, robots, v):
        self.v = v
    def step(self, now, state):
        try:
            (Path(__file__).parent / "killed").touch(exist_ok=False)
        except FileExistsError:
            return [[self.v, 0.0]]
        # The worker of Ray, whose process made this copy.
        os.kill(int(Path(f"/proc/{os.getppid()}/stat").read_text().split()[3]), signal.SIGKILL)
        return [[self.v, 0.0]]
"""
"""The first run kills its worker."""
IS_IMPORTED = """
import sys
from typer.testing import CliRunner
from zensim.deploy.cli import build
done = CliRunner().invoke(build("sweep"), ["sweep", *sys.argv[1:]])
print(done.exit_code, "ray" in sys.modules)
"""


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NO_RAY_VARIABLES:
        monkeypatch.delenv(name, raising=False)


def run(words: list[str]) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)


def test_digests_on_ray_are_those_here_also_after_the_death_of_a_worker(tmp_path: Path) -> None:
    (tmp_path / "killing_team.py").write_text(KILLER)
    text = SHORT.replace("do: drive, v: 0.3", "do: python, call: 'killing_team:Go', args: {v: 0.3}")
    file = write_scenario(tmp_path, "{behaviours.go.args.v: [0.1, 0.3]}", text)
    words = ("sweep", file, "--on", "ray", "--jobs", "1", "--output", str(tmp_path / "out"))

    done = run(command_line([*words, "--no-record", "--json"]))

    assert done.returncode == ExitCode.PARTIAL, done.stderr
    found = [json.loads(line)["row"] for line in done.stdout.splitlines()]
    assert (tmp_path / "killed").exists()
    runs = make_plan(file).runs
    here = dict(run_here([RunRequest(file, run.settings) for run in runs]))
    assert {row["id"]: (row["digest"], row["is_passed"]) for row in found} == {
        run.id: (here[number].state_hash, here[number].is_passed) for number, run in enumerate(runs)
    }


def test_sweep_in_processes_does_not_import_ray(tmp_path: Path) -> None:
    words = [write_scenario(tmp_path), "--on", "here", "--output", str(tmp_path / "out")]

    done = run([sys.executable, "-c", IS_IMPORTED, *words])

    assert done.stdout.split() == ["0", "False"], done.stderr


def test_command_names_the_extra_where_ray_is_not_installed(tmp_path: Path) -> None:
    words = ("sweep", write_scenario(tmp_path), "--on", "ray", "--output", str(tmp_path / "out"))

    done = run(command_line(words, without_libraries(tmp_path, "ray")))

    assert done.returncode == ExitCode.FAILED
    assert "pip install 'zensim[ray]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("way", ["option", "variable"])
def test_cluster_that_is_not_there_is_reported_in_one_line(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = f"127.0.0.1:{find_free_port()}"
    words = ["sweep", write_scenario(tmp_path), "--on", "ray", "--output", str(tmp_path / "out")]
    if way == "option":
        words += ["--ray-address", address]
    else:
        monkeypatch.setenv("RAY_ADDRESS", address)

    done = run(command_line(words))

    assert done.returncode == ExitCode.FAILED
    assert len(done.stderr.splitlines()) == 1
    assert address in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.long_form
def test_cluster_that_does_not_start_is_reported_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # `ray start` imports the hook.
    monkeypatch.setenv("RAY_START_HOOK", "no_such_module.hook")
    before = set(SHORT_FOLDER.glob(f"{PREFIX}*"))
    words = ("sweep", write_scenario(tmp_path), "--on", "ray", "--output", str(tmp_path / "out"))

    done = run(command_line([*words, "--json"]))

    *_, last = done.stderr.splitlines()
    failure = json.loads(last)["error"]
    assert (done.returncode, failure["code"]) == (ExitCode.FAILED, "FAILED")
    assert "no_such_module" in failure["message"]
    assert "Traceback" not in done.stderr
    assert set(SHORT_FOLDER.glob(f"{PREFIX}*")) <= before


def test_what_other_threads_print_goes_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    with redirect_stdout(StdoutOfThread()):
        other = threading.Thread(target=print, args=("dead",))
        other.start()
        other.join()
        sys.stdout.write("row\n")

    assert capsys.readouterr() == ("row\n", "dead\n")
