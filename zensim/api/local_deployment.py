"""Start server, robots, agents and viewer on this host, and wait until they are ready."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from urllib.parse import urlsplit

import msgspec

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, ForkedProcess, NoServer
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.bus.session_files import require_files
from zensim.proto.bus.zenoh_runtime import require_threads
from zensim.proto.endpoints import DEFAULT_ENDPOINT, is_endpoint_taken, to_client_endpoint
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time
from zensim.proto.messages.telemetry_messages import EventKind, GetModelsResponse, Info, WorldClock
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.settings.deployment_settings import (
    NO_PAGE,
    DeploymentSettings,
    ServeSettings,
    ViewerSettings,
)
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.settings.setting import change_settings, write_words
from zensim.proto.supervisor import (
    PREPARED_START_MODULE,
    RECORDER_GRACE_S,
    SupervisedProgram,
    Supervisor,
)
from zensim.proto.topic_catalog import CLOCK, read_ros_settings
from zensim.proto.web_access import add_token, read_page_token, split_token
from zensim.robot_agent.agent_config import AS_DESCRIBED, AgentConfig, AgentProcessConfig
from zensim.sim_server.sensors.sensor_config import SensorProcessConfig
from zensim.spawner.client.driven_count import NotDriven, wait_until_driven
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.client.topic_reader import TopicReader, read_topic
from zensim.spawner.client.world_follower import WorldFollower
from zensim.spawner.spawn.spawn_client import spawn_fleet
from zensim.spawner.spawn.spawn_poses import RobotPlacement

START_TIMEOUT_S = 30.0
AGENT_WAIT_S = 3.0 * START_TIMEOUT_S
"""Longer than all timeouts here, so that the launcher reports the failure, not an agent."""
OPERATOR, VIEWER, RECORDER = "operator", "viewer", "recorder"
"""Programs that have addresses of their own: the one that starts the others, the page, and the one
that records."""
POLL_S = 0.01
NEWS: AbstractSet[EventKind] = frozenset({"spawned", "loaded", "released"})
"""Events after which the world may have more sensors, or robots without an agent."""
DEMAND_CALL_TIMEOUT_S = 1.0


SPARE_SESSIONS = 4
"""Sessions of the launching program itself, of what drives robots, and of commands of a user."""
ROBOTS_PER_POOL = 500
"""A pool of so many takes a fifth of a core at 10 Hz odometry and tf."""


class LaunchFailed(Exception):
    """A program did not become ready."""


class AgentGroup(msgspec.Struct, frozen=True):
    """An agent process that drives the robots that it names."""

    name: str
    """Name of the program."""
    entities: tuple[str, ...]
    rates: RateOverrides = AS_DESCRIBED


class LaunchAgentsConfig(msgspec.Struct, frozen=True):
    """Agents of a deployment."""

    pools: int | None = None
    """Number of pools that share the robots; None = one agent per robot."""
    rates: RateOverrides = AS_DESCRIBED
    groups: tuple[AgentGroup, ...] = ()
    """Further agents, for robots that are spawned later."""
    drives_others: bool = False
    """Whether a pool starts with the first robot that has no agent; `pools` drive all anyway."""


class LaunchConfig(DeploymentSettings, frozen=True, kw_only=True):
    """Settings of a deployment, and what they lead to on this host."""

    placements: tuple[RobotPlacement, ...] = ()
    model: str = ""
    controllers: tuple[Path, ...] = ()
    drive: DriveOrder = DriveOrder()
    join_addresses: dict[str, str] = msgspec.field(default_factory=dict)
    """Join address (`@FILE`) of each program of a secured server, and of `OPERATOR`."""
    page_token: str = ""
    """File of the page's token; empty = the page needs none."""
    agents: LaunchAgentsConfig = LaunchAgentsConfig()
    viewer: ViewerSettings = NO_PAGE
    is_verbose: bool = False
    """Whether the server logs at level INFO."""

    @property
    def endpoint(self) -> str:
        """Endpoint at which the server listens, unless it connects to a router."""
        return self.network.listen or DEFAULT_ENDPOINT

    @property
    def reached_endpoint(self) -> str:
        """Endpoint of the router: the server's own, or that which it connects to."""
        return self.network.connect or self.endpoint

    @property
    def ros(self) -> RosSettings:
        """ROS 2 settings of all programs.

        Raises:
            ValueError: See `read_ros_settings`.
        """
        return read_ros_settings(self.ros_choice, self.tf_choice)

    @property
    def client_endpoint(self) -> str:
        """Endpoint that programs on this host connect to."""
        return self.network.connect or to_client_endpoint(self.endpoint)

    def address_of(self, program: str) -> str:
        """Find what a program connects to: the join address of its user, or the endpoint."""
        return self.join_addresses.get(program, self.client_endpoint)


