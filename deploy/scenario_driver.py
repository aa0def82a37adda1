"""Runs the scenario of `zensim up FILE` in a world that runs by itself; checks only warn."""

import math
from collections.abc import Callable
from typing import TypeVar

import msgspec

from zensim.api.local_deployment import LaunchConfig, LocalDeployment
from zensim.api.server_access import ServerAccess
from zensim.api.sim import Sim
from zensim.proto.bus import BusConfig, open_bus
from zensim.proto.endpoints import DEFAULT_ENDPOINT, with_free_port
from zensim.proto.ros2.ros_settings import RosSettings, parse_ros_settings
from zensim.scenario.check_monitors import CheckResult
from zensim.scenario.scenario_format import RosSection
from zensim.scenario.scenario_reader import Scenario
from zensim.scenario.scenario_runner import ScenarioRun, find_end

Value = TypeVar("Value")
DEFAULT_PAGE_PORT = 8080
UNUSED_KEYS = (
    *("engine.step_rate", "engine.control_rate", "time.on_miss", "time.miss_timeout"),
    *("network.connect", "network.wait", "network.journal", "network.verbose"),
    *("record", "vary"),
)
"""Keys that are checked, but have no effect on `zensim up`."""
UNUSED_AGENT_KEYS = ("processes", "odom_rate", "tf_rate")
"""The same of entries of `agents`: pools share all robots here."""


class ScenarioDriver:
    """Spawns, drives and checks the robots of a scenario; `update` has to be called often."""

    def __init__(
        self,
        deployment: LocalDeployment,
        scenario: Scenario,
        on_failure: Callable[[CheckResult], None],
    ) -> None:
        config = deployment.config
        bus = open_bus(BusConfig(connect=(config.client_endpoint,)))
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
        """Update whenever a loop checks whether to stop; the end of the scenario stops it, too."""

        def update_and_check() -> bool:
            self.update()
            return self.is_over or should_stop()

        return update_and_check

    def close(self) -> None:
        """End; the robots stop."""
        self._sim.close()


def add_scenario(config: LaunchConfig, scenario: Scenario) -> LaunchConfig:
    """Complete a configuration by a scenario, whose robots are spawned later.

    Args:
        config: From the command line; what it says wins.
        scenario: Of the file.
    """
    config = msgspec.structs.replace(config, placements=(), model="box_bot")
    return _add_programs(_add_time(_add_world(config, scenario), scenario), scenario)


def _add_world(config: LaunchConfig, scenario: Scenario) -> LaunchConfig:
    world, engine = scenario.format.world, scenario.format.engine
    file = scenario.find_file("world.load", world.load)
    found = str(file) if file.is_file() else world.load
    paths = tuple(str(scenario.find_file("world.model_paths", one)) for one in world.model_paths)
    return msgspec.structs.replace(
        config,
        world=_choose(config.world, "empty", found),
        world_name=_choose(config.world_name, "default", world.name),
        model_paths=config.model_paths or paths,
        is_strict=config.is_strict or world.strict,
        allow_missing=config.allow_missing or world.allow_missing,
        engine=config.engine or engine.use,
        clusters=_choose(config.clusters, "auto", engine.clusters),
        engine_workers=_choose(config.engine_workers, None, engine.workers),
        dynamics=_choose(config.dynamics, "full", engine.dynamics),
    )


def _add_time(config: LaunchConfig, scenario: Scenario) -> LaunchConfig:
    time = scenario.format.time
    # Lockstep is the default of files, since tests need it; here it has to be written.
    is_lockstep = "time.mode" in scenario.places and time.mode == "lockstep"
    return msgspec.structs.replace(
        config,
        real_time_factor=_choose(config.real_time_factor, None, time.speed),
        seed=config.seed or scenario.seed,
        is_paused=config.is_paused or time.paused,
        is_lockstep=config.is_lockstep or is_lockstep,
    )


def _add_programs(config: LaunchConfig, scenario: Scenario) -> LaunchConfig:
    sections, places = scenario.format, scenario.places
    processes = sections.sensors.processes if "sensors.processes" in places else None
    return msgspec.structs.replace(
        config,
        endpoint=_choose_endpoint(config.endpoint, sections.network.listen),
        has_viewer=config.has_viewer and sections.viewer.show,
        viewer_port=_choose(config.viewer_port, DEFAULT_PAGE_PORT, sections.viewer.port),
        sensor_processes=_choose(config.sensor_processes, None, processes),
        ros=_read_ros(sections.ros) if "ros" in places else config.ros,
    )


def list_unused_keys(scenario: Scenario) -> list[str]:
    """List the keys of the file that have no effect on `zensim up`."""
    agents = (
        f"agents[{index}].{key}"
        for index in range(len(scenario.format.agents))
        for key in UNUSED_AGENT_KEYS
    )
    return [key for key in (*UNUSED_KEYS, *agents) if key in scenario.places]


def _choose_endpoint(given: str, of_file: str) -> str:
    return with_free_port(of_file) if of_file and given == DEFAULT_ENDPOINT else given


def _read_ros(section: RosSection) -> RosSettings:
    return parse_ros_settings(
        section.domain, section.distro, section.tf, section.tf_root, is_bridged=section.bridge
    )


def _choose(given: Value, default: Value, of_file: Value) -> Value:
    return of_file if given == default else given
