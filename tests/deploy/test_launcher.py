"""`zensim up` tells its server what it was told itself, and nothing else."""

import msgspec
import pytest

from zensim.deploy.launcher import (
    LaunchAgentsConfig,
    LaunchConfig,
    choose_pool_count,
    make_agent_starts,
    make_serve_arguments,
)
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.robot_agent.agent_config import AgentProcessConfig, RateOverrides
from zensim.spawner.spawn.spawn_poses import RobotPlacement

PLAIN = LaunchConfig(
    placements=(),
    model="box_bot",
    world="w.world",
    world_name="default",
    endpoint="tcp/127.0.0.1:1",
    has_viewer=False,
    viewer_port=0,
)
JOINING = ("serve", "--listen", "tcp/127.0.0.1:1", "--world", "w.world", "--world-name", "default")
ROS = ("--ros-domain", "0")


def test_pace_is_left_to_the_world_unless_asked_for() -> None:
    hasty = msgspec.structs.replace(PLAIN, real_time_factor=0.0)

    assert make_serve_arguments(PLAIN) == (*JOINING, *ROS)
    assert make_serve_arguments(hasty) == (*JOINING, "--rtf", "0.0", *ROS)


def test_server_waits_for_agents_when_told_to() -> None:
    locked = msgspec.structs.replace(PLAIN, is_lockstep=True)

    assert make_serve_arguments(locked) == (*JOINING, "--lockstep", *ROS)


def test_server_has_the_engine_that_is_asked_for() -> None:
    chosen = msgspec.structs.replace(PLAIN, engine="mujoco")

    assert make_serve_arguments(chosen) == (*JOINING, "--engine", "mujoco", *ROS)


def test_server_steps_clusters_as_it_is_told_to() -> None:
    chosen = msgspec.structs.replace(PLAIN, clusters="on", engine_workers=0)

    asked = ("--clusters", "on", "--engine-workers", "0")
    assert make_serve_arguments(chosen) == (*JOINING, *asked, *ROS)


def test_server_looks_where_it_is_told_to() -> None:
    config = msgspec.structs.replace(PLAIN, model_paths=("a", "b c"), is_strict=True)

    paths = ("--model-path", "a", "--model-path", "b c", "--strict")
    assert make_serve_arguments(config) == (*JOINING, *paths, *ROS)


def test_each_robot_has_an_agent_unless_they_are_pooled() -> None:
    places = (RobotPlacement("r1", 0.0, 0.0), RobotPlacement("r2", 1.0, 0.0))
    alone = msgspec.structs.replace(PLAIN, placements=places)
    pooled = msgspec.structs.replace(alone, agents=LaunchAgentsConfig(2, 50.0, 10.0))

    one, other = make_agent_starts(alone).values()
    assert (one.config.entities, other.config.entities) == (("r1",), ("r2",))
    assert one.config.pool_limit is None
    pools = make_agent_starts(pooled).values()
    assert [pool.config.pool_limit for pool in pools] == [0, 0]
    assert {pool.config.entities for pool in pools} == {()}
    assert {pool.config.rates for pool in pools} == {RateOverrides(50.0, 10.0)}


def test_agents_are_told_where_to_go_and_who_sees_them() -> None:
    ros = RosSettings(domain=7, tf="global")
    asked = msgspec.structs.replace(
        PLAIN, placements=(RobotPlacement("r1", 0.0, 0.0),), world_name="w", ros=ros
    )

    (start,) = make_agent_starts(asked).values()

    assert start.endpoint == PLAIN.endpoint
    assert (start.config.world, start.config.ros) == ("w", ros)
    assert msgspec.json.decode(msgspec.json.encode(start), type=AgentProcessConfig) == start


@pytest.mark.parametrize(
    ("robots", "cores", "pools"), [(1, 8, 1), (500, 8, 1), (501, 8, 2), (9000, 2, 2), (0, 1, 1)]
)
def test_pools_are_as_many_as_robots_need_and_cores_allow(
    robots: int, cores: int, pools: int
) -> None:
    assert choose_pool_count(robots, cores) == pools


def test_server_shows_itself_to_ros_as_it_is_told() -> None:
    hidden = msgspec.structs.replace(PLAIN, ros=RosSettings(domain=None))
    bridged = RosSettings(domain=7, has_hashes=False, tf="global", is_bridged=True)

    assert make_serve_arguments(hidden) == (*JOINING, "--ros-domain", "off")
    assert make_serve_arguments(msgspec.structs.replace(PLAIN, ros=bridged)) == (
        *JOINING,
        *("--ros-domain", "7", "--ros-distro", "humble", "--ros-bridge"),
    )