@dataclass(frozen=True)
class LaunchProgress:
    """Callbacks, called once per robot."""

    on_spawned: Callable[[], None]
    on_driven: Callable[[], None]


@dataclass(frozen=True)
class DemandedPrograms:
    """Programs that start once the world has something for them.

    Attributes:
        verb: Of `prepared_start`.
        starts: Settings by program name.
        is_wanted: Whether the entities of a world need them; None = they start at once.
    """

    verb: str
    starts: Mapping[str, msgspec.Struct]
    is_wanted: Callable[[GetModelsResponse], bool] | None


class DemandLaunch:
    """Starts sensor processes and the pool of robots of others when the world has some for them.

    An idle sensor process takes 23 MB (proportional set size), a pool 28 MB, and most worlds need
    neither.
    """

    def __init__(self, config: LaunchConfig, supervisor: Supervisor, bus: Bus) -> None:
        self._waiting = list_demanded_programs(config)
        self._supervisor = supervisor
        self._bus, self._world = bus, config.network.world_name
        self._follower: WorldFollower | None = None
        """Follower since the first call, whose reply covers the many events of a start."""
        self._now_s = 0.0

    def poll(self, now_s: float) -> None:
        """Start the programs that are due.

        Args:
            now_s: Wall time from any origin.
        """
        self._now_s = now_s
        self._start([one for one in self._waiting if one.is_wanted is None])
        if not self._waiting:
            return
        if self._follower is None:
            self._follower = WorldFollower(
                self._bus,
                self._world,
                kinds=NEWS,
                # Programs that died wait meanwhile.
                timeout_s=DEMAND_CALL_TIMEOUT_S,
                clock=lambda: self._now_s,
            )
        self._follower.take()
        if self._follower.poll() and (models := self._follower.models) is not None:
            self._start([one for one in self._waiting if one.is_wanted and one.is_wanted(models)])

    def _start(self, due: Sequence[DemandedPrograms]) -> None:
        for programs in due:
            self._waiting.remove(programs)
            for name, start in programs.starts.items():
                words = (programs.verb, msgspec.json.encode(start).decode())
                self._supervisor.start(name, words, is_restarted=True, module=PREPARED_START_MODULE)


def list_demanded_programs(config: LaunchConfig) -> list[DemandedPrograms]:
    """List the programs of a deployment that its world may need."""
    has_number = config.programs.sensors is not None
    sensors = make_sensor_starts(config)
    pool = make_pool_starts(config)
    own = {one.name for one in config.placements}.union(*(g.entities for g in config.agents.groups))
    return [
        DemandedPrograms("sensors", sensors, None if has_number else _has_sensors),
        *([DemandedPrograms("agent", pool, partial(_has_others, own))] if pool else []),
    ]


def _has_sensors(models: GetModelsResponse) -> bool:
    """Whether an entity has a sensor for a sensor process."""
    sensors = (sensor for model in models.models for sensor in model.sensors)
    return any(isinstance(one.settings, RaySensor | CameraSensor) for one in sensors)


def _has_others(own: AbstractSet[str], models: GetModelsResponse) -> bool:
    """Whether a robot has no agent, and none that will claim it by name."""
    return any(
        not one.agent and one.entity not in own and models.models[one.model].needs_agent
        for one in models.entities
    )


class SimTimeMeter:
    """Sums simulation time across resets.

    Attributes:
        total_ns: Time that has passed since the first reading.
    """

    def __init__(self, time_ns: int, epoch: int) -> None:
        self.total_ns = 0
        self._time_ns, self._epoch = time_ns, epoch

    def add(self, time_ns: int, epoch: int) -> None:
        """Add a reading of the clock; a new epoch began at 0."""
        before_ns = self._time_ns if epoch == self._epoch else 0
        self.total_ns += max(0, time_ns - before_ns)
        self._time_ns, self._epoch = time_ns, epoch


