"""`zensim sweep`: runs, resume after a kill, shares, results and exit status."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

import zensim
from tests.deploy.sweep.sweep_samples import SHORT, write_scenario
from tests.integration.processes import command_line, eventually, running
from zensim.deploy.cli import build
from zensim.deploy.scenario_process import RUN_COMMAND
from zensim.proto.exit_codes import ExitCode

RUNNER = CliRunner()
WORKER = RUN_COMMAND[-1]
MANY = "{behaviours.go.args.v: [0.2, 0.3], seeds: 3}"
HELD = SHORT.replace("do: drive, v: 0.3", "do: python, call: 'held_team:Go', args: {v: 0.3}")
HELD_TEAM = """import threading
from pathlib import Path
HERE = Path(__file__).parent
class Go:
    def __init__(self, sim, robots, v):
        self.v = v
    def step(self, now, state):
        while any(HERE.glob("out/runs/*.json")) and not (HERE / "go").exists():
            threading.Event().wait(0.01)
        return [[self.v, 0.0]]
"""
"""Once a run has ended, the others wait for the file `go`."""
ENDED_S = 240.0


def call(*words: str) -> Result:
    return RUNNER.invoke(build("sweep"), ["sweep", *words])


def call_here(*words: str) -> Result:
    return call(*words, "--on", "here")


def ids_in(folder: Path) -> list[str]:
    return sorted(file.stem for file in (folder / "runs").glob("*.json"))


def table_of(folder: Path) -> dict[str, list[object]]:
    return pq.read_table(folder / "results.parquet").to_pydict()


def test_sweep_writes_the_same_rows_here_and_in_processes(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{behaviours.go.v: [0.1, 0.3]}")
    digests = []
    for place in ("here", "processes"):
        folder = tmp_path / place

        done = call(file, "--on", place, "--output", str(folder), "--json")

        assert done.exit_code == ExitCode.PARTIAL, done.output
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        assert [(one["done"], one["total"]) for one in lines] == [(1, 2), (2, 2)]
        assert sorted(one["row"]["id"] for one in lines) == ids_in(folder)
        table = table_of(folder)
        assert dict(zip(table["in.behaviours.go.v"], table["passed"], strict=True)) == {
            0.1: False,
            0.3: True,
        }
        recordings = [folder / str(one) for one in table["recording"] if one]
        assert [zensim.Recording(one).counts["/r/odom"] > 10 for one in recordings] == [True]
        assert [(one / "metadata.yaml").is_file() for one in recordings] == [True]
        digests.append(dict(zip(table["id"], table["digest"], strict=True)))
    assert digests[0] == digests[1]
    assert len(set(digests[0].values())) == 2


def test_sweep_passes_when_all_runs_pass(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{seeds: 2, repeats: 2}")

    done = call_here(file, "--output", str(tmp_path / "out"))

    assert done.exit_code == ExitCode.OK, done.output
    assert "4/4 done, 0 failed" in done.stderr


def test_sweep_leaves_the_handling_of_signals_as_it_was(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGTERM)

    call_here(write_scenario(tmp_path), "--output", str(tmp_path / "out"))

    assert signal.getsignal(signal.SIGTERM) is before


def test_name_of_a_scenario_is_no_way_out_of_the_present_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "deep").mkdir()
    monkeypatch.chdir(tmp_path / "deep")
    text = SHORT.replace("name: short", "name: ../evil")

    done = call_here(write_scenario(tmp_path, text=text))

    assert done.exit_code == ExitCode.OK, done.output
    assert [one.name for one in Path().iterdir()] == [".._evil.sweep"]
    assert not (tmp_path / "evil.sweep").exists()


def test_second_call_runs_only_what_is_left(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    call_here(write_scenario(tmp_path, "{behaviours.go.v: [0.2]}"), "--output", str(folder))
    before = (folder / "runs" / f"{ids_in(folder)[0]}.json").read_bytes()

    done = call_here(
        write_scenario(tmp_path, "{behaviours.go.v: [0.2, 0.3]}"),
        *("--output", str(folder), "--json"),
    )

    assert done.exit_code == ExitCode.OK, done.output
    assert len(done.stdout.splitlines()) == 1
    assert before in [file.read_bytes() for file in (folder / "runs").glob("*.json")]
    assert len(table_of(folder)["id"]) == 2


def test_runs_that_are_no_part_of_the_sweep_any_more_are_not_in_its_table(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    for values in ("[0.2, 0.3]", "[0.3, 0.4]"):
        call_here(
            write_scenario(tmp_path, f"{{behaviours.go.v: {values}}}"), "--output", str(folder)
        )

    assert len(ids_in(folder)) == 3
    assert sorted(table_of(folder)["in.behaviours.go.v"]) == [0.3, 0.4]  # type: ignore[type-var]


def test_shares_are_all_runs_and_the_last_one_writes_the_table(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{seeds: 3}")
    folder = tmp_path / "out"

    call_here(file, "--only", "1/2", "--output", str(folder))
    first, has_table = ids_in(folder), (folder / "results.parquet").exists()
    call_here(file, "--only", "2/2", "--output", str(folder))

    assert (len(first), len(ids_in(folder)), has_table) == (2, 3, False)
    assert table_of(folder)["id"] == ids_in(folder)


def test_unequal_repeats_count_where_the_share_has_one_of_them(tmp_path: Path) -> None:
    words = (write_scenario(tmp_path, "{seeds: 2, repeats: 2}"), "--output", str(tmp_path / "out"))
    call_here(*words)
    rows = [json.loads(one.read_bytes()) for one in (tmp_path / "out" / "runs").iterdir()]
    row = next(one for one in rows if (one["number"], one["repeat"]) == (0, 1))
    (tmp_path / "out" / "runs" / f"{row['id']}.json").write_text(json.dumps(row | {"digest": "x"}))

    codes = [call_here(*words, "--only", share).exit_code for share in ("1/4", "3/4")]

    assert codes == [ExitCode.PARTIAL, ExitCode.OK]


def test_error_of_a_run_is_a_row_and_can_be_retried(tmp_path: Path) -> None:
    (tmp_path / "broken_team.py").write_text(
        "import os\nfrom pathlib import Path\nclass Control:\n"
        "    def __init__(self, sim, robots):\n"
        "        if not (Path(__file__).parent / 'mended').exists():\n            os._exit(3)\n"
        "    def step(self, now, state):\n        return [[0.3, 0.0]]\n"
    )
    text = SHORT.replace("do: drive, v: 0.3", "do: python, call: 'broken_team:Control'")
    words = (write_scenario(tmp_path, text=text), "--output", str(tmp_path / "out"))

    first = call(*words)
    recording = tmp_path / "out" / "recordings" / ids_in(tmp_path / "out")[0]
    recording.mkdir(parents=True)
    (recording / f"{recording.name}_0.mcap").touch()
    (tmp_path / "mended").touch()
    kept, retried = call(*words), call(*words, "--retry-errors")

    assert [one.exit_code for one in (first, kept, retried)] == [
        ExitCode.PARTIAL,
        ExitCode.PARTIAL,
        ExitCode.OK,
    ], retried.output
    assert "status 3" in first.stderr
    assert not recording.exists()


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (("no_such_file",), ExitCode.NOT_FOUND),
        (("first_minutes", "--only", "3/2"), ExitCode.USAGE),
        (("first_minutes", "--only", "x"), ExitCode.USAGE),
        (("first_minutes", "--on", "here", "--jobs", "2"), ExitCode.USAGE),
        (("first_minutes", "--on", "moon"), ExitCode.USAGE),
        (("first_minutes", "--ray-address", "auto"), ExitCode.USAGE),
        (("first_minutes", "--set", "engine.use=ode"), ExitCode.USAGE),
        (("report", "no_such_folder"), ExitCode.NOT_FOUND),
    ],
)
def test_mistakes_are_found_before_the_first_run(
    words: tuple[str, ...], status: ExitCode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    assert call(*words).exit_code == status
    assert list(tmp_path.iterdir()) == []


def test_mistake_of_a_combination_is_printed_with_its_line(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{behaviours.go.robots: [r, nobody]}")

    done = call(file, "--output", str(tmp_path / "out"))

    assert done.exit_code == ExitCode.USAGE
    assert "behaviours[0].robots" in done.stderr
    assert not (tmp_path / "out").exists()


def command_of(process: psutil.Process) -> str:
    """Find a command line; empty of a process that has ended, and of a zombie."""
    with suppress(psutil.Error):
        return " ".join(process.cmdline())
    return ""


def workers_of(driver: int) -> list[psutil.Process]:
    """List the processes that run scenarios, with the copies of them that do now."""
    return [
        one for one in psutil.Process(driver).children(recursive=True) if WORKER in command_of(one)
    ]


@pytest.fixture
def started(tmp_path: Path) -> Iterator["subprocess.Popen[str]"]:
    """Start a sweep, of which a part has ended."""
    (tmp_path / "held_team.py").write_text(HELD_TEAM)
    file = write_scenario(tmp_path, MANY, HELD)
    with running(
        "sweep", file, "--jobs", "2", "--output", str(tmp_path / "out"), "--quiet"
    ) as process:
        eventually(lambda: len(ids_in(tmp_path / "out")) >= 1, ENDED_S, "a row")
        yield process


def finish(tmp_path: Path) -> "subprocess.CompletedProcess[str]":
    file = str(tmp_path / "short.scenario.yaml")
    (tmp_path / "go").touch()
    return subprocess.run(
        command_line(["sweep", file, "--output", str(tmp_path / "out"), "--json"]),
        capture_output=True,
        text=True,
        timeout=ENDED_S,
        check=False,
    )


def check_that_all_ran_once(
    tmp_path: Path, before: list[str], done: "subprocess.CompletedProcess[str]"
) -> None:
    ran = [json.loads(line)["row"]["id"] for line in done.stdout.splitlines()]
    assert done.returncode == ExitCode.OK, done.stderr
    assert not set(before) & set(ran)
    table = table_of(tmp_path / "out")
    assert table["id"] == sorted([*before, *ran]) == ids_in(tmp_path / "out")
    assert len(set(table["id"])) == 6
    assert set(table["passed"]) == {True}


def test_killed_workers_lose_nothing(started: "subprocess.Popen[str]", tmp_path: Path) -> None:
    for worker in eventually(lambda: workers_of(started.pid)[:2] or None, ENDED_S, "a worker"):
        with suppress(psutil.NoSuchProcess):
            worker.send_signal(signal.SIGKILL)
    (tmp_path / "go").touch()

    assert started.wait(ENDED_S) == ExitCode.OK, started.communicate()
    check_that_all_ran_once(tmp_path, ids_in(tmp_path / "out"), finish(tmp_path))


def test_killed_driver_loses_nothing_and_its_workers_end(
    started: "subprocess.Popen[str]", tmp_path: Path
) -> None:
    workers = eventually(lambda: workers_of(started.pid) or None, ENDED_S, "a worker")
    os.kill(started.pid, signal.SIGKILL)
    started.wait()
    eventually(lambda: not any(map(command_of, workers)), ENDED_S, "the workers' end")
    before = ids_in(tmp_path / "out")

    check_that_all_ran_once(tmp_path, before, finish(tmp_path))


def test_interrupted_sweep_keeps_what_has_ended(
    started: "subprocess.Popen[str]", tmp_path: Path
) -> None:
    started.send_signal(signal.SIGTERM)

    assert started.wait(ENDED_S) == ExitCode.INTERRUPTED
    before = ids_in(tmp_path / "out")
    assert table_of(tmp_path / "out")["id"] == before
    check_that_all_ran_once(tmp_path, before, finish(tmp_path))


def test_report_prints_a_table_and_draws(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{behaviours.go.v: [0.1, 0.3], seeds: 2}")
    folder, picture = tmp_path / "out", tmp_path / "margins.png"
    swept = call_here(file, "--output", str(folder))

    text = call("report", str(folder), "--plot", str(picture))
    whole = call("report", str(folder), "--json")

    assert swept.exit_code == ExitCode.PARTIAL, (swept.output, swept.exception)
    assert text.exit_code == ExitCode.OK, text.output
    assert len(text.stdout.splitlines()) == 4
    assert picture.stat().st_size > 1000
    groups = json.loads(whole.stdout)["groups"]
    assert [(one["runs"], one["passed"]) for one in groups] == [(2, 0), (2, 2)]


@pytest.mark.parametrize(
    "words", [("--by", "behaviours.go.w"), ("--plot", "margins.txt")], ids=["by", "plot"]
)
def test_report_refuses_what_it_cannot_show(words: tuple[str, ...], tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{behaviours.go.v: [0.3]}")
    call_here(file, "--output", str(tmp_path / "out"))

    done = call("report", str(tmp_path / "out"), *words)

    assert done.exit_code == ExitCode.USAGE
    assert len(done.stderr.splitlines()) == 1


def test_help_shows_the_options_of_a_sweep() -> None:
    assert "--jobs" in call("--help").stdout
    assert "--plot" in call("report", "--help").stdout
