"""Input log and resimulation

Runs: `zensim serve --input-log` with six colliding robots in free running, and commands, spawns,
deletes and poses over the network at random instants for a minute of wall time, two servers at a
time; then each log is run again as by `zensim resim`, and must have equal states at every control
step; and again up to the next second after one byte of one command was changed, which must be found
where it acts. Cost: the engine of a world with driven box_bots and one pool's commands, in turns
with and without a subscriber of the log, CPU time of this process; and what the log costs a turn of
the loop without a subscriber.
"""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.bodies import standing_at
from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import SPACING_M
from tests.integration.random_runs import (
    STEPS_PER_S,
    RandomRun,
    find_change,
    make_random_run,
)
from tests.sim_server.fakes import WallTime, a_spawn, make_parts
from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.input_log.log_writer import PERIOD_NS, InputLog
from zensim.sim_server.input_log.resimulation import ResimChanges, ResimResult, Resimulation
from zensim.sim_server.server_config import ServerConfig
from zensim.sim_server.service_parts import CurrentWorld
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world_loading.world_loader import make_world_engine
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

if TYPE_CHECKING:
    from zensim.proto.messages.input_messages import Inputs

__all__ = ["rows", "table"]

ENGINES: tuple[EngineName, ...] = ("pybullet", "mujoco")
RUNS, SECONDS = 10, 60.0
RUNS_AT_ONCE = 2
RUNS_WHEN_SHORT, SECONDS_WHEN_SHORT = 1, 1.0
ROBOTS, ROBOTS_WHEN_SHORT = 100, 2
PAIRS, PAIRS_WHEN_SHORT = 7, 2
TURN_STEPS, TURN_STEPS_WHEN_SHORT = 240, 24
POLLS = 100_000
STEP_S = 1 / 240
EQUAL = Limit("min", ">=", 1.0)
RECORDED = Limit("median", "<=", 1.03, is_timed=True)
IDLE = Limit("median", "<=", 0.001 * STEP_S * 1e6, is_timed=True)
"""A thousandth of a step."""