@dataclass
class LocalDeployment:
    """Running programs on this host."""

    config: LaunchConfig
    supervisor: Supervisor
    bus: Bus
    client: SimClient
    on_demand: DemandLaunch
    ready_s: float = 0.0
    viewer_url: str = ""
    recorder: SupervisedProgram | None = None
    restarts: int = 0
    ready_info: Info = field(default_factory=Info)
    ready_at_s: float = 0.0
    """Monotonic time when all programs were ready."""
    clock: TopicReader[WorldClock] | None = None
    """Subscription to simulation time."""
    meter: SimTimeMeter = field(default_factory=lambda: SimTimeMeter(0, 0))


def launch(
    config: LaunchConfig, supervisor: Supervisor, progress: LaunchProgress, began_s: float
) -> LocalDeployment:
    """Start all programs, and wait until agents drive every robot and the page is served.

    Raises:
        LaunchFailed: Another program has the endpoint, or a program is not ready in time.
        ProgramDied: A process exited.
        ForkedProcess: See `open_bus`.
    """
    require_threads()
    if not config.network.connect and is_endpoint_taken(config.endpoint):
        # Its world would get the robots before the server of this one fails.
        raise LaunchFailed(
            f"another program listens at {config.endpoint}; end it, with 'zensim down' if it is "
            "'zensim up', or choose another endpoint, as `listen` tcp/127.0.0.1:0"
        )
    start_programs(config, supervisor)
    with ExitStack() as stack:
        bus = stack.enter_context(_open_bus(config, supervisor))
        client = SimClient(bus, config.network.world_name)
        on_demand = DemandLaunch(config, supervisor, bus)
        deployment = LocalDeployment(config, supervisor, bus, client, on_demand)
        _wait_until_ready(deployment, progress, began_s)
        # Last, since no robot waits for them.
        on_demand.poll(time.monotonic())
        # The caller closes the bus.
        stack.pop_all()
    return deployment


def make_serve_arguments(config: LaunchConfig) -> tuple[str, ...]:
    """Make the command line of the server; defaults are left out."""
    changes = {
        "listen": "" if config.network.connect else config.endpoint,
        "input_log": config.operation.input_log or config.programs.record is not None,
    }
    verbose = ("--verbose",) if config.is_verbose else ()
    return (
        "serve",
        "--announce",
        *verbose,
        *write_words(change_settings(config, changes), ServeSettings),
    )


def make_agent_starts(config: LaunchConfig) -> dict[str, AgentProcessConfig]:
    """Make the settings of the agents that start at once, by program name."""
    common = _make_agent_config(config)
    if config.agents.pools is not None:
        pool = msgspec.structs.replace(common, pool_limit=0)
        configs = {f"pool {number}": pool for number in range(config.agents.pools)}
    else:
        configs = {
            f"agent of {one.name}": msgspec.structs.replace(common, entities=(one.name,))
            for one in config.placements
        }
    for group in config.agents.groups:
        configs[f"agent {group.name}"] = msgspec.structs.replace(
            common, entities=group.entities, rates=group.rates
        )
    return _make_agent_processes(config, configs)


def make_pool_starts(config: LaunchConfig) -> dict[str, AgentProcessConfig]:
    """Make the settings of the pool that starts with the first robot of others, if there is one."""
    if config.agents.pools is not None or not config.agents.drives_others:
        return {}
    pool = msgspec.structs.replace(_make_agent_config(config), pool_limit=0)
    return _make_agent_processes(config, {"pool": pool})


def _make_agent_config(config: LaunchConfig) -> AgentConfig:
    return AgentConfig(
        world=config.network.world_name,
        rates=config.agents.rates,
        wait_s=AGENT_WAIT_S,
        ros=config.ros,
    )


def _make_agent_processes(
    config: LaunchConfig, agents: Mapping[str, AgentConfig]
) -> dict[str, AgentProcessConfig]:
    return {
        name: AgentProcessConfig(endpoint=config.address_of(name), config=one, is_quiet=True)
        for name, one in agents.items()
    }


def make_sensor_starts(config: LaunchConfig) -> dict[str, SensorProcessConfig]:
    """Make the settings of the sensor processes, by program name."""
    return {
        f"sensor process {number}": SensorProcessConfig(
            endpoint=config.address_of(f"sensor process {number}"),
            world=config.network.world_name,
            ros=config.ros,
            is_quiet=True,
        )
        for number in range(1 if config.programs.sensors is None else config.programs.sensors)
    }


