"""Repeated runs

Robots close together, an agent process for each, in lockstep; a seeded script commands them
differently, so that they collide. Each run starts all processes anew. Hashed are the bytes of every
odometry message of every robot, and the final state of every body and joint.
"""

import sys
from collections.abc import Iterator

from benchmarks.figures import Figure, Limit
from tests.integration.repeatable_run import RunResult, drive, run_lockstep_fleet

RUNS, RUNS_WHEN_SHORT = 10, 2
ROBOTS, ROBOTS_WHEN_SHORT = 20, 2
STEPS, STEPS_WHEN_SHORT = 10_000, 240


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Run repeatedly, and count distinct hashes."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    steps = STEPS_WHEN_SHORT if is_short else STEPS
    runs = [_run(robots, steps) for _ in range(RUNS_WHEN_SHORT if is_short else RUNS)]
    yield Figure(
        what=f"different hashes of {len(runs)} runs of {steps} steps with {robots} robots",
        unit="",
        samples=(float(len({said.hash for said in runs})),),
        limit=Limit("max", "<=", 1.0),
    )
    yield Figure(
        what=f"odometry messages of each robot, hash {runs[0].hash[:16]}",
        unit="",
        samples=tuple(float(count) for said in runs for count in said.odoms.values()),
    )


def _run(robots: int, steps: int) -> RunResult:
    with run_lockstep_fleet(robots) as server:
        said = drive(server, robots, steps)
    sys.stderr.write(f"{said.hash}\n")
    return said
