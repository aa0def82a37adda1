"""Fleets as fast as possible

Box_bots drive circles in one world: in a real server at `--rtf 0`, whose drive states another
process answers and whose snapshots it receives, and in a plain PyBullet loop with the best
settings, driven and read at the same control periods, without a network (the floor). The two take
turns. CPU is that of the loop thread, and of the processes that step the cells of a large world;
`floor / served` compares it turn by turn: the engine's share. The best settings are 10 solver
iterations; a stopped robot then rocks a little, so the server allows 20, and the floor is measured
with these too. As fast as possible, a server publishes states at most every 2 ms of wall time.
"""

import statistics
from collections.abc import Iterator

import msgspec

from benchmarks.bodies import CONFIG
from benchmarks.figures import Figure, table
from benchmarks.fleet_server import FleetServer, Spent, run_fleet_server
from benchmarks.pybullet_floor import PlainLoop, Turn
from benchmarks.ten_robots import CIRCLE, MILLISECONDS
from zensim.proto.settings.pace_settings import CONTROL_HZ, PaceSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.sim_server.server_config import ServerConfig

__all__ = ["rows", "table"]

TURN_S, LONG_TURN_S, TURN_WHEN_SHORT_S = 0.3, 2.0, 0.1
TURNS, LONG_TURNS, TURNS_WHEN_SHORT = 15, 4, 3
"""Many short turns, so that other load affects both sides equally."""
LONG_FROM = 500
"""Number of robots from which turns are longer."""
BEGIN_S = 0.6
TRIES = 5
MOVES = 0.5
"""Share of the commanded speed below which a robot does not count as driving."""
GROWTH_FROM, GROWTH_TO = 100, 1000


class Case(msgspec.Struct, frozen=True):
    """A number of robots and a rate of drive states."""

    robots: int
    control_hz: float = CONTROL_HZ

    @property
    def config(self) -> ServerConfig:
        """Configuration of its server."""
        pace = PaceSettings(control_hz=self.control_hz)
        return msgspec.structs.replace(CONFIG, settings=ServerSettings(pace=pace))

    @property
    def label(self) -> str:
        """Label in the figures."""
        robots = "1 robot" if self.robots == 1 else f"{self.robots} robots"
        is_usual = self.control_hz == CONTROL_HZ
        return robots if is_usual else f"{robots}, states at {self.control_hz:g} Hz"


CASES = (
    *(Case(count) for count in (1, 10, 50, 100)),
    Case(100, control_hz=50.0),
    *(Case(count) for count in (200, 500, 1000)),
)
CASES_WHEN_SHORT = (Case(2),)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure fleets of several sizes, and the growth of the cost per robot."""
    costs: dict[int, float] = {}
    for case in CASES_WHEN_SHORT if is_short else CASES:
        turns = _taken_in_turn(case, is_short=is_short)
        cost = statistics.median(_cpu_ms(turn) for turn in turns.run_fleet_server) / case.robots
        costs.setdefault(case.robots, cost)
        yield from _figures(case, turns)
    if GROWTH_TO in costs:
        yield Figure(
            what=f"CPU a robot and step, {GROWTH_TO} robots / {GROWTH_FROM} robots",
            unit="",
            samples=(costs[GROWTH_TO] / costs[GROWTH_FROM],),
        )


class Turns(msgspec.Struct, frozen=True):
    """Measurements of one size; the first three in turns."""

    run_fleet_server: list[Spent]
    floor: list[Turn]
    alike: list[Turn]
    """Floor with the server's settings."""


def _taken_in_turn(case: Case, *, is_short: bool) -> Turns:
    count, config = case.robots, case.config
    turn_s, turns = (LONG_TURN_S, LONG_TURNS) if count >= LONG_FROM else (TURN_S, TURNS)
    if is_short:
        turn_s, turns = TURN_WHEN_SHORT_S, TURNS_WHEN_SHORT
    found = Turns([], [], [])
    with run_fleet_server(count, "--control-hz", f"{case.control_hz:g}") as server:
        plain = PlainLoop(count, step_ns=config.step_ns, control_steps=config.control_steps)
        try:
            begin(server, count)
            begin(plain, count)
            for _ in range(turns):
                found.run_fleet_server.append(server.turn(turn_s))
                found.floor.append(plain.turn(turn_s))
                found.alike.append(plain.turn_as_served(turn_s))
        finally:
            plain.close()
    return found


def begin(loop: FleetServer | PlainLoop, count: int) -> None:
    """Advance until all robots drive.

    Raises:
        RuntimeError: Some robots do not drive.
    """
    for _ in range(TRIES):
        loop.turn(BEGIN_S)
        driving = sum(speed > MOVES * CIRCLE[0] for speed in loop.speeds())
        if driving == count:
            return
    raise RuntimeError(f"{driving} of {count} robots drive, in {type(loop).__name__}")


def _figures(case: Case, turns: Turns) -> Iterator[Figure]:
    label, step_s = case.label, CONFIG.step_ns * 1e-9
    each: dict[str, list[Turn]] = {"served": [*turns.run_fleet_server], "floor": turns.floor}
    for what, some in each.items():
        factors = tuple(turn.steps * step_s / turn.wall_s for turn in some)
        yield Figure(what=f"{label}, {what}: real-time factor", unit="", samples=factors)
        costs = tuple(_cpu_ms(turn) for turn in some)
        yield Figure(what=f"{label}, {what}: a step", unit="CPU ms", samples=costs)
    network = tuple(
        (turn.process_cpu_s - turn.cpu_s) / turn.steps * MILLISECONDS
        for turn in turns.run_fleet_server
    )
    yield Figure(what=f"{label}, served: a step, other threads", unit="CPU ms", samples=network)
    yield Figure(
        what=f"{label}: floor / served",
        unit="",
        samples=_shares(turns.floor, turns.run_fleet_server),
    )
    shares = _shares(turns.alike, turns.run_fleet_server)
    yield Figure(
        what=f"{label}: floor with the server's settings / served", unit="", samples=shares
    )


def _shares(floors: list[Turn], turns: list[Spent]) -> tuple[float, ...]:
    return tuple(_cpu_ms(floor) / _cpu_ms(turn) for turn, floor in zip(turns, floors, strict=True))


def _cpu_ms(turn: Turn) -> float:
    workers_s = turn.children_cpu_s if isinstance(turn, Spent) else 0.0
    return (turn.cpu_s + workers_s) / turn.steps * MILLISECONDS
