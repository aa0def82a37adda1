"""Scenario files

Reading: CPU time of a file with 50 and with 8000 lines of behaviours. Runs: each shipped scenario
by `zensim test`, in process; every check has to pass. Many: twenty files of ten robots that walk at
random for ten simulated seconds, as `zensim test FOLDER --jobs 2` runs them.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import Figure, Limit, table
from zensim.deploy.scenario_process import RunRequest, run_all, run_in_process
from zensim.scenario.scenario_reader import (
    SUFFIXES,
    find_scenario_file,
    list_shipped_scenarios,
    read_scenario,
)

__all__ = ["rows", "table"]

HEAD = "zensim: 1\nrobots:\n  - {name: cart, model: box_bot, count: 3}\nbehaviours:\n"
LINE = "  - {{name: b{}, robots: cart*, do: waypoints, points: [[1, 0], [2, 0]]}}\n"
MOST_MS = {50: 10.0, 8000: 500.0}
"""Reading, by number of lines."""
TEN_ROBOTS = """zensim: 1
name: walk{seed}
time: {{seed: {seed}}}
robots: [{{name: bot, model: box_bot, count: 10, layout: {{kind: circle, radius: 3 m}}}}]
behaviours: [{{name: walk, robots: bot*, do: random_walk, speed: 0.3}}]
checks: [{{name: slow, robots: bot*, that: speed, below: 1}}]
end: {{at: 10 s}}
"""
JOBS, MANY, MOST_S = 2, 20, 30.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure reading, and run the shipped scenarios."""
    with tempfile.TemporaryDirectory() as folder:
        for lines, most in list(MOST_MS.items())[: 1 if is_short else None]:
            yield _measure_reading(Path(folder), lines, most, 3 if is_short else 11)
        yield from _run_many(Path(folder), JOBS if is_short else MANY)
    for name in ["first_minutes"] if is_short else list_shipped_scenarios():
        yield from _run(name)


def _measure_reading(folder: Path, lines: int, most: float, count: int) -> Figure:
    file = folder / f"lines{lines}{SUFFIXES[0]}"
    file.write_text(HEAD + "".join(LINE.format(number) for number in range(lines - 4)))
    read_scenario(str(file))
    samples = []
    for _ in range(count):
        began = time.process_time()
        read_scenario(str(file))
        samples.append(1e3 * (time.process_time() - began))
    limit = Limit("median", "<=", most, is_timed=True)
    return Figure(what=f"read {lines} lines", unit="ms", samples=tuple(samples), limit=limit)


def _run(name: str) -> Iterator[Figure]:
    run = run_in_process(RunRequest(find_scenario_file(name)))
    failed = [check for check in run.checks if check.verdict != "passed"]
    yield Figure(
        what=f"{name}: checks that did not pass, of {len(run.checks)}",
        unit="",
        samples=(float(len(failed)) if not run.error else float("inf"),),
        limit=Limit("max", "<=", 0.0),
    )
    yield Figure(
        what=f"{name}: {run.robots} robots, simulated by wall time",
        unit="",
        samples=(run.sim_time / max(run.wall_time_s, 1e-9),),
    )


def _run_many(folder: Path, count: int) -> Iterator[Figure]:
    files = [folder / f"walk{seed}{SUFFIXES[0]}" for seed in range(count)]
    for seed, file in enumerate(files):
        file.write_text(TEN_ROBOTS.format(seed=seed))
    began = time.monotonic()
    runs = run_all([RunRequest(str(file)) for file in files], jobs=JOBS, on_run=lambda _: None)
    spent = time.monotonic() - began
    what = f"{count} scenarios of 10 s and 10 robots, {JOBS} at once"
    limit = Limit("max", "<=", MOST_S, is_timed=True)
    yield Figure(what=what, unit="s", samples=(spent,), limit=limit)
    failed = [run for run in runs if not run.is_passed]
    yield Figure(
        what="of them, not passed",
        unit="",
        samples=(float(len(failed)),),
        limit=Limit("max", "<=", 0.0),
    )
