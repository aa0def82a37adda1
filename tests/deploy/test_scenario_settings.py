"""Settings of `zensim up FILE`: every option is a key, and what is written wins over the file."""

from dataclasses import fields
from pathlib import Path

import pytest
from msgspec import inspect

from zensim.api.local_deployment import LaunchConfig, make_agent_starts, make_serve_arguments
from zensim.deploy.cli.serve_commands import ServeOptions
from zensim.deploy.cli.up_commands import UpOptions
from zensim.deploy.scenario_settings import (
    KEYS_OF_OPTIONS,
    add_scenario,
    refuse_options_of_the_demo,
)
from zensim.proto.settings.deployment_settings import UpSettings, ViewerSettings
from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import is_settings, list_settings, make_settings
from zensim.scenario.scenario_format import ScenarioFormat
from zensim.scenario.scenario_reader import Scenario, read_scenario
from zensim.scenario.setting_sections import AgentsSection
from zensim.scenario.typed_reading import find_type

TEXT = """
zensim: 1
world: {load: walls, name: lab, strict: true}
engine: {use: mujoco, clusters: "off", dynamics: auto, step_rate: 480 Hz}
time: {mode: lockstep, speed: 2, seed: 7, paused: true}
network: {listen: tcp/127.0.0.1:7999}
viewer: {port: 9000}
sensors: {processes: 2}
agents: [{name: pool, odom_rate: 20 Hz}]
"""
FLAGS = LaunchConfig(viewer=ViewerSettings())


def scenario_of(folder: Path) -> Scenario:
    file = folder / "a.scenario.yaml"
    file.write_text(TEXT)
    return read_scenario(str(file))


def test_file_completes_the_settings(tmp_path: Path) -> None:
    config = add_scenario(FLAGS, scenario_of(tmp_path))

    start = config.server.start
    assert (start.world, config.network.world_name, start.strict) == ("walls", "lab", True)
    physics = config.server.physics
    assert (physics.engine, physics.clusters, physics.dynamics) == ("mujoco", "off", "auto")
    assert (config.server.pace.rtf, start.seed, start.paused) == (2.0, 7, True)
    assert (config.server.lockstep.lockstep, config.endpoint) == (True, "tcp/127.0.0.1:7999")
    assert (config.viewer.viewer_port, config.programs.sensors) == (9000, 2)


def test_flags_win(tmp_path: Path) -> None:
    server = make_settings(ServerSettings, {"engine": "pybullet", "rtf": 1.0, "seed": 3})
    flags = LaunchConfig(network=NetworkSettings(listen="tcp/127.0.0.1:1"), server=server)
    given = {"world": "empty", "listen": "", "engine": "", "rtf": 1.0, "seed": 3, "odom_hz": 5.0}

    config = add_scenario(flags, scenario_of(tmp_path), given)

    start = config.server.start
    assert (start.world, config.server.physics.engine, start.seed) == ("empty", "pybullet", 3)
    assert (config.server.pace.rtf, config.endpoint) == (1.0, "tcp/127.0.0.1:1")
    assert config.agents.rates.odom_hz == 5.0


def list_keys(kind: type, path: str) -> list[str]:
    fields = [field.encode_name for field in inspect.type_info(kind).fields]  # type: ignore[attr-defined]
    return [f"{path}.{name}" for name in fields]


def test_every_option_of_up_and_serve_is_a_key() -> None:
    named = {one.name: one.type for kind in (UpOptions, ServeOptions) for one in fields(kind)}
    options = {name for name, kind in named.items() if not is_settings(kind)}
    options |= {one.name for one in list_settings(UpSettings)}

    not_of_files = {"file", "settings", "as_json", "announce", "input_log"}
    not_of_files |= {"record"}  # the section of this name has more than a path
    # Who is admitted is decided where the program runs, never by a file that somebody sent.
    not_of_files |= {"secure", "client_certificates", "insecure", "mesh_http", "page_role"}
    not_of_files |= {"metrics", "metrics_insecure"}
    # A scenario says who drives its robots; others come from outside of it.
    not_of_files |= {"drive_others"}
    assert options - set(KEYS_OF_OPTIONS) == not_of_files
    assert set(KEYS_OF_OPTIONS) - options == {"verbose"}
    for key in set(KEYS_OF_OPTIONS.values()) - {"behaviours[0].do"}:
        assert find_type(ScenarioFormat, key.replace("[", ".").replace("]", "").split(".")), key


