"""Arguments and settings that `zensim up` passes to its programs."""

from dataclasses import dataclass, field

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.spawner.page.builders import FakeServer, make_models, make_robot
from zensim.api.local_deployment import (
    DemandLaunch,
    LaunchAgentsConfig,
    LaunchConfig,
    choose_pool_count,
    make_agent_starts,
    make_pool_starts,
    make_sensor_starts,
    make_serve_arguments,
)
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.proto.messages.sensor_messages import (
    CameraSensor,
    ImuSensor,
    RaySensor,
    ScanAxis,
    SensorSettings,
)
from zensim.proto.messages.telemetry_messages import Event, EventKind
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.settings.deployment_settings import ProgramSettings
from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import change_settings, make_settings
from zensim.proto.topic_catalog import EVENTS
from zensim.robot_agent.agent_config import AgentProcessConfig
from zensim.spawner.spawn.spawn_poses import RobotPlacement

DEFAULTS = LaunchConfig(
    placements=(),
    model="box_bot",
    server=make_settings(ServerSettings, {"world": "w.world"}),
    network=NetworkSettings(listen="tcp/127.0.0.1:1"),
)
COMMON = ("serve", "--announce", "--listen", "tcp/127.0.0.1:1", "--world-name", "default")
WORLD = ("--world", "w.world")
ROS = ("--ros-domain", "0")


def with_settings(**changes: object) -> LaunchConfig:
    server = change_settings(DEFAULTS.server, changes)
    return msgspec.structs.replace(DEFAULTS, server=server)


def test_rtf_is_passed_only_if_given() -> None:
    fast = with_settings(rtf=0.0)

    assert make_serve_arguments(DEFAULTS) == (*COMMON, *WORLD, *ROS)
    assert make_serve_arguments(fast) == (*COMMON, *WORLD, "--rtf", "0.0", *ROS)


def test_lockstep_is_passed() -> None:
    lockstep = with_settings(lockstep=True)

    assert make_serve_arguments(lockstep) == (*COMMON, *WORLD, "--lockstep", *ROS)


def test_engine_is_passed() -> None:
    chosen = with_settings(engine="mujoco")

    assert make_serve_arguments(chosen) == (*COMMON, *WORLD, "--engine", "mujoco", *ROS)


def test_clusters_are_passed() -> None:
    chosen = with_settings(clusters="on", engine_workers=0)

    options = ("--clusters", "on", "--engine-workers", "0")
    assert make_serve_arguments(chosen) == (*COMMON, *WORLD, *options, *ROS)


def test_model_paths_are_passed() -> None:
    config = with_settings(model_paths=("a", "b c"), strict=True)

    paths = ("--model-path", "a", "--model-path", "b c", "--strict")
    assert make_serve_arguments(config) == (*COMMON, *paths, *WORLD, *ROS)


def test_each_robot_has_an_agent_without_pools() -> None:
    placements = (RobotPlacement("r1", 0.0, 0.0), RobotPlacement("r2", 1.0, 0.0))
    single = msgspec.structs.replace(DEFAULTS, placements=placements)
    pooled = msgspec.structs.replace(
        single, agents=LaunchAgentsConfig(2, RateOverrides(50.0, 10.0))
    )

    one, other = make_agent_starts(single).values()
    assert (one.config.entities, other.config.entities) == (("r1",), ("r2",))
    assert one.config.pool_limit is None
    pools = make_agent_starts(pooled).values()
    assert [pool.config.pool_limit for pool in pools] == [0, 0]
    assert {pool.config.entities for pool in pools} == {()}
    assert {pool.config.rates for pool in pools} == {RateOverrides(50.0, 10.0)}


def test_agents_get_endpoint_world_and_ros_settings() -> None:
    config = change_settings(
        msgspec.structs.replace(DEFAULTS, placements=(RobotPlacement("r1", 0.0, 0.0),)),
        {"world_name": "w", "ros_domain": "7", "tf": "global"},
    )

    (start,) = make_agent_starts(config).values()

    assert start.endpoint == DEFAULTS.endpoint
    assert (start.config.world, start.config.ros) == ("w", RosSettings(domain=7, tf="global"))
    assert msgspec.json.decode(msgspec.json.encode(start), type=AgentProcessConfig) == start


@pytest.mark.parametrize(
    ("robots", "cores", "pools"), [(1, 8, 1), (500, 8, 1), (501, 8, 2), (9000, 2, 2), (0, 1, 1)]
)
def test_number_of_pools_depends_on_robots_and_cores(robots: int, cores: int, pools: int) -> None:
    assert choose_pool_count(robots, cores) == pools


