"""Runs the scenario of `zensim up FILE` in a world that runs by itself; checks only warn."""

import math
from collections.abc import Callable

from zensim.api.local_deployment import OPERATOR, LocalDeployment
from zensim.api.server_access import ServerAccess
from zensim.api.sim import Sim
from zensim.deploy.other_commands import OtherCommands
from zensim.deploy.up_driver import UpDriver
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.scenario.check_monitors import CheckResult
from zensim.scenario.scenario_reader import Scenario
from zensim.scenario.scenario_runner import ScenarioRun, find_end


class ScenarioDriver(UpDriver):
    """Spawns, drives and checks the robots of a scenario; `update` has to be called often."""

    def __init__(
        self,
        deployment: LocalDeployment,
        scenario: Scenario,
        on_failure: Callable[[CheckResult], None],
    ) -> None:
        config = deployment.config
        bus = open_bus(BusConfig(connect=(config.address_of(OPERATOR),)))
        access = ServerAccess(bus, config.network.world_name)
        self._sim = Sim(access)
        self._others = OtherCommands(bus, config.network.world_name, access.client)
        self._run = ScenarioRun(scenario, self._sim)
        self._run.spawn()
        self._end = find_end(scenario, math.inf)
        self._on_failure = on_failure
        self._failed: set[str] = set()
        self._next = -math.inf
        self._is_over = False

    def update(self) -> None:
        """Do what is due at the newest state, if there is a new one."""
        now = self._sim.time
        if self._is_over or now < self._next:
            return
        self._next = now + self._sim.control_period / 2.0
        self._run.leave(self._others.take())
        state = self._run.step()
        for monitor in self._run.monitors:
            if monitor.check.name not in self._failed and monitor.has_failed(state.now):
                self._failed.add(monitor.check.name)
                self._on_failure(monitor.report())
        self._is_over = state.now >= self._end or self._run.is_over(state)

    def ends_the_run(self) -> bool:
        """Whether the scenario is over."""
        return self._is_over

    def close(self) -> None:
        """End; the robots stop, and the recording is whole."""
        self._others.close()
        self._run.close()
        self._sim.close()
