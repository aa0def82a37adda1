"""Runs the scenario of `zensim up FILE` in a world that runs by itself; checks only warn."""

import math
from collections.abc import Callable
from typing import TypeVar

import msgspec

from zensim.api.local_deployment import LaunchConfig, LocalDeployment
from zensim.api.server_access import ServerAccess
from zensim.api.sim import Sim
from zensim.proto.bus import BusConfig, open_bus
from zensim.scenario.check_monitors import CheckResult
from zensim.scenario.scenario_reader import Scenario
from zensim.scenario.scenario_runner import ScenarioRun, find_end

Value = TypeVar("Value")


class ScenarioDriver:
    """Spawns, drives and checks the robots of a scenario; `update` has to be called often."""

    def __init__(
        self,
        deployment: LocalDeployment,
        scenario: Scenario,
        on_failure: Callable[[CheckResult], None],
    ) -> None:
        config = deployment.config
        bus = open_bus(BusConfig(connect=(config.endpoint,)))
        self._sim = Sim(ServerAccess(bus, config.world_name))
        self._run = ScenarioRun(scenario, self._sim)
        self._run.spawn()
        self._end = find_end(scenario, math.inf)
        self._on_failure = on_failure
        self._failed: set[str] = set()
        self._next = -math.inf
        self.is_over = False

    def update(self) -> None:
        """Do what is due at the newest state, if there is a new one."""
        now = self._sim.time
        if self.is_over or now < self._next:
            return
        self._next = now + self._sim.control_period / 2.0
        state = self._run.step()
        for monitor in self._run.monitors:
            if monitor.check.name not in self._failed and monitor.has_failed(state.now):
                self._failed.add(monitor.check.name)
                self._on_failure(monitor.report())
        self.is_over = state.now >= self._end or self._run.is_over(state)

    def watch(self, should_stop: Callable[[], bool]) -> Callable[[], bool]:
        """Update whenever a loop asks whether to stop; the end of the scenario stops it, too."""

        def update_and_ask() -> bool:
            self.update()
            return self.is_over or should_stop()

        return update_and_ask

    def close(self) -> None:
        """End; the robots stop."""
        self._sim.close()


def add_scenario(config: LaunchConfig, scenario: Scenario) -> LaunchConfig:
    """Complete a configuration by a scenario, whose robots are spawned later.

    Args:
        config: From the command line; what it says wins.
        scenario: Of the file.
    """
    sections = scenario.format
    world, engine = sections.world, sections.engine
    file = scenario.find_file("world.load", world.load)
    found = str(file) if file.is_file() else world.load
    paths = tuple(str(scenario.find_file("world.model_paths", one)) for one in world.model_paths)
    return msgspec.structs.replace(
        config,
        placements=(),
        model="box_bot",
        world=_choose(config.world, "empty", found),
        world_name=_choose(config.world_name, "default", world.name),
        model_paths=config.model_paths or paths,
        is_strict=config.is_strict or world.strict,
        allow_missing=config.allow_missing or world.allow_missing,
        engine=config.engine or engine.use,
        clusters=_choose(config.clusters, "auto", engine.clusters),
        engine_workers=_choose(config.engine_workers, None, engine.workers),
        dynamics=_choose(config.dynamics, "full", engine.dynamics),
        real_time_factor=_choose(config.real_time_factor, None, sections.time.speed),
        seed=config.seed or scenario.seed,
    )


def _choose(given: Value, default: Value, of_file: Value) -> Value:
    return of_file if given == default else given