def test_ros_settings_are_passed() -> None:
    hidden = change_settings(DEFAULTS, {"ros_domain": "off"})
    chosen = {"ros_domain": "7", "ros_distro": "humble", "ros_bridge": True, "tf": "global"}

    assert make_serve_arguments(hidden) == (*COMMON, *WORLD, "--ros-domain", "off")
    assert make_serve_arguments(change_settings(DEFAULTS, chosen)) == (
        *COMMON,
        *WORLD,
        *("--ros-domain", "7", "--ros-distro", "humble", "--ros-bridge"),
    )


def test_sensor_processes_get_the_endpoint_and_the_world() -> None:
    config = change_settings(DEFAULTS, {"world_name": "w2", "sensors": 2})

    starts = make_sensor_starts(config).values()

    assert [(one.endpoint, one.world) for one in starts] == [("tcp/127.0.0.1:1", "w2")] * 2
    assert len(make_sensor_starts(DEFAULTS)) == 1
    assert make_sensor_starts(change_settings(DEFAULTS, {"sensors": 0})) == {}


@dataclass
class FakeSupervisor:
    """Records the programs that are started."""

    started: list[str] = field(default_factory=list)

    def start(self, name: str, *_: object, **__: object) -> None:
        self.started.append(name)


class LaunchedWorld:
    """A world in memory, and the start of what it needs: its robot r1 has an agent to come."""

    def __init__(
        self, sensors: int | None = None, agents: LaunchAgentsConfig = DEFAULTS.agents
    ) -> None:
        self.bus, self.supervisor, self.now_s = MemoryBus(), FakeSupervisor(), 0.0
        self.server = FakeServer(self.bus, make_models(r1=make_robot()))
        config = msgspec.structs.replace(
            DEFAULTS,
            placements=(RobotPlacement("r1", 0.0, 0.0),),
            programs=ProgramSettings(sensors=sensors),
            agents=agents,
        )
        self.launch = DemandLaunch(
            config,
            self.supervisor,  # type: ignore[arg-type]
            self.bus,  # type: ignore[arg-type]
        )
        self.poll()

    def poll(self) -> int:
        """Poll after a while; return how many processes have been started."""
        for _ in range(2):  # more news are awaited for a moment
            self.now_s += 1.0
            self.launch.poll(self.now_s)
        return len(self.supervisor.started)

    def add(self, settings: SensorSettings, kind: EventKind = "spawned") -> int:
        """Add a robot with a sensor; return how many processes have been started then."""
        self.server.models = make_models(r1=make_robot(), r2=with_sensor(settings))
        self.bus.put_message(EVENTS.key("default"), Event(kind, "r2"), Format.MSGPACK)
        return self.poll()


def with_sensor(settings: SensorSettings) -> Model:
    sensor = Sensor("sensor", "any", "bot_base", "bot_base", settings=settings)
    return msgspec.structs.replace(make_robot(), sensors=(sensor,))


LIDAR = RaySensor(ScanAxis(4, 0.0, 1.0), range_max_m=9.0)


@pytest.mark.parametrize("settings", [LIDAR, CameraSensor()])
@pytest.mark.parametrize("kind", ["spawned", "loaded"])
def test_first_robot_that_needs_one_starts_a_sensor_process(
    settings: SensorSettings, kind: EventKind
) -> None:
    world = LaunchedWorld()

    assert world.supervisor.started == []
    assert world.add(settings, kind) == 1
    assert world.add(settings) == 1


def test_robots_whose_agents_measure_start_no_sensor_process() -> None:
    world = LaunchedWorld()

    assert world.add(ImuSensor()) == 0
    assert world.add(LIDAR) == 1


def test_server_is_asked_only_after_arrivals_and_again_when_it_is_silent() -> None:
    world = LaunchedWorld()
    world.poll()
    assert len(world.server.requests) == 1
    world.server.is_silent = True

    assert world.add(LIDAR) == 0
    world.server.is_silent = False
    assert world.poll() == 1


@pytest.mark.parametrize("count", [0, 2])
def test_sensor_processes_of_a_given_number_start_at_once(count: int) -> None:
    world = LaunchedWorld(count)

    assert len(world.supervisor.started) == count
    assert world.server.requests == []


def test_pool_starts_with_the_first_robot_that_no_agent_drives_or_names() -> None:
    world = LaunchedWorld(0, LaunchAgentsConfig(drives_others=True))

    assert world.supervisor.started == []
    assert world.add(ImuSensor()) == 1
    assert world.add(ImuSensor()) == 1
    assert world.supervisor.started == ["pool"]


@pytest.mark.parametrize(
    "agents", [LaunchAgentsConfig(), LaunchAgentsConfig(1, drives_others=True)]
)
def test_pool_for_others_is_not_started_if_it_is_off_or_all_are_pooled(
    agents: LaunchAgentsConfig,
) -> None:
    world = LaunchedWorld(0, agents)

    assert world.add(ImuSensor()) == 0
    assert make_pool_starts(msgspec.structs.replace(DEFAULTS, agents=agents)) == {}
