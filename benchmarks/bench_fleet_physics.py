"""Fleets: kinds of physics

A real server at `--rtf 0` with box_bots that drive circles. One other process answers every drive
state and receives the snapshots, 30 per second of wall time. Do not compare robots of different
kinds of physics: a kinematic robot is a point with a heading, a fully dynamic one has wheels,
masses and contacts. A sample is a turn of some seconds; CPU is that of all threads and processes of
the server.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.bench_fleet import begin
from benchmarks.figures import Figure, table
from benchmarks.fleet_server import Spent, run_fleet_server

__all__ = ["rows", "table"]

TURNS, TURN_S = 5, 2.0
TURNS_WHEN_SHORT, TURN_WHEN_SHORT_S = 2, 0.1


@dataclass(frozen=True)
class Case:
    """A fleet, and the arguments of its server."""

    label: str
    robots: int
    step_hz: float
    serve: tuple[str, ...] = ()


KINEMATIC = ("--dynamics", "kinematic")
CASES = (
    Case("1000 robots, one PyBullet world", 1000, 100.0, ("--clusters", "off")),
    Case("1000 robots, PyBullet in cells", 1000, 100.0, ("--clusters", "on")),
    Case("1000 robots, MuJoCo", 1000, 100.0, ("--engine", "mujoco")),
    Case("1000 robots, dynamics auto", 1000, 100.0, ("--dynamics", "auto")),
    Case("1000 robots, kinematic", 1000, 50.0, KINEMATIC),
    Case("10,000 robots, kinematic", 10_000, 50.0, KINEMATIC),
)
SHORT_CASES = (Case("2 robots, kinematic", 2, 50.0, KINEMATIC),)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the real-time factor of each case."""
    turns, turn_s = (TURNS_WHEN_SHORT, TURN_WHEN_SHORT_S) if is_short else (TURNS, TURN_S)
    for case in SHORT_CASES if is_short else CASES:
        arguments = ("--step-hz", f"{case.step_hz:g}", *case.serve)
        with run_fleet_server(case.robots, *arguments) as server:
            begin(server, case.robots)
            spans = [server.turn(turn_s) for _ in range(turns)]
        yield from _figures(case, spans)


def _figures(case: Case, turns: list[Spent]) -> Iterator[Figure]:
    label = f"{case.label}, {case.step_hz:g} Hz"
    yield Figure(
        what=f"{label}: real-time factor",
        unit="",
        samples=tuple(turn.steps / case.step_hz / turn.wall_s for turn in turns),
    )
    yield Figure(
        what=f"{label}: a robot and step",
        unit="us",
        samples=tuple(turn.wall_s / turn.steps / case.robots * 1e6 for turn in turns),
    )
    yield Figure(
        what=f"{label}: CPU",
        unit="cores",
        samples=tuple((turn.process_cpu_s + turn.children_cpu_s) / turn.wall_s for turn in turns),
    )