def test_every_key_of_the_programs_is_an_option() -> None:
    programs = ("world", "engine", "time", "network", "ros", "viewer", "sensors")
    keys = {key for name in programs for key in list_keys(type(getattr(EMPTY, name)), name)} | set(
        list_keys(AgentsSection, "agents[0]")
    )

    assert keys - set(KEYS_OF_OPTIONS.values()) == {"agents[0].name", "agents[0].drives"}


EMPTY = ScenarioFormat(zensim=1)
SAMPLES = {
    "world.load": "walls",
    "world.name": "lab",
    "world.model_paths": "[models]",
    "world.strict": "true",
    "world.allow_missing": "true",
    "engine.use": "mujoco",
    "engine.step_rate": "480 Hz",
    "engine.control_rate": "50 Hz",
    "engine.dynamics": "auto",
    "engine.clusters": "'off'",
    "engine.workers": "0",
    "engine.allow_failed": "true",
    "time.mode": "lockstep",
    "time.speed": "2",
    "time.seed": "7",
    "time.on_miss": "fail",
    "time.miss_timeout": "3 s",
    "time.paused": "true",
    "network.listen": "tcp/127.0.0.1:7999",
    "network.connect": "tcp/127.0.0.1:7998",
    "network.wait": "5 s",
    "network.journal": "journal",
    "network.verbose": "true",
    "ros.domain": "'5'",
    "ros.distro": "humble",
    "ros.bridge": "true",
    "ros.tf": "global",
    "ros.tf_root": "earth",
    "ros.topics": "'odom,tf'",
    "ros.bridge_cmd_vel": "twist_stamped",
    "viewer.show": "false",
    "viewer.port": "9000",
    "sensors.processes": "2",
    "agents[0].processes": "2",
    "agents[0].odom_rate": "20 Hz",
    "agents[0].tf_rate": "5 Hz",
}
OF_THE_SERVER = ("world", "engine", "time", "network")


def test_samples_are_complete() -> None:
    elsewhere = {"viewer.open", "end.at"}

    wanted = {key for key in KEYS_OF_OPTIONS.values() if not key.startswith(("robots", "behav"))}
    assert wanted - SAMPLES.keys() == elsewhere


@pytest.mark.parametrize("key", SAMPLES)
def test_key_has_an_effect(key: str, tmp_path: Path) -> None:
    section, name = key.replace("[0]", "").split(".")
    entry = f"[{{name: pool, {name}: {SAMPLES[key]}}}]"
    value = entry if section == "agents" else f"{{{name}: {SAMPLES[key]}}}"
    file = tmp_path / "a.scenario.yaml"
    file.write_text(f"zensim: 1\nrobots: [{{name: r, model: box_bot}}]\n{section}: {value}\n")
    plain = tmp_path / "plain.scenario.yaml"
    plain.write_text("zensim: 1\nrobots: [{name: r, model: box_bot}]\n")

    config, without = (add_scenario(FLAGS, read_scenario(str(one))) for one in (file, plain))

    assert config != without
    if section in OF_THE_SERVER:
        assert make_serve_arguments(config) != make_serve_arguments(without)
    if section == "agents":
        assert make_agent_starts(config) != make_agent_starts(without)


def test_entries_of_agents_are_processes_of_their_own(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text(
        "zensim: 1\nrobots: [{name: r, model: box_bot, count: 5}]\n"
        "agents:\n  - {name: left, drives: 'r[0-1]', odom_rate: 5 Hz}\n"
        "  - {name: right, drives: 'r[2-3]', processes: 2}\n"
    )

    starts = make_agent_starts(add_scenario(FLAGS, read_scenario(str(file))))

    assert {name: one.config.entities for name, one in starts.items()} == {
        "agent left": ("r0", "r1"),
        "agent right 0": ("r2",),
        "agent right 1": ("r3",),
        "agent others": ("r4",),
    }
    assert starts["agent left"].config.rates.odom_hz == 5.0


def test_options_of_the_demo_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="--set"):
        refuse_options_of_the_demo(scenario_of(tmp_path), {"robots": 5})
