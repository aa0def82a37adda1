"""Worlds whose inputs are logged, and random inputs for them."""

import random
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tests.models import a_box, a_box_bot, a_state, box_bot_at
from tests.sim_server.fakes import WallTime, a_spawn, make_parts
from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.settings.engine_settings import Clustering, EngineSettings, WorldDynamics
from zensim.proto.settings.pace_settings import PaceSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.input_log.log_writer import InputLog
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.physics.logged_engine import LoggedEngine
from zensim.sim_server.server_config import ServerConfig
from zensim.sim_server.service_parts import CurrentWorld
from zensim.sim_server.world.applied_forces import LinkWrench, TimeSpan
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world_loading.world_loader import make_world_engine

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.proto.messages.input_messages import Inputs

STEP_HZ, CONTROL_STEPS = 240.0, 4
STEPS_PER_S = round(STEP_HZ)
AGENT = "pool"
ROBOT, BOX = a_box_bot(), a_box()
SPREAD_M = 1.2
"""Half the side of the square that robots share, so that they collide."""


class LoggedWorld:
    """A world whose inputs are logged, from the start or from a subscription on."""

    def __init__(
        self,
        engine: EngineName,
        *,
        is_fresh: bool = True,
        clusters: Clustering = "auto",
        dynamics: WorldDynamics = "full",
    ) -> None:
        self.engine: EngineName = engine
        options = EngineSettings(
            engine=engine, engine_workers=0, clusters=clusters, dynamics=dynamics
        )
        pace = PaceSettings(step_hz=STEP_HZ, control_hz=STEP_HZ / CONTROL_STEPS)
        config = ServerConfig(settings=ServerSettings(physics=options, pace=pace))
        model = WorldModel("empty", ground_plane=True)
        self.store = AssetStore()
        made = make_world_engine(config, model, self.store.folder)
        self.world = SimulatedWorld(
            LoggedEngine(made) if is_fresh else made,
            name="default",
            step_ns=config.step_ns,
            control_steps=config.control_steps,
        )
        current = CurrentWorld(model, physics=options)
        parts = make_parts(self.world, WallTime())
        parts = replace(parts, current_world=current, store=self.store)
        self.messages: list[Inputs] = []
        self.is_wanted = True
        self.log = InputLog(parts, lambda: self.is_wanted, self.messages.append)
        self._now_ns = 0

    def poll(self) -> None:
        self._now_ns += 1_000_000_000
        self.log.poll(self._now_ns)

    def spawn_robots(self, count: int) -> None:
        """Spawn robots on a line, driven by one agent."""
        for number in range(count):
            place = box_bot_at(0.5 * number - SPREAD_M, 0.0)
            self.world.spawn(a_spawn(f"r{number}", f"r{number}", model=ROBOT, base=place))
        self.claim()

    def claim(self) -> None:
        names = [one.name for one in self.world.entities if one.model.drive is not None]
        free = tuple(name for name in names if not self.world.claims.agent_of(name))
        if free:
            self.world.claim(AGENT, free, "stop")

    def drive(self, *speeds: float) -> None:
        """Command the wheels of all robots; the speeds repeat."""
        claimed = self.world.claimed_by_agent()[AGENT]
        numbers = np.resize(np.array(speeds, dtype="<f8"), 2 * len(claimed.bodies))
        clock = self.world.clock
        command = DriveCommand(clock.epoch, clock.steps, claimed.claims, numbers.tobytes())
        assert self.world.command(AGENT, command)

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self.world.step()
            if self.world.is_control_step and self.log.is_active:
                self.log.note_control_step()
                self.poll()


class RandomInputs:
    """Spawns, deletes, moves, pushes and drives at random instants."""

    def __init__(self, logged: LoggedWorld, seed: int) -> None:
        self._logged = logged
        self._draws = random.Random(seed)
        self._spawned = 0
        self._actions: tuple[tuple[float, Callable[[], None]], ...] = (
            (0.20, self._drive),
            (0.01, self._spawn_box),
            (0.004, self._spawn_robot),
            (0.008, self._delete),
            (0.008, self._place),
            (0.01, self._push),
        )

    def run(self, steps: int) -> None:
        for _ in range(steps):
            for chance, act in self._actions:
                if self._draws.random() < chance:
                    act()
            self._logged.step(1)

    def _somewhere(self) -> tuple[float, float]:
        return self._draws.uniform(-SPREAD_M, SPREAD_M), self._draws.uniform(-SPREAD_M, SPREAD_M)

    def _drive(self) -> None:
        self._logged.drive(*(self._draws.uniform(-12.0, 20.0) for _ in range(14)))

    def _spawn_box(self) -> None:
        self._spawned += 1
        base = a_state((*self._somewhere(), self._draws.uniform(0.2, 0.8)))
        self._logged.world.spawn_and_find_overlaps(
            a_spawn(f"box{self._spawned}", model=BOX, base=base)
        )

    def _spawn_robot(self) -> None:
        self._spawned += 1
        name = f"extra{self._spawned}"
        base = box_bot_at(*self._somewhere(), self._draws.uniform(-3.0, 3.0))
        self._logged.world.spawn(a_spawn(name, name, model=ROBOT, base=base))
        self._logged.claim()

    def _delete(self) -> None:
        names = [one.name for one in self._logged.world.entities if not one.name.startswith("r")]
        if names:
            self._logged.world.delete(self._draws.choice(names))

    def _place(self) -> None:
        name = self._draws.choice([one.name for one in self._logged.world.entities])
        self._logged.world.place(name, a_state((*self._somewhere(), 0.1)))

    def _push(self) -> None:
        name = self._draws.choice([one.name for one in self._logged.world.entities])
        wrench = np.array([self._draws.uniform(-20.0, 20.0), 0.0, 5.0, 0.0, 0.0, 0.1])
        world = self._logged.world
        end_ns = world.clock.time_ns + self._draws.randrange(200_000_000)
        span = TimeSpan(world.clock.time_ns, end_ns)
        world.applied_forces.add(LinkWrench(name, 0, wrench, span))
