"""Sweeps

`zensim sweep` of runs of 2 simulated seconds with ten robots that walk at random: runs per minute
by two processes, and what a run costs beside its control steps. The floor is the same control steps
in one world of this process, whose robots are there already.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import Figure, Limit, table
from zensim.scenario.scenario_loading import load

__all__ = ["rows", "table"]

RUNS, RUNS_WHEN_SHORT = 100, 4
JOBS = 2
LEAST_PER_MINUTE, MOST_OVERHEAD_S = 100.0, 0.02
SCENARIO = """zensim: 1
name: walk
robots: [{{name: bot, model: box_bot, count: 10, layout: {{kind: circle, radius: 3 m}}}}]
behaviours: [{{name: walk, robots: "bot*", do: random_walk, speed: 0.3}}]
checks: [{{name: slow, that: speed, below: 1}}]
end: {{at: 2 s}}
vary: {{seeds: {runs}}}
"""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure a sweep in processes, and the floor."""
    runs = RUNS_WHEN_SHORT if is_short else RUNS
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "walk.scenario.yaml"
        file.write_text(SCENARIO.format(runs=runs))
        floor = _measure_steps(file, 3 if is_short else 11)
        yield floor
        spent_s, cpu_s = _sweep(file)
    yield Figure(
        what=f"{runs} runs by {JOBS} processes, with their start",
        unit="1/min",
        samples=(60.0 * runs / spent_s,),
        limit=Limit("max", ">=", LEAST_PER_MINUTE, is_timed=True),
    )
    yield Figure(what="CPU time of a run", unit="s", samples=cpu_s)
    # The first run of each process fills its caches.
    least = floor.value("median")
    yield Figure(
        what="of that, beside the control steps",
        unit="s",
        samples=tuple(one - least for one in cpu_s),
        limit=Limit("median", "<=", MOST_OVERHEAD_S, is_timed=True),
    )


def _measure_steps(file: Path, count: int) -> Figure:
    samples = []
    for _ in range(count):
        with load(file) as run:
            began_s = time.process_time()
            run.run()
            samples.append(time.process_time() - began_s)
    return Figure(what="floor: control steps in this process", unit="s", samples=tuple(samples))


def _sweep(file: Path) -> tuple[float, tuple[float, ...]]:
    """Run a sweep; return its wall time, and the CPU time of each run [s]."""
    command = ("sweep", str(file), "--jobs", str(JOBS), "--output", str(file.parent / "out"))
    began_s = time.monotonic()
    done = subprocess.run(
        (sys.executable, "-m", "zensim", *command, "--json", "--quiet"),
        capture_output=True,
        text=True,
        check=True,
    )
    spent_s = time.monotonic() - began_s
    found = [json.loads(line)["row"]["cpu_s"] for line in done.stdout.splitlines()]
    return spent_s, tuple(found)
