"""Sweeps

`zensim sweep` of runs of 2 simulated seconds with ten robots that walk at random: runs per minute
by two processes, and what a run costs beside its control steps. The floor is the same control steps
in one world of this process, whose robots are there already. The same runs as tasks of Ray, with
the start of its cluster, must end in the same states.
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

RUNS, RUNS_WHEN_SHORT = 100, 2
JOBS = 2
LEAST_PER_MINUTE, MOST_OVERHEAD_S = 100.0, 0.02
Digests = dict[str, str]
"""Hashes of last states, by the ids of runs."""
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
        floor = _measure_steps(file, 1 if is_short else 11)
        yield floor
        spent_s, cpu_s, digests = _sweep(file, "processes")
        on_ray = None if is_short else _sweep(file, "ray")
    yield Figure(
        what=f"{runs} runs by {JOBS} processes, with their start",
        unit="1/min",
        samples=(60.0 * runs / spent_s,),
        limit=Limit("max", ">=", LEAST_PER_MINUTE, is_timed=True),
    )
    if on_ray is not None:
        yield from _compare_ray(*on_ray, digests)
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


def _compare_ray(
    spent_s: float, cpu_s: tuple[float, ...], digests: Digests, expected: Digests
) -> Iterator[Figure]:
    what = f"{len(cpu_s)} runs by {JOBS} workers of Ray, with the start of its cluster"
    yield Figure(what=what, unit="1/min", samples=(60.0 * len(cpu_s) / spent_s,))
    unequal = [one for one in expected if digests.get(one) != expected[one]]
    what = "runs on Ray without the state of those in processes"
    yield Figure(what=what, unit="", samples=(float(len(unequal)),), limit=Limit("max", "<=", 0.0))


def _sweep(file: Path, place: str) -> tuple[float, tuple[float, ...], Digests]:
    """Run a sweep; return its wall time, the CPU times of runs [s], and states by run."""
    output = file.parent / place
    command = ("sweep", str(file), "--on", place, "--jobs", str(JOBS), "--output", str(output))
    began_s = time.monotonic()
    done = subprocess.run(
        (sys.executable, "-m", "zensim", *command, "--json", "--quiet"),
        capture_output=True,
        text=True,
        check=True,
    )
    spent_s = time.monotonic() - began_s
    found = [json.loads(line)["row"] for line in done.stdout.splitlines()]
    cpu_s = tuple(row["cpu_s"] for row in found)
    return spent_s, cpu_s, {row["id"]: row["digest"] for row in found}