def choose_pool_count(robots: int, cores: int) -> int:
    """Choose the number of pools for a number of robots."""
    return max(1, min(cores, -(-robots // ROBOTS_PER_POOL)))


def start_programs(
    config: LaunchConfig,
    supervisor: Supervisor,
    timeout_s: float = START_TIMEOUT_S,
    *,
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Start the server and the agents, and wait until the server listens.

    Raises:
        TooFewFiles: The limit of open files is too low for all programs.
        LaunchFailed: The server does not listen in time [s], or the start was stopped.
        ProgramDied: A process exited.
    """
    if not config.network.connect:
        programs = _count_programs(config)
        require_files(programs + SPARE_SESSIONS, f"a server with {programs} programs")
    server = supervisor.start("server", make_serve_arguments(config))
    agents = make_agent_starts(config)
    settings = {name: msgspec.json.encode(start).decode() for name, start in agents.items()}
    supervisor.start_alike("agent", settings)

    def watch() -> None:
        supervisor.watch()
        if should_stop():
            raise LaunchFailed("the start was stopped")

    _await_announcement(server, watch, timeout_s)


def _count_programs(config: LaunchConfig) -> int:
    """Count the programs that connect to the server."""
    count = config.programs.sensors
    further = (config.viewer.viewer, config.programs.record is not None, count != 0)
    sensors = max(count or 1, 1) - 1
    return len(make_agent_starts(config)) + len(make_pool_starts(config)) + sensors + sum(further)


def _await_announcement(
    server: SupervisedProgram, watch: Callable[[], None], timeout_s: float
) -> None:
    """Wait for the line that the server prints when it listens; another may listen there."""
    lines: SimpleQueue[bytes] = SimpleQueue()
    stream = server.process.stdout if server.process is not None else None
    if stream is None:
        raise LaunchFailed("the server has no output")
    threading.Thread(target=lambda: lines.put(stream.readline()), daemon=True).start()
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        watch()
        with suppress(Empty):
            if lines.get(timeout=POLL_S):
                return
    raise LaunchFailed(f"the server is not ready after {timeout_s:g} s")


def _open_bus(config: LaunchConfig, supervisor: Supervisor) -> Bus:
    deadline = time.monotonic() + START_TIMEOUT_S
    bus_config = BusConfig(connect=(config.address_of(OPERATOR),), open_timeout_s=0.2)
    while True:
        supervisor.watch()
        try:
            return open_bus(bus_config)
        except ForkedProcess:
            raise
        except BusError as error:
            if time.monotonic() > deadline:
                raise LaunchFailed(
                    f"the server is not ready after {START_TIMEOUT_S:g} s: {error}"
                ) from error


def _wait_until_ready(
    deployment: LocalDeployment, progress: LaunchProgress, began_s: float
) -> None:
    config = deployment.config
    deployment.client.wait_for_server(START_TIMEOUT_S, deployment.supervisor.watch)
    if config.programs.record is not None:
        deployment.recorder = _start_recorder(deployment, config.programs.record)
    outcomes = spawn_fleet(
        deployment.client,
        config.model,
        config.placements,
        lambda _: progress.on_spawned(),
        controllers=config.controllers,
        drive=config.drive,
    )
    if refused := [outcome for outcome in outcomes if outcome.code != ResultCode.OK]:
        raise LaunchFailed(f"{refused[0].name}: {refused[0].message}")
    _wait_for_recording(deployment)
    viewer = _start_viewer(deployment) if config.viewer.viewer else None
    _wait_for_agents(deployment, progress)
    deployment.ready_s = time.monotonic() - began_s
    if viewer is not None:
        deployment.viewer_url = _read_viewer_url(viewer, config.page_token)
        # A restarted page has the same address.
        port = urlsplit(deployment.viewer_url).port or 0
        viewer.arguments = _make_viewer_arguments(config, port)
    _begin_measuring(deployment)


def _wait_for_agents(deployment: LocalDeployment, progress: LaunchProgress) -> None:
    """Wait until an agent drives each robot, and so publishes its topics."""
    names = [one.name for one in deployment.config.placements]
    shown = 0

    def show(count: int) -> None:
        nonlocal shown
        for _ in range(shown, count):
            progress.on_driven()
            shown += 1
        deployment.supervisor.watch()

    try:
        wait_until_driven(deployment.client, names, START_TIMEOUT_S + 0.2 * len(names), show)
    except NotDriven as error:
        raise LaunchFailed(str(error)) from error


def _begin_measuring(deployment: LocalDeployment) -> None:
    key = CLOCK.key(deployment.config.network.world_name)
    deployment.clock = read_topic(deployment.bus, key, WorldClock)
    deployment.ready_info, deployment.ready_at_s = deployment.client.info(), time.monotonic()
    deployment.meter = SimTimeMeter(
        round(deployment.ready_info.sim_time_s * NANOSECONDS), deployment.ready_info.epoch
    )


def _poll(deployment: LocalDeployment, deadline: float, failure: str) -> None:
    deployment.supervisor.watch()
    if time.monotonic() > deadline:
        raise LaunchFailed(f"{failure} after {START_TIMEOUT_S:g} s")
    time.sleep(POLL_S)


def _start_recorder(deployment: LocalDeployment, path: Path) -> SupervisedProgram:
    config = deployment.config
    recorder = deployment.supervisor.start(
        RECORDER,
        (
            *("record", "--all", "--quiet", "--output", str(path)),
            *("--connect", config.address_of(RECORDER)),
            *("--world-name", config.network.world_name),
            *("--ros-domain", config.ros_choice.ros_domain),
        ),
        # The world goes on without it, and an error of the disk would come again.
        is_essential=False,
        grace_s=RECORDER_GRACE_S,
    )
    recorder.is_restarted_if_killed = True
    recorder.arguments = (*recorder.arguments, "--resume")
    return recorder


def _wait_for_recording(deployment: LocalDeployment) -> None:
    """Wait until the recorder has its file: one that cannot write ends the start."""
    recorder, path = deployment.recorder, deployment.config.programs.record
    deadline = time.monotonic() + START_TIMEOUT_S
    while recorder is not None and path is not None and not path.exists():
        if recorder.failures:
            raise LaunchFailed("the recorder failed; see the line above, or leave out `record`")
        _poll(deployment, deadline, f"the recorder has not made {path}")


def _start_viewer(deployment: LocalDeployment) -> SupervisedProgram:
    return deployment.supervisor.start(
        VIEWER,
        _make_viewer_arguments(deployment.config, deployment.config.viewer.viewer_port),
        is_restarted=True,
        # The world goes on without its page.
        is_essential=False,
    )


def _make_viewer_arguments(config: LaunchConfig, port: int) -> tuple[str, ...]:
    return (
        *("view", "--connect", config.address_of(VIEWER)),
        *("--world-name", config.network.world_name, "--port", str(port), "--no-open"),
        *(("--secure", "--page-token", config.page_token) if config.page_token else ()),
    )


def _read_viewer_url(viewer: SupervisedProgram, page_token: str) -> str:
    """Read the address that the page prints, and add its token, which it prints on terminals only.

    Args:
        viewer: Program of the page.
        page_token: File of the token; empty = the page needs none.
    """
    if viewer.process is None or viewer.process.stdout is None:
        raise LaunchFailed("the viewer has no output")
    # The viewer prints one line when it is ready, and closes its output if it fails.
    line = viewer.process.stdout.readline().decode()
    if not line:
        raise LaunchFailed("the viewer failed; see the line above, or leave out `viewer`")
    # On a terminal it has the token, elsewhere how a shell reads it.
    bare, _ = split_token(line.split()[1])
    return add_token(bare, read_page_token(Path(page_token)) if page_token else "")


def supervise(
    deployment: LocalDeployment, duration_s: float, should_stop: Callable[[], bool]
) -> None:
    """Supervise the processes until `should_stop` or for a duration [s]; 0 = forever.

    Raises:
        ProgramDied: A process without restarts exited.
    """
    end = time.monotonic() + duration_s if duration_s > 0 else float("inf")
    while not should_stop() and time.monotonic() < end:
        deployment.supervisor.watch()
        deployment.on_demand.poll(time.monotonic())
        _read_clock(deployment)
        time.sleep(POLL_S * 5)


def _read_clock(deployment: LocalDeployment) -> None:
    now = deployment.clock.newest() if deployment.clock is not None else None
    if now is not None:
        deployment.meter.add(ns_from_time(now.clock), now.epoch)


def summarize_run(deployment: LocalDeployment) -> dict[str, float | int]:
    """Compute the figures of a run since it was ready."""
    try:
        last = deployment.client.info()
    except (NoServer, TimeoutError):
        last = deployment.ready_info
    wall_s = max(time.monotonic() - deployment.ready_at_s, 1e-9)
    deployment.meter.add(round(last.sim_time_s * NANOSECONDS), last.epoch)
    return {
        "real_time_factor": deployment.meter.total_ns / NANOSECONDS / wall_s,
        "sim_time_s": last.sim_time_s,
        "wall_time_s": wall_s,
        "robots": last.entities,
        "agents": last.agents,
        "restarts": sum(program.restarts for program in deployment.supervisor.programs),
    }
