"""Settings of a deployment by a scenario file: every option of `up` and `serve` is a key."""

import os
from collections.abc import Callable, Container, Mapping, Sequence
from typing import Any

import msgspec

from zensim.api.local_deployment import (
    AgentGroup,
    LaunchAgentsConfig,
    LaunchConfig,
    choose_pool_count,
)
from zensim.proto.endpoints import with_free_port
from zensim.proto.settings.deployment_settings import DeploymentSettings, UpSettings
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.settings.setting import Group, change_settings, list_settings, read_key_value
from zensim.scenario.scenario_reader import Scenario
from zensim.scenario.setting_sections import AgentsSection

Given = Mapping[str, object]
"""Options of the command line that were written, by name; they win over the file."""
KEYS_OF_OPTIONS: Mapping[str, str] = {
    "verbose": "network.verbose",
    "robots": "robots[0].count",
    "model": "robots[0].model",
    "controllers": "robots[0].controllers",
    "drive": "robots[0].drive",
    "layout": "robots[0].layout.kind",
    "spacing": "robots[0].layout.spacing",
    "agents": "agents[0].processes",
    "behaviour": "behaviours[0].do",
    "duration": "end.at",
    **{one.name: one.setting.key for one in list_settings(UpSettings) if one.setting.key},
}
"""The key of each option of `zensim up` and `zensim serve`, with the first entry of lists."""
OF_THE_DEMO: Mapping[str, str] = {
    "robots": "--robots",
    "model": "--model",
    "controllers": "--controllers",
    "drive": "--drive",
    "layout": "--layout",
    "spacing": "--spacing",
    "behaviour": "--behaviour",
}
"""Options that describe robots without a file; with one, `--set` changes an entry by its name."""
NULL_MEANS_DEFAULT = None


def _find_world(scenario: Scenario, value: str) -> str:
    file = scenario.find_file("world.load", value)
    return str(file) if file.is_file() else value


def _find_model_paths(scenario: Scenario, value: Sequence[str]) -> tuple[str, ...]:
    return tuple(str(scenario.find_file("world.model_paths", one)) for one in value)


def _find_journal(scenario: Scenario, value: str) -> str:
    return str(scenario.find_file("network.journal", value)) if value else ""


_CONVERSIONS: Mapping[str, Callable[[Scenario, Any], object]] = {
    "world": _find_world,
    "model_paths": _find_model_paths,
    "journal": _find_journal,
    "listen": lambda _, value: with_free_port(value),
}


def _convert(name: str, scenario: Scenario, value: object) -> object:
    convert = _CONVERSIONS.get(name)
    return value if convert is None else convert(scenario, value)


def add_scenario(
    config: LaunchConfig, scenario: Scenario, given: Given | None = None
) -> LaunchConfig:
    """Complete a configuration by a scenario, whose robots are spawned later.

    Args:
        config: From the command line.
        scenario: Of the file.
        given: Options that win over the file.
    """
    given = given or {}
    completed = _complete_settings(config, scenario, given)
    recorded = {"input_log": True} if scenario.format.record is not None else {}
    is_verbose = config.is_verbose or scenario.format.network.verbose
    return msgspec.structs.replace(
        change_settings(completed, recorded),
        placements=(),
        model="box_bot",
        agents=make_agents(scenario, given),
        is_verbose=is_verbose,
    )


def _complete_settings(settings: Group, scenario: Scenario, given: Container[str] = ()) -> Group:
    """Complete settings by what a scenario writes.

    Args:
        settings: From the command line.
        scenario: Of the file.
        given: Names of settings that win over the file.
    """
    written = {
        field.name: _convert(field.name, scenario, read_key_value(field, value))
        for field in list_settings(DeploymentSettings)
        if field.setting.key and field.name not in given and field.setting.key in scenario.places
        if (value := scenario.find_value(field.setting.key)) is not NULL_MEANS_DEFAULT
    }
    return change_settings(settings, written)


def refuse_options_of_the_demo(scenario: Scenario, given: Given) -> None:
    """Refuse options that describe the robots of `zensim up` without a file.

    Raises:
        ValueError: There is one.
    """
    entry = scenario.format.robots[0].name if scenario.format.robots else "NAME"
    for option, spelling in OF_THE_DEMO.items():
        if option in given:
            key = KEYS_OF_OPTIONS[option].replace("robots[0]", f"robots.{entry}")
            raise ValueError(f"{spelling} does not apply to a scenario file; use --set {key}=VALUE")


def make_agents(scenario: Scenario, given: Given | None = None) -> LaunchAgentsConfig:
    """Choose the agents: pools for all robots, or processes for the robots of each entry."""
    entries, given = scenario.format.agents, given or {}
    driven = [
        robot.name
        for robot in scenario.robots
        if scenario.format.robots[robot.group].agent == "pool"
    ]
    if "agents" in given or not entries or _drives_all(scenario, entries, driven):
        first = entries[0] if entries else AgentsSection(name="pool")
        chosen = choose_pool_count(max(1, len(driven)), os.cpu_count() or 1)
        return LaunchAgentsConfig(
            chosen if "agents" in given or first.processes is None else first.processes,
            _find_rates(first, given),
            drives_others=True,
        )
    return LaunchAgentsConfig(
        None,
        groups=tuple(_make_groups(scenario, driven, given)),
        drives_others=bool(given.get("drive_others")),
    )


def _drives_all(
    scenario: Scenario, entries: Sequence[AgentsSection], driven: Sequence[str]
) -> bool:
    if len(entries) != 1 or not driven:
        return not driven
    return set(driven) <= set(scenario.select(entries[0].drives))


def _make_groups(scenario: Scenario, driven: Sequence[str], given: Given) -> list[AgentGroup]:
    """Share the robots among entries, the first that names one; the rest has an agent, too."""
    left, groups = list(driven), []
    for entry in (*scenario.format.agents, AgentsSection(name="others")):
        own = [name for name in scenario.select(entry.drives) if name in left]
        left = [name for name in left if name not in own]
        count = min(entry.processes or 1, len(own))
        for number in range(count):
            name = entry.name if count == 1 else f"{entry.name} {number}"
            rates = _find_rates(entry, given)
            groups.append(AgentGroup(name, tuple(own[number::count]), rates))
    return groups


def _find_rates(entry: AgentsSection, given: Given) -> RateOverrides:
    rates = RateOverrides(entry.odom_rate, entry.tf_rate)
    return change_settings(rates, given)
