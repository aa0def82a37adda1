"""Killed sweeps

A sweep of short runs, in processes and on Ray. After a quarter of the runs two of its workers are
killed with SIGKILL, after a half of them the driver; then the same command is started again. Each
run must have one row, no run may have run twice, and all states must be those of an undisturbed
sweep. Until something is killed, the runs that are under way wait, so that it is in their midst.
"""

import json
import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil

from benchmarks.figures import Figure, Limit
from tests.integration.processes import command_line, eventually, running
from zensim.deploy.scenario_process import RUN_COMMAND

RUNS, RUNS_WHEN_SHORT = 100, 6
END_S = 3600.0
SCENARIO = """zensim: 1
name: killed
robots: [{{name: r, model: box_bot, count: 4, layout: {{kind: circle, radius: 3 m}}}}]
behaviours:
  - {{name: walk, robots: "r[1-3]", do: random_walk, speed: 0.3}}
  - {{name: wait, robots: r0, do: python, call: "waiting_team:Wait"}}
checks: [{{name: slow, that: speed, below: 1}}]
end: {{at: 1 s, timeout: 1 h}}
vary: {{seeds: {runs}}}
"""
TEAM = """import threading
from pathlib import Path
GATE = Path(__file__).with_name("gate")
class Wait:
    def __init__(self, sim, robots):
        pass
    def step(self, now, state):
        while GATE.exists() and is_closed(*GATE.read_text().split()):
            threading.Event().wait(0.01)
        return [[0.2, 0.0]]
def is_closed(folder, most):
    return len(list(Path(folder).glob("*.json"))) >= int(most)
"""
"""Runs wait while a folder has so many rows as the file `gate` says."""
PLACES = {"processes": RUN_COMMAND[-1], "ray": "ray::run_encoded"}
"""What the command line of a worker contains, by `--on`."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill workers and drivers, and compare with an undisturbed sweep."""
    runs = RUNS_WHEN_SHORT if is_short else RUNS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "killed.scenario.yaml").write_text(SCENARIO.format(runs=runs))
        (folder / "waiting_team.py").write_text(TEAM)
        _run(folder, "processes", "calm")
        calm = _read_digests(folder / "calm")
        for place in PLACES:
            before = _disturb(folder, place, runs)
            repeated = len(before & _run(folder, place, place))
            found = _read_digests(folder / place)
            yield from _compare(place, calm, found, repeated)


def _compare(
    place: str, calm: dict[str, str], found: dict[str, str], repeated: int
) -> Iterator[Figure]:
    lost = set(calm) - set(found)
    unequal = [one for one in found if found[one] != calm.get(one)]
    for what, count in (
        (f"runs without a row, of {len(calm)}", len(lost)),
        ("runs that ran again after their row was there", repeated),
        ("rows with another state than undisturbed", len(unequal)),
    ):
        limit = Limit("max", "<=", 0.0)
        yield Figure(what=f"{place}: {what}", unit="", samples=(float(count),), limit=limit)


def _command(folder: Path, place: str, output: str) -> tuple[str, ...]:
    return (
        *("sweep", str(folder / "killed.scenario.yaml"), "--on", place, "--jobs", "2"),
        *("--output", str(folder / output), "--json", "--quiet"),
    )


def _run(folder: Path, place: str, output: str) -> set[str]:
    """Run what is left, and return the ids of what ran."""
    done = subprocess.run(
        command_line(_command(folder, place, output)),
        capture_output=True,
        text=True,
        timeout=END_S,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"the sweep ended with {done.returncode}: {done.stderr.strip()}")
    return {json.loads(line)["row"]["id"] for line in done.stdout.splitlines()}


def _disturb(folder: Path, place: str, runs: int) -> set[str]:
    """Kill two workers after a quarter of the runs, and the driver after half of them."""
    output = folder / place
    quarter, half = runs // 4, runs // 2
    _close_gate(folder, output, quarter)
    with running(*_command(folder, place, place)) as driver:
        _await_rows(driver, output, quarter)
        for worker in eventually(lambda: _find_two(driver.pid, place), END_S, "two workers"):
            with suppress(psutil.NoSuchProcess):
                worker.send_signal(signal.SIGKILL)
        _close_gate(folder, output, half)
        _await_rows(driver, output, half)
        family = psutil.Process(driver.pid).children(recursive=True)
        os.kill(driver.pid, signal.SIGKILL)
        driver.wait()
        eventually(lambda: not any(map(_is_alive, family)), END_S, "the end of its processes")
    (folder / "gate").unlink()
    return _list_ids(output)


def _await_rows(driver: "subprocess.Popen[str]", output: Path, least: int) -> None:
    """Wait for rows, as long as the driver runs."""

    def is_over() -> bool:
        return len(_list_ids(output)) >= least or driver.poll() is not None

    eventually(is_over, END_S, f"{least} rows")
    if driver.poll() is not None:
        _, errors = driver.communicate()
        raise RuntimeError(f"the sweep ended before it was killed: {errors.strip()}")


def _close_gate(folder: Path, output: Path, most: int) -> None:
    """Let runs wait from so many rows on."""
    new = folder / "gate.new"
    new.write_text(f"{output / 'runs'} {most}")
    new.replace(folder / "gate")


def _find_two(driver: int, place: str) -> list[psutil.Process] | None:
    """Find two workers, without the copies of them that run scenarios."""
    found = _list_workers(driver, place)
    numbers = {one.pid for one in found}
    with suppress(psutil.NoSuchProcess):
        own = [one for one in found if one.ppid() not in numbers]
        return own[:2] if len(own) > 1 else None
    return None


def _list_workers(driver: int, place: str) -> list[psutil.Process]:
    return [
        one
        for one in psutil.Process(driver).children(recursive=True)
        if PLACES[place] in _read_command(one)
    ]


def _read_command(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def _is_alive(process: psutil.Process) -> bool:
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


def _list_ids(output: Path) -> set[str]:
    return {file.stem for file in (output / "runs").glob("*.json")}


def _read_digests(output: Path) -> dict[str, str]:
    files = (output / "runs").glob("*.json")
    rows_found = [json.loads(file.read_bytes()) for file in files]
    return {row["id"]: row["digest"] for row in rows_found}
