"""Settings of `zensim up FILE`: those of the command line win over those of the file."""

from pathlib import Path

from zensim.api.local_deployment import LaunchConfig
from zensim.deploy.scenario_driver import add_scenario, list_unused_keys
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.scenario.scenario_reader import Scenario, read_scenario

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
FLAGS = LaunchConfig(world="empty", endpoint=DEFAULT_ENDPOINT, has_viewer=True, viewer_port=8080)


def scenario_of(folder: Path) -> Scenario:
    file = folder / "a.scenario.yaml"
    file.write_text(TEXT)
    return read_scenario(str(file))


def test_file_completes_the_settings(tmp_path: Path) -> None:
    config = add_scenario(FLAGS, scenario_of(tmp_path))

    assert (config.world, config.world_name, config.is_strict) == ("walls", "lab", True)
    assert (config.engine, config.clusters, config.dynamics) == ("mujoco", "off", "auto")
    assert (config.real_time_factor, config.seed, config.is_paused) == (2.0, 7, True)
    assert (config.is_lockstep, config.endpoint) == (True, "tcp/127.0.0.1:7999")
    assert (config.viewer_port, config.sensor_processes) == (9000, 2)


def test_flags_win(tmp_path: Path) -> None:
    flags = LaunchConfig(
        world="maze", endpoint="tcp/127.0.0.1:1", engine="pybullet", real_time_factor=1.0, seed=3
    )

    config = add_scenario(flags, scenario_of(tmp_path))

    assert (config.world, config.engine, config.seed) == ("maze", "pybullet", 3)
    assert (config.real_time_factor, config.endpoint) == (1.0, "tcp/127.0.0.1:1")


def test_keys_without_effect_are_listed(tmp_path: Path) -> None:
    assert list_unused_keys(scenario_of(tmp_path)) == ["engine.step_rate", "agents[0].odom_rate"]
