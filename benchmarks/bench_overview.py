"""Fleets in real time

What a user gets: `zensim serve`, two pools of agents, and a client that commands each robot once a
second to drive in a circle; all are processes of their own, connected through the server's router.
Robots keep their last command (`--cmd-vel-timeout 0`). Nobody subscribes to odometry. The real-time
factor that is wanted is 1. Full dynamics have wheels, masses and contacts; a kinematic robot is a
point with a heading that others block; with auto, a robot is kinematic until something is near. CPU
and memory are those of all processes but the client, memory is what only they use. The time of
spawning is from the request to the moment when each robot is claimed by a pool. One run of 5 s
each.
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

import msgspec
import psutil

from benchmarks.figures import Figure, written
from benchmarks.figures import table as format_figures
from benchmarks.fleet_commander import BEGINNING
from benchmarks.fleet_server import line_with, program
from benchmarks.installation import Installation, run_installation
from benchmarks.ten_robots import spawn
from tests.integration.processes import eventually
from zensim.proto.messages.telemetry_messages import Info

SECONDS, SECONDS_WHEN_SHORT = 5.0, 0.5
SETTLE_S, SETTLE_WHEN_SHORT_S = 3.0, 0.2
"""Wait after all are claimed; all are commanded within one second."""
POOLS, POOL = 2, ("--pool", "0", "--cmd-vel-timeout", "0")
CLAIMED_WITHIN_S = 120.0
MEGABYTES = 1e-6
MOVES = 0.1
"""Speed above which a robot drives [m/s]; it is commanded to drive at 0.2."""
HEAD = (
    "robots",
    "physics",
    "steps [Hz]",
    "real-time factor",
    "driving",
    "server [cores]",
    "pools [cores]",
    "a robot and step [CPU us]",
    "server [MB]",
    "pools [MB]",
    "spawned and claimed [s]",
)


class Physics(msgspec.Struct, frozen=True):
    """Kind of physics, and its step rate."""

    label: str
    step_hz: float
    arguments: tuple[str, ...]


BULLET = Physics("full, PyBullet", 240.0, ("--engine", "pybullet"))
MUJOCO = Physics("full, MuJoCo", 100.0, ("--engine", "mujoco"))
AUTO = Physics("auto, PyBullet", 100.0, ("--engine", "pybullet", "--dynamics", "auto"))
KINEMATIC = Physics("kinematic", 20.0, ("--dynamics", "kinematic", "--control-hz", "20"))
FLEETS: Mapping[Physics, tuple[int, ...]] = {
    BULLET: (10, 30, 100),
    MUJOCO: (10, 100, 300, 1000),
    AUTO: (10, 100, 1000),
    KINEMATIC: (10, 100, 1000, 10_000),
}
FLEETS_WHEN_SHORT: Mapping[Physics, tuple[int, ...]] = {KINEMATIC: (2,)}


@dataclass(frozen=True)
class Fleet:
    """Measurements of a fleet."""

    robots: int
    physics: Physics
    factor: float
    driving: float
    """Share of the robots that drive at the end."""
    cores: Mapping[str, float]
    memory_mb: Mapping[str, float]
    spawned_s: float

    @property
    def step_us(self) -> float:
        """CPU time a robot and step."""
        steps_hz = self.physics.step_hz * self.factor
        return sum(self.cores.values()) / self.robots / steps_hz * 1e6


def rows(*, is_short: bool) -> Iterator[Fleet | Figure]:
    """Measure fleets of each kind of physics."""
    seconds = SECONDS_WHEN_SHORT if is_short else SECONDS
    for physics, counts in (FLEETS_WHEN_SHORT if is_short else FLEETS).items():
        for robots in counts:
            settle_s = SETTLE_WHEN_SHORT_S if is_short else SETTLE_S
            fleet = drive_fleet(physics, robots, seconds, settle_s=settle_s)
            yield fleet
            yield from _make_figures(fleet)


def _make_figures(fleet: Fleet) -> Iterator[Figure]:
    """Make the figures of a fleet that may have a limit."""
    label = f"{fleet.robots} robots, {fleet.physics.label}"
    yield Figure(what=f"{label}: real-time factor", unit="", samples=(fleet.factor,))
    yield Figure(what=f"{label}: spawned and claimed", unit="s", samples=(fleet.spawned_s,))


def table(rows_: Iterable[Fleet | Figure]) -> str:
    """Format a row for each fleet, and the figures that have a limit."""
    listed = list(rows_)
    fleets = [one for one in listed if isinstance(one, Fleet)]
    judged = [one for one in listed if isinstance(one, Figure) and one.limit is not None]
    head = f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}\n"
    body = "".join(f"| {' | '.join(_cells(fleet))} |\n" for fleet in fleets)
    return f"{head}{body}\n{format_figures(judged)}" if judged else head + body


def drive_fleet(physics: Physics, robots: int, seconds: float, *, settle_s: float) -> Fleet:
    """Run a fleet for this wall time [s], and measure it."""
    serve = ("--step-hz", f"{physics.step_hz:g}", *physics.arguments)
    with run_installation(serve, (POOL,) * POOLS, has_router=False) as crew:
        began_s = time.monotonic()
        spawn(crew.client, robots)
        eventually(lambda: ask(crew).claimed == robots, CLAIMED_WITHIN_S, "claiming")
        spawned_s = time.monotonic() - began_s
        with program("fleet_commander", crew.bus.endpoint, str(robots)) as commander:
            line_with(BEGINNING, commander)
            time.sleep(settle_s)
            factor, cores = _observe(crew, seconds)
            memory_mb = _measure_memory(crew)
            driving = _find_driving(crew) / robots
    return Fleet(robots, physics, factor, driving, cores, memory_mb, spawned_s)


def _cells(fleet: Fleet) -> tuple[str, ...]:
    return (
        str(fleet.robots),
        fleet.physics.label,
        written(fleet.physics.step_hz),
        f"{fleet.factor:.2f}",
        f"{fleet.driving:.0%}",
        *(f"{fleet.cores[group]:.2f}" for group in ("server", "agents")),
        written(fleet.step_us),
        *(f"{fleet.memory_mb[group]:.0f}" for group in ("server", "agents")),
        f"{fleet.spawned_s:.1f}",
    )


def _observe(crew: Installation, seconds: float) -> tuple[float, Mapping[str, float]]:
    """Find the real-time factor and the cores of each group."""
    began_s, before, used_s = time.monotonic(), ask(crew), crew.used_s()
    time.sleep(seconds)
    passed_s = ask(crew).sim_time_s - before.sim_time_s
    took_s = time.monotonic() - began_s
    cores = {group: (now_s - used_s[group]) / took_s for group, now_s in crew.used_s().items()}
    return passed_s / took_s, cores


def ask(crew: Installation) -> Info:
    """Ask until the server replies, which may take long when it cannot keep up."""

    def attempt() -> Info | None:
        with suppress(TimeoutError):
            return crew.client.info()
        return None

    return eventually(attempt, CLAIMED_WITHIN_S, "a reply")


def _measure_memory(crew: Installation) -> dict[str, float]:
    """Find the memory of each group that only its processes use [MB]."""
    return {
        group: sum(psutil.Process(pid).memory_full_info().uss for pid in pids) * MEGABYTES
        for group, pids in crew.pids.items()
    }


def _find_driving(crew: Installation) -> int:
    states = crew.client.entity_states().values()
    return sum(abs(state.twist.linear.x) + abs(state.twist.linear.y) > MOVES for state in states)
