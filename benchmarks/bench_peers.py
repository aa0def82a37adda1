"""Beside other simulators

The same robots, 5 m apart on open ground, drive the same circles of 0.4 m, as fast as possible, in
simulators of one process and in zensim; each has the settings that suit it best and a process of
its own. ir-sim moves discs in steps of 0.1 s and checks whether they touch, without a figure.
PyBullet has 10 solver iterations; MuJoCo steps worlds of ten robots that share a model, one after
another. `World` of zensim adds drives with limits and odometry at 20 Hz; over the network, a server
and two pools of agents are counted, and a client commands each robot once a second. Engines have
wheels, masses and contacts; ir-sim and kinematic robots of zensim do not. CPU is that of all
processes and threads; `at real time` is the number of robots times the real-time factor. The
fastest of some turns. Robots that do not drive at 0.2 m/s within 10 % are an error.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping

import msgspec

from benchmarks.bench_overview import SETTLE_S, Physics, drive_fleet
from benchmarks.figures import written
from benchmarks.machine import ROOT
from benchmarks.peers import environment
from benchmarks.peers.plain_fleets import Driven
from benchmarks.ten_robots import CIRCLE

IR_SIM = "ir-sim 2.12"
ALONE: Mapping[str, str] = {
    "pybullet": "PyBullet alone",
    "mujoco": "MuJoCo alone",
    "world_pybullet": "zensim, World, PyBullet",
    "world_mujoco": "zensim, World, MuJoCo",
    "world_kinematic": "zensim, World, kinematic",
}
NETWORK = (
    Physics("zensim, network, PyBullet", 240.0, ("--engine", "pybullet", "--rtf", "0")),
    Physics("zensim, network, MuJoCo", 100.0, ("--engine", "mujoco", "--rtf", "0")),
    Physics(
        "zensim, network, kinematic",
        20.0,
        ("--dynamics", "kinematic", "--control-hz", "20", "--rtf", "0"),
    ),
)
SIZES, SIZES_WHEN_SHORT = (10, 100, 1000), (2,)
SECONDS, SECONDS_WHEN_SHORT = 1.5, 0.2
TURNS = 2
TOLERANCE = 0.1
HEAD = (
    "simulator",
    "robots",
    "steps [Hz]",
    "real-time factor",
    "a robot and step [CPU us]",
    "a robot and simulated second [CPU us]",
    "robots at real time",
)


class Row(msgspec.Struct, frozen=True):
    """A fleet in a simulator."""

    simulator: str
    robots: int
    step_hz: float
    factor: float
    step_us: float
    """CPU time of a robot and step."""


def rows(*, is_short: bool) -> Iterator[Row]:
    """Measure each simulator with fleets of several sizes."""
    seconds = SECONDS_WHEN_SHORT if is_short else SECONDS
    interpreter = str(environment.install())
    ir_sim = [interpreter, str(ROOT / "benchmarks" / "peers" / "ir_sim_fleet.py")]
    programs = {IR_SIM: ir_sim} | {
        label: [sys.executable, "-m", "benchmarks.peers", kind] for kind, label in ALONE.items()
    }
    for robots in SIZES_WHEN_SHORT if is_short else SIZES:
        for label, command in programs.items():
            yield _run(label, command, robots, seconds, turns=1 if is_short else TURNS)
        for physics in NETWORK[-1:] if is_short else NETWORK:
            fleet = drive_fleet(physics, robots, seconds, settle_s=SETTLE_S)
            yield Row(physics.label, robots, physics.step_hz, fleet.factor, fleet.step_us)


def table(found: Iterable[Row]) -> str:
    """Format a row for each fleet."""
    head = f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}\n"
    return head + "".join(f"| {' | '.join(_cells(row))} |\n" for row in found)


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.simulator,
        str(row.robots),
        written(row.step_hz),
        written(row.factor),
        written(row.step_us),
        written(row.step_us * row.step_hz),
        written(row.robots * row.factor),
    )


def _run(label: str, command: list[str], robots: int, seconds: float, *, turns: int) -> Row:
    """Run a program some times; take the fastest turn.

    Raises:
        RuntimeError: Its robots do not drive as they should.
    """
    words = [*command, str(robots), f"{seconds:g}"]
    # ir-sim prints lines of its own before.
    printed = [environment.run(words).splitlines()[-1] for _ in range(turns)]
    driven = [msgspec.json.decode(line, type=Driven) for line in printed]
    if wrong := [one.speed for one in driven if abs(one.speed / CIRCLE[0] - 1.0) > TOLERANCE]:
        raise RuntimeError(f"{label}, {robots} robots: they drive at {wrong[0]:g} m/s")
    best = min(driven, key=lambda one: one.cpu_s / one.steps)
    factor = max(one.steps * one.step_s / one.wall_s for one in driven)
    step_us = best.cpu_s / best.steps / robots * 1e6
    return Row(label, robots, 1.0 / best.step_s, factor, step_us)