class DrivenFleet:
    """A world with robots that one pool drives, and its log."""

    def __init__(self, engine: EngineName, robots: int) -> None:
        options = EngineSettings(engine=engine, engine_workers=0)
        config = ServerConfig(settings=ServerSettings(physics=options))
        model = WorldModel("empty", ground_plane=True)
        self.world = SimulatedWorld(
            make_world_engine(config, model, ""),
            name="default",
            step_ns=config.step_ns,
            control_steps=config.control_steps,
        )
        self.messages: list[Inputs] = []
        self.is_wanted = False
        parts = make_parts(self.world, WallTime())
        parts = replace(parts, current_world=CurrentWorld(model, physics=options))
        self.log = InputLog(parts, lambda: self.is_wanted, self.messages.append)
        self._now_ns = 0
        self._draws = np.random.default_rng(7)
        box_bot = read_urdf(read_builtin_model("box_bot"))
        for place in make_fleet_layout("box_bot", robots, "grid", SPACING_M):
            base = standing_at(place.x)
            base[1] = place.y
            self.world.spawn(a_spawn(place.name, place.name, model=box_bot, base=base))
        self.world.claim("pool", tuple(self.world.entities.index.names), "stop")

    def turn(self, steps: int, *, is_wanted: bool) -> float:
        """Make steps with a command at each control step; return CPU time [s]."""
        self.is_wanted = is_wanted
        self._poll()
        began_s = time.process_time()
        for _ in range(steps):
            if self.world.is_control_step:
                self._command()
            self.world.step()
            if self.world.is_control_step:
                self.world.states()
                if self.log.is_active:
                    self.log.note_control_step()
                self._poll()
        return time.process_time() - began_s

    def _command(self) -> None:
        claimed = self.world.claimed_by_agent()["pool"]
        targets = 5.0 + self._draws.random(2 * len(claimed.bodies))
        clock = self.world.clock
        command = DriveCommand(clock.epoch, clock.steps, claimed.claims, targets.tobytes())
        self.world.command("pool", command)

    def _poll(self) -> None:
        self._now_ns += PERIOD_NS
        self.log.poll(self._now_ns)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure what the log costs, and repeat recorded runs."""
    yield from _cost_figures(is_short=is_short)
    runs, seconds = (RUNS_WHEN_SHORT, SECONDS_WHEN_SHORT) if is_short else (RUNS, SECONDS)
    for engine in ENGINES:
        yield from _run_figures(engine, runs, seconds)


def _cost_figures(*, is_short: bool) -> Iterator[Figure]:
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    steps = TURN_STEPS_WHEN_SHORT if is_short else TURN_STEPS
    for engine in ENGINES:
        fleet = DrivenFleet(engine, robots)
        fleet.turn(steps, is_wanted=False)
        ratios, sizes = [], []
        for _ in range(PAIRS_WHEN_SHORT if is_short else PAIRS):
            plain_s = fleet.turn(steps, is_wanted=False)
            fleet.messages.clear()
            ratios.append(fleet.turn(steps, is_wanted=True) / plain_s)
            sizes.append(sum(len(one.records) for one in fleet.messages) / (steps * STEP_S) * 1e-6)
        what = f"{engine}, {robots} robots"
        yield Figure(what=f"{what}: recorded / not", unit="", samples=tuple(ratios), limit=RECORDED)
        yield Figure(what=f"{what}: log a second", unit="MB", samples=tuple(sizes))
        fleet.turn(steps, is_wanted=False)
        yield Figure(
            what=f"{what}: no subscriber, a turn of the loop",
            unit="us",
            samples=tuple(_time_idle(fleet.log) for _ in range(3)),
            limit=IDLE,
        )
        fleet.world.close()


def _time_idle(log: InputLog) -> float:
    began_s = time.process_time()
    for now_ns in range(POLLS):
        if log.is_active:
            log.note_control_step()
        log.poll(now_ns)
    return (time.process_time() - began_s) * 1e6 / POLLS


def _run_figures(engine: EngineName, runs: int, seconds: float) -> Iterator[Figure]:
    shares, counts, speeds, found = [], [], [], []
    for run in _make_runs(engine, runs, seconds):
        counts.append(float(run.inputs))
        began_s = time.perf_counter()
        result = _run_again(run.messages)
        speeds.append(result.simulated_s / (time.perf_counter() - began_s))
        shares.append(float(result.is_exact and result.is_equal))
        found.append(_is_change_found(run.messages))
    yield Figure(what=f"{engine}, run is equal", unit="", samples=tuple(shares), limit=EQUAL)
    what = f"{engine}, changed byte of a command is found in its second"
    yield Figure(what=what, unit="", samples=tuple(found), limit=EQUAL)
    yield Figure(what=f"{engine}, inputs of a run", unit="", samples=tuple(counts))
    yield Figure(
        what=f"{engine}, resimulated seconds in a second",
        unit="",
        samples=tuple(speeds),
    )


def _make_runs(engine: EngineName, runs: int, seconds: float) -> Iterator[RandomRun]:
    def make(seed: int) -> RandomRun:
        return make_random_run(engine, seconds=seconds, seed=seed)

    with ThreadPoolExecutor(RUNS_AT_ONCE) as executor:
        for first in range(0, runs, RUNS_AT_ONCE):
            # All of them, so that none goes on while logs are run again.
            yield from list(executor.map(make, range(first, min(first + RUNS_AT_ONCE, runs))))


def _run_again(messages: Sequence["Inputs"]) -> ResimResult:
    with TemporaryDirectory() as folder:
        again = Resimulation(Path(folder), ResimChanges())
        for message in messages:
            again.feed(message)
        return again.finish()


def _is_change_found(messages: Sequence["Inputs"]) -> float:
    """Whether a changed byte of a command is found within a second."""
    try:
        step, found = find_change(messages, _find_difference)
    except LookupError:
        return 0.0
    return float(step <= found <= step + STEPS_PER_S)


def _find_difference(messages: Sequence["Inputs"]) -> int | None:
    first = _run_again(messages).first_difference
    return None if first is None else first.step
