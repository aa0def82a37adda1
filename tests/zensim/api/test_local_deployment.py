"""Arguments and settings that `zensim up` passes to its programs."""

import msgspec
import pytest

from zensim.api.local_deployment import (
    LaunchAgentsConfig,
    LaunchConfig,
    choose_pool_count,
    make_agent_starts,
    make_sensor_starts,
    make_serve_arguments,
)
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.robot_agent.agent_config import AgentProcessConfig, RateOverrides
from zensim.spawner.spawn.spawn_poses import RobotPlacement

DEFAULTS = LaunchConfig(
    placements=(),
    model="box_bot",
    world="w.world",
    world_name="default",
    endpoint="tcp/127.0.0.1:1",
    has_viewer=False,
    viewer_port=0,
)
COMMON = ("serve", "--listen", "tcp/127.0.0.1:1", "--world", "w.world", "--world-name", "default")
ROS = ("--ros-domain", "0")


def test_rtf_is_passed_only_if_given() -> None:
    fast = msgspec.structs.replace(DEFAULTS, real_time_factor=0.0)

    assert make_serve_arguments(DEFAULTS) == (*COMMON, *ROS)
    assert make_serve_arguments(fast) == (*COMMON, "--rtf", "0.0", *ROS)


def test_lockstep_is_passed() -> None:
    lockstep = msgspec.structs.replace(DEFAULTS, is_lockstep=True)

    assert make_serve_arguments(lockstep) == (*COMMON, "--lockstep", *ROS)


def test_engine_is_passed() -> None:
    chosen = msgspec.structs.replace(DEFAULTS, engine="mujoco")

    assert make_serve_arguments(chosen) == (*COMMON, "--engine", "mujoco", *ROS)


def test_clusters_are_passed() -> None:
    chosen = msgspec.structs.replace(DEFAULTS, clusters="on", engine_workers=0)

    options = ("--clusters", "on", "--engine-workers", "0")
    assert make_serve_arguments(chosen) == (*COMMON, *options, *ROS)


def test_model_paths_are_passed() -> None:
    config = msgspec.structs.replace(DEFAULTS, model_paths=("a", "b c"), is_strict=True)

    paths = ("--model-path", "a", "--model-path", "b c", "--strict")
    assert make_serve_arguments(config) == (*COMMON, *paths, *ROS)


def test_each_robot_has_an_agent_without_pools() -> None:
    placements = (RobotPlacement("r1", 0.0, 0.0), RobotPlacement("r2", 1.0, 0.0))
    single = msgspec.structs.replace(DEFAULTS, placements=placements)
    pooled = msgspec.structs.replace(single, agents=LaunchAgentsConfig(2, 50.0, 10.0))

    one, other = make_agent_starts(single).values()
    assert (one.config.entities, other.config.entities) == (("r1",), ("r2",))
    assert one.config.pool_limit is None
    pools = make_agent_starts(pooled).values()
    assert [pool.config.pool_limit for pool in pools] == [0, 0]
    assert {pool.config.entities for pool in pools} == {()}
    assert {pool.config.rates for pool in pools} == {RateOverrides(50.0, 10.0)}


def test_agents_get_endpoint_world_and_ros_settings() -> None:
    ros = RosSettings(domain=7, tf="global")
    config = msgspec.structs.replace(
        DEFAULTS, placements=(RobotPlacement("r1", 0.0, 0.0),), world_name="w", ros=ros
    )

    (start,) = make_agent_starts(config).values()

    assert start.endpoint == DEFAULTS.endpoint
    assert (start.config.world, start.config.ros) == ("w", ros)
    assert msgspec.json.decode(msgspec.json.encode(start), type=AgentProcessConfig) == start


@pytest.mark.parametrize(
    ("robots", "cores", "pools"), [(1, 8, 1), (500, 8, 1), (501, 8, 2), (9000, 2, 2), (0, 1, 1)]
)
def test_number_of_pools_depends_on_robots_and_cores(robots: int, cores: int, pools: int) -> None:
    assert choose_pool_count(robots, cores) == pools


def test_ros_settings_are_passed() -> None:
    hidden = msgspec.structs.replace(DEFAULTS, ros=RosSettings(domain=None))
    bridged = RosSettings(domain=7, has_hashes=False, tf="global", is_bridged=True)

    assert make_serve_arguments(hidden) == (*COMMON, "--ros-domain", "off")
    assert make_serve_arguments(msgspec.structs.replace(DEFAULTS, ros=bridged)) == (
        *COMMON,
        *("--ros-domain", "7", "--ros-distro", "humble", "--ros-bridge"),
    )


def test_sensor_processes_get_the_endpoint_and_the_world() -> None:
    config = msgspec.structs.replace(DEFAULTS, world_name="w2", sensor_processes=2)

    starts = make_sensor_starts(config).values()

    assert [(one.endpoint, one.world) for one in starts] == [("tcp/127.0.0.1:1", "w2")] * 2
    assert make_sensor_starts(DEFAULTS) == {}
