"""Killed sweeps

A sweep of short runs, in processes. In the middle of it two of its workers are killed
with SIGKILL, later the driver; then the same command is started again. Each run must have one row,
no run may have run twice, and all states must be those of a sweep without any disturbance.
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
behaviours: [{{name: walk, robots: "r*", do: random_walk, speed: 0.3}}]
checks: [{{name: slow, that: speed, below: 1}}]
end: {{at: 1 s}}
vary: {{seeds: {runs}}}
"""
PLACES = {"processes": RUN_COMMAND[-1]}
"""What the command line of a worker contains, by `--on`."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill workers and drivers, and compare with an undisturbed sweep."""
    runs = RUNS_WHEN_SHORT if is_short else RUNS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "killed.scenario.yaml").write_text(SCENARIO.format(runs=runs))
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
        check=True,
    )
    return {json.loads(line)["row"]["id"] for line in done.stdout.splitlines()}


def _disturb(folder: Path, place: str, runs: int) -> set[str]:
    """Kill two workers after a quarter of the runs, and the driver after half of them."""
    output = folder / place
    with running(*_command(folder, place, place)) as driver:
        eventually(lambda: len(_list_ids(output)) >= runs // 4, END_S, "a quarter")
        workers = eventually(
            lambda: _list_workers(driver.pid, place)[:2] or None, END_S, "a worker"
        )
        for worker in workers:
            with suppress(psutil.NoSuchProcess):
                worker.send_signal(signal.SIGKILL)
        eventually(lambda: len(_list_ids(output)) >= runs // 2, END_S, "half")
        family = psutil.Process(driver.pid).children(recursive=True)
        os.kill(driver.pid, signal.SIGKILL)
        driver.wait()
        eventually(lambda: not any(map(_is_alive, family)), END_S, "the end of its processes")
    return _list_ids(output)


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
