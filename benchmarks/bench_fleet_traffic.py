"""Fleets: traffic

Router, server, agents and users are separate processes, at real-time factor 1. One process is all
users: it commands each robot at 10 Hz to drive a circle, and subscribes to all odometry and tf. One
more robot stands; it is commanded to move, again and again, and the time until its odometry shows
motion is measured, 20 s at most. A sample is a second, or a command; CPU is in cores.
"""

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from benchmarks.figures import Figure, Limit, table
from benchmarks.installation import Span, observe, run_fleet_users, run_installation
from benchmarks.motion import PATIENCE_S, SPEED, response_ms
from benchmarks.ten_robots import MILLISECONDS, spawn
from tests.integration.processes import eventually
from tests.integration.robots import Robot, robot

__all__ = ["rows", "table"]

COMMANDS_HZ = 10.0
POOLS = 2
"""One pool per core of the machine that the limits are for."""
SECONDS, SECONDS_FOR_TEN, SECONDS_WHEN_SHORT = 60.0, 15.0, 1.0
CLAIM_S = 60.0
SEED = 13
FACTOR = Limit("median", ">=", 0.99)


@dataclass(frozen=True)
class Case:
    """An installation, and its limits."""

    label: str
    robots: int
    """Including the measured robot."""
    serve: tuple[str, ...]
    agents: tuple[tuple[str, ...], ...]
    seconds: float
    answer: Limit | None = None


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure installations of several sizes."""
    for case in cases(is_short=is_short):
        yield from _measured(case)


def cases(*, is_short: bool) -> Sequence[Case]:
    """List the measured installations."""
    if is_short:
        return (Case("2 robots, 1 pool, 50 Hz", 2, (), (pool(50.0),), SECONDS_WHEN_SHORT),)
    agents = tuple((f"box_bot{i}",) for i in range(10))
    quickly, in_time = Limit("median", "<=", 15.0), Limit("p99", "<=", 60.0)
    coarse = ("--step-hz", "100", "--dynamics", "auto")
    return (
        Case("10 robots, 10 agents", 10, (), agents, SECONDS_FOR_TEN, quickly),
        Case("100 robots, 2 pools, 50 Hz", 100, (), (pool(50.0),) * POOLS, SECONDS, in_time),
        Case(
            "1000 robots, dynamics auto, 100 Hz, 2 pools, 10 Hz",
            1000,
            coarse,
            (pool(10.0),) * POOLS,
            SECONDS_FOR_TEN,
        ),
    )


def pool(hz: float) -> tuple[str, ...]:
    """Make the arguments of a pool with this odometry and tf rate."""
    return ("--pool", "0", "--odom-hz", f"{hz:g}", "--tf-hz", f"{hz:g}")


def _measured(case: Case) -> Iterator[Figure]:
    took_ms: list[float] = []
    others = case.robots - 1
    with run_installation(case.serve, case.agents) as crew:
        spawn(crew.client, case.robots)
        eventually(lambda: crew.client.info().claimed == case.robots, CLAIM_S, "claiming")
        single = robot(crew.bus, f"box_bot{others}")
        with run_fleet_users(crew.bus, others, COMMANDS_HZ) as (tallies, pid):
            everybody = replace(crew, pids={**crew.pids, "users": (pid,)})
            command = _commands(single, took_ms)
            spans = observe(everybody, tallies, others, case.seconds, command)
    yield from _figures(case, spans, took_ms)


def _commands(single: Robot, took_ms: list[float]) -> Callable[[], None]:
    """Make a function that commands a robot and records its response time."""
    phase = random.Random(SEED)

    def command() -> None:
        speed = SPEED * (-1) ** len(took_ms)
        try:
            took_ms.append(response_ms(single, phase, speed))
        except TimeoutError:
            took_ms.append(PATIENCE_S * MILLISECONDS)

    return command


def _figures(case: Case, spans: list[Span], took_ms: list[float]) -> Iterator[Figure]:
    label = case.label
    factors = tuple(span.factor for span in spans)
    yield Figure(what=f"{label}: real-time factor", unit="", samples=factors, limit=FACTOR)
    yield Figure(
        what=f"{label}: cmd_vel to odom that moves",
        unit="ms",
        samples=tuple(took_ms),
        limit=case.answer,
    )
    moved = spans[-1].moved
    everybody = Limit("min", ">=", case.robots - 1)
    yield Figure(what=f"{label}: others that moved", unit="", samples=(moved,), limit=everybody)
    for group in spans[0].cores:
        cores = tuple(span.cores[group] for span in spans)
        yield Figure(what=f"{label}: CPU, {group}", unit="cores", samples=cores)
    for what, samples in {
        "cmd_vel in": tuple(span.commands_hz for span in spans),
        "odom out": tuple(span.odom_hz for span in spans),
        "tf out": tuple(span.tf_hz for span in spans),
    }.items():
        yield Figure(what=f"{label}: {what}", unit="1/s", samples=samples)
