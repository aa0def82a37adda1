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
from zensim.proto.cli_options import RosTfOptions
from zensim.proto.endpoints import with_free_port
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import change_settings, list_settings, read_key_value
from zensim.scenario.scenario_format import AgentsSection
from zensim.scenario.scenario_reader import Scenario

Given = Mapping[str, object]
"""Options of the command line that were written, by name; they win over the file."""
KEYS_OF_OPTIONS: Mapping[str, str] = {
    "world_name": "world.name",
    "listen": "network.listen",
    "connect": "network.connect",
    "wait": "network.wait",
    "journal": "network.journal",
    "verbose": "network.verbose",
    "ros_domain": "ros.domain",
    "ros_distro": "ros.distro",
    "ros_bridge": "ros.bridge",
    "tf": "ros.tf",
    "tf_root": "ros.tf_root",
    "ros_topics": "ros.topics",
    "ros_bridge_cmd_vel": "ros.bridge_cmd_vel",
    "viewer": "viewer.show",
    "viewer_port": "viewer.port",
    "open_page": "viewer.open",
    "sensors": "sensors.processes",
    "robots": "robots[0].count",
    "model": "robots[0].model",
    "controllers": "robots[0].controllers",
    "drive": "robots[0].drive",
    "layout": "robots[0].layout.kind",
    "spacing": "robots[0].layout.spacing",
    "agents": "agents[0].processes",
    "odom_hz": "agents[0].odom_rate",
    "tf_hz": "agents[0].tf_rate",
    "behaviour": "behaviours[0].do",
    "duration": "end.at",
    **{one.name: one.setting.key for one in list_settings(ServerSettings)},
}
"""The key of each option of `zensim up` and `zensim serve`, with the first entry of lists."""
FIELDS: Mapping[str, str] = {
    "world_name": "world_name",
    "listen": "endpoint",
    "connect": "connect",
    "wait": "wait_s",
    "journal": "journal",
    "verbose": "is_verbose",
    "viewer": "has_viewer",
    "viewer_port": "viewer_port",
    "sensors": "sensor_processes",
}
"""The field of `LaunchConfig` of each option that has one of its own."""
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
ROS_OPTIONS = (
    *("ros_domain", "ros_distro", "ros_bridge", "tf", "tf_root"),
    *("ros_topics", "ros_bridge_cmd_vel"),
)
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
    found: dict[str, object] = {}
    for option, field in FIELDS.items():
        key = KEYS_OF_OPTIONS[option]
        if option in given or key not in scenario.places:
            continue
        value = scenario.find_value(key)
        if value is not NULL_MEANS_DEFAULT:
            found[field] = _convert(option, scenario, value)
    completed: LaunchConfig = msgspec.structs.replace(
        config, placements=(), model="box_bot", **found
    )
    return msgspec.structs.replace(
        completed,
        server=add_to_settings(config.server, scenario, given),
        ros=_find_ros(config.ros, scenario, given),
        agents=make_agents(scenario, given),
        keeps_inputs=config.keeps_inputs or scenario.format.record is not None,
    )


def add_to_settings(
    settings: ServerSettings, scenario: Scenario, given: Container[str] = ()
) -> ServerSettings:
    """Complete the settings of a server by what a scenario writes.

    Args:
        settings: From the command line.
        scenario: Of the file.
        given: Names of settings that win over the file.
    """
    written = {
        field.name: _convert(field.name, scenario, read_key_value(field, value))
        for field in list_settings(ServerSettings)
        if field.name not in given and field.setting.key in scenario.places
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


def _find_ros(ros: RosSettings, scenario: Scenario, given: Given) -> RosSettings:
    keys = {option: KEYS_OF_OPTIONS[option] for option in ROS_OPTIONS}
    if not any(key in scenario.places for key in keys.values()):
        return ros
    found = {option: given.get(option, scenario.find_value(key)) for option, key in keys.items()}
    texts = {option: str(value) for option, value in found.items() if not isinstance(value, bool)}
    return RosTfOptions(**texts, ros_bridge=bool(found["ros_bridge"])).ros


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
            *_find_rates(first, given),
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
            groups.append(AgentGroup(name, tuple(own[number::count]), *rates))
    return groups


def _find_rates(entry: AgentsSection, given: Given) -> tuple[float | None, float | None]:
    odom, tf = given.get("odom_hz", entry.odom_rate), given.get("tf_hz", entry.tf_rate)
    return odom, tf  # type: ignore[return-value]  # numbers of the command line
