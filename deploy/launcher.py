"""`zensim up` without its command line: start server, fleet, agents and page, and wait until they are ready."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field

import msgspec

from zensim.deploy.supervisor import PREPARED_START_MODULE, SupervisedProgram, Supervisor
from zensim.proto.bus import Bus, BusConfig, BusError, NoServer, open_bus
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.telemetry_messages import Info
from zensim.proto.ros2.ros_settings import RosSettings, to_cli_arguments
from zensim.proto.topic_catalog import ODOM
from zensim.robot_agent.agent_config import AgentConfig, AgentProcessConfig, RateOverrides
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_client import spawn_fleet
from zensim.spawner.spawn.spawn_poses import RobotPlacement

START_TIMEOUT_S = 30.0
AGENT_WAIT_S = 3.0 * START_TIMEOUT_S
"""Longer than any wait here, so that it is told here what did not come up."""
ODOM_DEPTH = 65536
POLL_S = 0.01


ROBOTS_PER_POOL = 500
"""Driving so many, at ten odometries and tfs a second each, keeps a fifth of a core busy."""


class LaunchFailed(Exception):
    """What was asked for did not come up."""


class LaunchAgentsConfig(msgspec.Struct, frozen=True):
    """What drives the robots."""

    pools: int | None = None
    """How many pools share the robots; None = each robot has an agent of its own."""
    odom_hz: float | None = None
    """None = as described."""
    tf_hz: float | None = None
    """None = as described, or with odometry."""


class LaunchConfig(msgspec.Struct, frozen=True, kw_only=True):
    """What `zensim up` runs."""

    placements: tuple[RobotPlacement, ...]
    model: str
    world: str
    world_name: str
    endpoint: str
    real_time_factor: float | None = None
    """None = as the world file says."""
    model_paths: tuple[str, ...] = ()
    is_strict: bool = False
    is_lockstep: bool = False
    engine: str = ""
    clusters: str = "auto"
    engine_workers: int | None = None
    dynamics: Dynamics = "full"
    """Empty = as a server chooses by itself."""
    agents: LaunchAgentsConfig = LaunchAgentsConfig()
    ros: RosSettings = RosSettings()
    has_viewer: bool
    viewer_port: int


@dataclass(frozen=True)
class LaunchProgress:
    """Called as things come up."""

    on_spawned: Callable[[], None]
    on_odom: Callable[[], None]


@dataclass
class LocalDeployment:
    """A running demo."""

    config: LaunchConfig
    supervisor: Supervisor
    bus: Bus
    client: SimClient
    ready_s: float = 0.0
    viewer_url: str = ""
    restarts: int = 0
    since: Info = field(default_factory=Info)
    since_s: float = 0.0


def launch(
    config: LaunchConfig, supervisor: Supervisor, steps: LaunchProgress, began_s: float
) -> LocalDeployment:
    """Bring everything up and return when every robot has published odom and the page is served.

    Raises:
        DemoFailed: Something did not come up.
        ProgramDied: A process ended.
    """
    _start_programs(config, supervisor)
    with ExitStack() as ending:
        bus = ending.enter_context(_open_bus(config, supervisor))
        demo = LocalDeployment(config, supervisor, bus, SimClient(bus, config.world_name))
        _wait_until_ready(demo, steps, began_s)
        # From here on the bus is the caller's to close.
        ending.pop_all()
    return demo


def make_serve_arguments(config: LaunchConfig) -> tuple[str, ...]:
    """Write the command line of the server; what was not asked for is left to the world file."""
    factor = config.real_time_factor
    return (
        *("serve", "--listen", config.endpoint, "--world", config.world),
        *("--world-name", config.world_name),
        *(("--rtf", str(factor)) if factor is not None else ()),
        *(word for path in config.model_paths for word in ("--model-path", path)),
        *(("--strict",) if config.is_strict else ()),
        *(("--lockstep",) if config.is_lockstep else ()),
        *(("--engine", config.engine) if config.engine else ()),
        *(("--clusters", config.clusters) if config.clusters != "auto" else ()),
        *_engine_worker_arguments(config.engine_workers),
        *(("--dynamics", config.dynamics) if config.dynamics != "full" else ()),
        *to_cli_arguments(config.ros),
    )


def make_agent_starts(config: LaunchConfig) -> dict[str, AgentProcessConfig]:
    """Write what the agents are told, by what they are called here."""
    common = AgentConfig(
        world=config.world_name,
        rates=RateOverrides(config.agents.odom_hz, config.agents.tf_hz),
        wait_s=AGENT_WAIT_S,
        ros=config.ros,
    )
    told = {
        f"agent of {one.name}": msgspec.structs.replace(common, entities=(one.name,))
        for one in config.placements
    }
    if config.agents.pools is not None:
        pool = msgspec.structs.replace(common, pool_limit=0)
        told = {f"pool {number}": pool for number in range(config.agents.pools)}
    return {
        name: AgentProcessConfig(endpoint=config.endpoint, config=one, is_quiet=True)
        for name, one in told.items()
    }


def choose_pool_count(robots: int, cores: int) -> int:
    """Choose how many pools drive so many robots on a host."""
    return max(1, min(cores, -(-robots // ROBOTS_PER_POOL)))


def _engine_worker_arguments(count: int | None) -> tuple[str, ...]:
    return () if count is None else ("--engine-workers", str(count))


def _start_programs(config: LaunchConfig, supervisor: Supervisor) -> None:
    supervisor.start("server", make_serve_arguments(config))
    for name, told in make_agent_starts(config).items():
        words = ("agent", msgspec.json.encode(told).decode())
        supervisor.start(name, words, is_restarted=True, module=PREPARED_START_MODULE)


def _open_bus(config: LaunchConfig, supervisor: Supervisor) -> Bus:
    deadline = time.monotonic() + START_TIMEOUT_S
    bus_config = BusConfig(connect=(config.endpoint,), open_timeout_s=0.2)
    while True:
        supervisor.watch()
        try:
            return open_bus(bus_config)
        except BusError as error:
            if time.monotonic() > deadline:
                raise LaunchFailed(f"the server is not up after {START_TIMEOUT_S:g} s") from error


def _wait_until_ready(demo: LocalDeployment, steps: LaunchProgress, began_s: float) -> None:
    config = demo.config
    odom = demo.bus.subscribe(ODOM.key("*"), ODOM_DEPTH)
    demo.client.wait_for_server(START_TIMEOUT_S, demo.supervisor.watch)
    outcomes = spawn_fleet(
        demo.client, config.model, config.placements, lambda _: steps.on_spawned()
    )
    if refused := [outcome for outcome in outcomes if outcome.code != ResultCode.OK]:
        raise LaunchFailed(f"{refused[0].name}: {refused[0].message}")
    viewer = _start_viewer(demo) if config.has_viewer else None
    missing = {ODOM.key(place.name) for place in config.placements}
    deadline = time.monotonic() + START_TIMEOUT_S + 0.2 * len(missing)
    while missing:
        seen = {sample.key for sample in odom.take()} & missing
        missing -= seen
        for _ in seen:
            steps.on_odom()
        _poll(demo, deadline, f"{len(missing)} robots publish no odom")
    odom.close()
    demo.ready_s = time.monotonic() - began_s
    if viewer is not None:
        demo.viewer_url = _read_viewer_url(viewer)
    demo.since, demo.since_s = demo.client.info(), time.monotonic()


def _poll(demo: LocalDeployment, deadline: float, complaint: str) -> None:
    demo.supervisor.watch()
    if time.monotonic() > deadline:
        raise LaunchFailed(f"{complaint} after {START_TIMEOUT_S:g} s")
    time.sleep(POLL_S)


def _start_viewer(demo: LocalDeployment) -> SupervisedProgram:
    config = demo.config
    return demo.supervisor.start(
        "viewer",
        (
            *("view", "--connect", config.endpoint, "--world-name", config.world_name),
            *("--port", str(config.viewer_port), "--no-open"),
        ),
    )


def _read_viewer_url(viewer: SupervisedProgram) -> str:
    if viewer.process is None or viewer.process.stdout is None:
        raise LaunchFailed("the page is not served")
    # It prints one line when it serves, and closes its output when it cannot.
    line = viewer.process.stdout.readline().decode()
    if not line:
        raise LaunchFailed("the page is not served; see the line above, or use --no-viewer")
    return line.split()[-1]


def supervise(demo: LocalDeployment, duration_s: float, should_stop: Callable[[], bool]) -> None:
    """Look after the processes until told to stop or the duration [s] is over; 0 = for ever.

    Raises:
        ProgramDied: One that may not end has ended.
    """
    end = time.monotonic() + duration_s if duration_s > 0 else float("inf")
    while not should_stop() and time.monotonic() < end:
        demo.supervisor.watch()
        time.sleep(POLL_S * 5)


def summarize_run(demo: LocalDeployment) -> dict[str, float | int]:
    """Say how it went since it was ready."""
    try:
        last = demo.client.info()
    except (NoServer, TimeoutError):
        last = demo.since
    wall_s = max(time.monotonic() - demo.since_s, 1e-9)
    return {
        "real_time_factor": (last.sim_time_s - demo.since.sim_time_s) / wall_s,
        "sim_time_s": last.sim_time_s,
        "wall_time_s": wall_s,
        "robots": last.entities,
        "agents": last.agents,
        "restarts": sum(program.restarts for program in demo.supervisor.programs),
    }
