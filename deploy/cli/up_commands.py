"""`zensim up`: start server, robots, agents and viewer on this host."""

import os
import socket
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from errno import EEXIST
from functools import partial
from math import inf, isfinite
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from zensim.api.local_deployment import (
    OPERATOR,
    RECORDER,
    VIEWER,
    LaunchAgentsConfig,
    LaunchConfig,
    LaunchFailed,
    LaunchProgress,
    LocalDeployment,
    choose_pool_count,
    launch,
    make_agent_starts,
    make_pool_starts,
    make_sensor_starts,
    summarize_run,
    supervise,
)
from zensim.deploy.cli.command_session import PrintableConsole
from zensim.deploy.cli.serve_commands import ServeOptions, print_users
from zensim.deploy.cli.spawn_arguments import (
    ControllersOption,
    DriveOption,
    SpacingOption,
    layout_option,
    make_placements,
)
from zensim.deploy.cli.view_commands import MissingViewerExtra, check_page
from zensim.deploy.demo_patterns import DEMO_BEHAVIOURS, MovingBehaviour, describe_demo
from zensim.deploy.local_runs import LocalRun, recorded_run
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.endpoints import DEFAULT_ENDPOINT, check_exposure, with_free_port
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.options.command_options import RosTfOptions, SetOption, parse_choice
from zensim.proto.options.option_groups import make_app
from zensim.proto.options.option_sources import find_unused_endpoint
from zensim.proto.printable_text import print_lines
from zensim.proto.security.roles import ROLES, User
from zensim.proto.settings.deployment_settings import (
    MAX_AGENT_PROCESSES,
    USUAL,
    AgentSettings,
    ProgramSettings,
    ViewerSettings,
)
from zensim.proto.settings.path_completion import complete_models
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.settings.setting import change_settings, read_settings
from zensim.proto.stop_signal import StopFlag
from zensim.proto.supervisor import ProgramDied, SupervisedProgram, Supervisor
from zensim.proto.topic_catalog import read_ros_settings
from zensim.proto.verbosity import CURRENT, print_note
from zensim.proto.web_access import add_token_of_file, split_token
from zensim.sim_server.security.secure_folder import (
    SecureSettings,
    open_secure_folder,
    prepare_secure_folder,
    to_secure_endpoint,
)
from zensim.sim_server.server_config import to_mesh_endpoint
from zensim.sim_server.server_extra import MissingServerExtra, server_extra
from zensim.spawner.spawn.spawn_poses import LAYOUTS, RobotPlacement

# What few runs need is imported where it is used, as this process lives as long as its world.
if TYPE_CHECKING:
    from zensim.deploy.up_driver import UpDriver
    from zensim.scenario.scenario_reader import Scenario

app = make_app()

console = PrintableConsole(stderr=True)
DriverMaker = Callable[[LocalDeployment], "UpDriver"]
MOST_IN_ROW = 20  # robots that one picture shows
SLOW_AFTER_S, SLOW_SHARE = 8.0, 0.8
FASTER = "faster, unless in use: --dynamics auto or kinematic, --engine mujoco"


@dataclass(frozen=True, kw_only=True)
class UpOptions(RosTfOptions, ServeOptions):
    """All options of `zensim up`."""

    file: Annotated[
        str, typer.Argument(metavar="FILE", help="Scenario file, or name of a shipped scenario.")
    ] = ""
    settings: SetOption = None
    robots: Annotated[
        int, typer.Option("--robots", min=0, metavar="N", help="Number of robots.")
    ] = 10
    model: Annotated[
        str,
        typer.Option(
            "--model",
            metavar="MODEL",
            help="Model of the robots: built-in, or path of a URDF, xacro or SDF file.",
            autocompletion=complete_models,
        ),
    ] = "box_bot"
    controllers: ControllersOption = None
    drive: DriveOption = ""
    layout: Annotated[str, layout_option(show_default=f"row; grid above {MOST_IN_ROW} robots")] = ""
    spacing: SpacingOption = 1.0
    duration: Annotated[
        float,
        typer.Option(
            "--duration",
            metavar="SECONDS",
            help=r"Exit after this time, counted from ready \[s]; 0 = run until Ctrl-C.",
        ),
    ] = 0.0
    agents: AgentSettings = USUAL.agents
    rates: RateOverrides = USUAL.rates
    programs: ProgramSettings = USUAL.programs
    behaviour: Annotated[
        str,
        typer.Option(
            "--behaviour",
            metavar="circle|waypoints|random_walk|none",
            help="What each robot does until something commands it.",
        ),
    ] = "circle"
    viewer: ViewerSettings = USUAL.viewer


@app.command(
    epilog="""Examples:
  zensim up
  zensim up first_minutes
  zensim up --robots 100 --agents pooled --no-viewer
  zensim up --model robot.urdf --world warehouse --rtf 0 --duration 60"""
)
def up(context: typer.Context, given: UpOptions) -> None:
    """Start a server, robots, agents and the viewer on this host, until Ctrl-C."""
    began_s = time.monotonic()
    if find_unused_endpoint(context, "up"):
        given = replace(given, network=msgspec.structs.replace(given.network, connect=""))
    also = (LaunchFailed, ProgramDied, NotRecorded, MissingViewerExtra, MissingServerExtra)
    with exit_on_failure("up", *also):
        plan = _make_plan(context, given)
        if plan.config.viewer.viewer:
            check_page(plan.config.viewer.viewer_port)
        require_no_recording(plan.config)
        plan = replace(plan, config=secure_deployment(plan.config))
        _launch_and_run(plan, began_s, given.duration, as_json=given.as_json)


@dataclass(frozen=True)
class UpPlan:
    """A deployment that will be started, and what drives its robots.

    Attributes:
        drive_robots: Makes what drives the robots once all programs run.
        names: Of the robots.
        end_s: Simulation time at which the scenario ends.
    """

    config: LaunchConfig
    drive_robots: DriverMaker | None
    names: tuple[str, ...]
    end_s: float | None = None


def _make_plan(context: typer.Context, given: UpOptions) -> UpPlan:
    """Complete the settings, and choose what drives the robots: a scenario or the demo."""
    behaviour = parse_choice("--behaviour", given.behaviour, DEMO_BEHAVIOURS)
    config = make_config(given)
    if given.file:
        return _make_scenario_plan(context, given, config)
    _refuse_pools_that_drive_others(config, given)
    names = tuple(one.name for one in config.placements)
    if behaviour == "none" or not names:
        return UpPlan(config, None, names)
    demo = partial(_make_demo, behaviour, is_quiet=given.as_json)
    return UpPlan(config, demo, names)


def _make_scenario_plan(context: typer.Context, given: UpOptions, config: LaunchConfig) -> UpPlan:
    from zensim.deploy.scenario_settings import add_scenario, refuse_options_of_the_demo
    from zensim.scenario.scenario_reader import find_scenario_file, read_scenario

    written = _list_written(context, given)
    end = [f"end.at={given.duration or 'null'}"] if "duration" in written else []
    scenario = read_scenario(find_scenario_file(given.file), [*(given.settings or ()), *end])
    refuse_options_of_the_demo(scenario, written)
    config = add_scenario(config, scenario, written)
    _refuse_pools_that_drive_others(config, given)
    _refuse_two_endpoints(config, scenario)
    maker = partial(_make_scenario_driver, scenario)
    return UpPlan(config, maker, tuple(scenario.robot_names), scenario.format.end.at)


def _refuse_two_endpoints(config: LaunchConfig, scenario: "Scenario") -> None:
    places = scenario.places
    if config.network.connect and {"network.listen", "network.connect"} <= places.keys():
        raise ValueError(
            f"{places['network.connect']}: network.listen and network.connect exclude each other; "
            "remove one"
        )


def _list_written(context: typer.Context, given: UpOptions) -> dict[str, object]:
    """List the options that the command line or a variable sets, with their values."""
    values: dict[str, object] = {}
    for name, value in vars(given).items():
        values |= read_settings(value) if isinstance(value, msgspec.Struct) else {name: value}
    sources = {name: context.get_parameter_source(name) for name in values}
    written = {
        name: value
        for name, value in values.items()
        if (source := sources[name]) is not None
        and source.name in ("COMMANDLINE", "ENVIRONMENT")
        and not (name == "connect" and not value)
    }
    return written | ({"verbose": True} if CURRENT.is_verbose else {})


def _make_scenario_driver(scenario: "Scenario", deployment: LocalDeployment) -> "UpDriver":
    from zensim.deploy.scenario_driver import ScenarioDriver

    return ScenarioDriver(
        deployment,
        scenario,
        lambda check: print_lines(
            f"check failed: {check.name}: {check.message} ({check.place})", err=True
        ),
    )


def _make_demo(
    behaviour: MovingBehaviour, deployment: LocalDeployment, *, is_quiet: bool
) -> "UpDriver":
    if behaviour == "circle":
        from zensim.deploy.circle_demo import make_circle_demo

        demo: UpDriver = make_circle_demo(deployment)
    else:
        from zensim.deploy.fleet_demo import make_demo

        demo = make_demo(deployment, behaviour)
    if not is_quiet:
        print_lines(describe_demo(behaviour))
    return demo


def make_config(given: UpOptions) -> LaunchConfig:
    """Make the settings of a deployment; raise `ValueError` if an option is not valid."""
    given.operation.choose_metrics("zensim up", is_insecure=given.network.insecure)
    check_name(given.network.world_name, "world name")
    read_ros_settings(given.ros_choice, given.tf_choice)
    listen = with_free_port(given.network.listen or DEFAULT_ENDPOINT)
    return LaunchConfig(
        placements=_make_placements(given),
        model=given.model,
        controllers=tuple(given.controllers or ()),
        drive=parse_drive_order(given.drive),
        agents=_choose_agents(given),
        network=msgspec.structs.replace(given.network, listen=listen),
        operation=given.operation,
        server=given.server,
        ros_choice=given.ros_choice,
        tf_choice=given.tf_choice,
        programs=given.programs,
        viewer=given.viewer,
        is_verbose=CURRENT.is_verbose,
    )


def require_no_recording(config: LaunchConfig) -> None:
    """Check that the file of the recording does not exist yet.

    Raises:
        FileExistsError: It exists.
    """
    if (path := config.programs.record) is not None and path.exists():
        raise FileExistsError(EEXIST, "--record exists; give another name", str(path))


def secure_deployment(config: LaunchConfig) -> LaunchConfig:
    """Give each program a user of its own if the server is secured; else check the exposure.

    Raises:
        Exposed: Other hosts can connect to a server that is not secured, and no option allows it.
        ValueError: See `to_secure_endpoint`, `RefusedUser`.
    """
    network = config.network
    listen = () if network.connect else (config.endpoint,)
    if network.mesh_http:
        listen = (*listen, to_mesh_endpoint(network.mesh_http))
    check_exposure("zensim up", listen, is_secure=network.secure, is_insecure=network.insecure)
    if not network.secure:
        if network.client_certificates:
            raise ValueError("--client-certificates needs --secure; add it")
        if config.viewer.page_role:
            raise ValueError("--page-role needs --secure; without it, the page acts")
        return config
    if network.connect:
        raise ValueError("--secure and --connect exclude each other; give one of them")
    endpoint = to_secure_endpoint(config.endpoint)
    config = change_settings(config, {"listen": endpoint})
    with server_extra():
        folder = prepare_secure_folder(
            SecureSettings(
                network.world_name, config.ros.domain, endpoint, network.client_certificates
            )
        )
    users = list_users_of_programs(config)
    accounts = folder.ensure(users.values())
    addresses = {
        program: folder.write_token(account, config.client_endpoint)
        for program, account in zip(users, accounts, strict=True)
    }
    # The address of a page that only shows must not become that of one that acts.
    file = "page_operator.secret" if config.viewer.page_role == "operator" else "page.secret"
    return msgspec.structs.replace(
        config, join_addresses=addresses, page_token=str(folder.path / file)
    )


def list_users_of_programs(config: LaunchConfig) -> dict[str, User]:
    """List the users of the programs of a secured deployment, by program."""
    page = User("page", config.viewer.page_role or "page")
    users = {OPERATOR: User("operator", "operator"), VIEWER: page}
    if config.programs.record is not None:
        users[RECORDER] = User("recorder", "recorder")
    for number, program in enumerate(make_sensor_starts(config), 1):
        users[program] = User("sensors" if number == 1 else f"sensors_{number}", "sensors")
    users |= {program: User("pool", "pool") for program in make_pool_starts(config)}
    for number, (program, start) in enumerate(make_agent_starts(config).items(), 1):
        robots = start.config.entities
        if robots:
            # A robot may be named as a role.
            name = f"agent_{robots[0]}" if robots[0] in ROLES else robots[0]
            users[program] = User(name, "agent", robots)
        else:
            users[program] = User("pool" if number == 1 else f"pool_{number}", "pool")
    return users


class NotRecorded(Exception):
    """The recorder failed: the recording ends early, or has a gap."""

    exit_code = ExitCode.NOT_RECORDED


def _launch_and_run(plan: UpPlan, began_s: float, duration: float, *, as_json: bool) -> None:
    stop = StopFlag(is_armed=False)
    with closing(Supervisor(_print_restart)) as supervisor, ExitStack() as stack:
        with _show_progress(len(plan.config.placements)) as progress:
            deployment = launch(plan.config, supervisor, progress, began_s)
        stop.arm()
        should_stop: Callable[[], bool] = stop
        if plan.drive_robots is not None:
            driver = plan.drive_robots(deployment)
            stack.callback(driver.close)
            should_stop = driver.watch(stop)
            deployment.ready_s = time.monotonic() - began_s
        should_stop = say_once_if_slow(deployment, should_stop)
        run_on = partial(supervise, deployment, duration, should_stop)
        with _server_death_explained(plan.config):
            _run_until_stopped(deployment, run_on, plan, as_json=as_json)
    if (recorder := deployment.recorder) is not None and recorder.failures:
        raise NotRecorded(
            f"the recording {plan.config.programs.record} is not whole: the recorder failed "
            f"{recorder.failures} times; 'zensim bag info' shows what it has"
        )


def say_once_if_slow(
    deployment: LocalDeployment, should_stop: Callable[[], bool]
) -> Callable[[], bool]:
    """Say after a while what makes a world faster that is slower than it should be."""
    due_s = time.monotonic() + SLOW_AFTER_S

    def check() -> bool:
        nonlocal due_s
        if time.monotonic() > due_s:
            due_s = inf
            with suppress(NoServer, TimeoutError):
                info = deployment.client.info()
                if 0.0 < info.real_time_factor < SLOW_SHARE * info.target_real_time_factor:
                    print_note("up", f"real-time factor {info.real_time_factor:.2f}; {FASTER}")
        return should_stop()

    return check


@contextmanager
def _server_death_explained(config: LaunchConfig) -> Iterator[None]:
    """Add to the message of a server that died how to get its world back."""
    try:
        yield
    except ProgramDied as error:
        if not str(error).startswith("server "):
            raise
        again = f"the same command with --journal {config.operation.journal} brings its world back"
        never = "its world is lost; with --journal FOLDER the same command brings it back"
        raise ProgramDied(f"{error}; {again if config.operation.journal else never}") from error


def _run_until_stopped(
    deployment: LocalDeployment, run_on: Callable[[], None], plan: UpPlan, *, as_json: bool
) -> None:
    config = deployment.config
    run = LocalRun(
        os.getpid(),
        config.reached_endpoint,
        config.network.world_name,
        len(plan.names),
        deployment.viewer_url,
    )
    with deployment.bus, recorded_run(run):
        _print_ready(deployment, plan, as_json=as_json)
        _open_page(deployment.viewer_url, plan.config.viewer.open_page)
        run_on()
        _print_summary(deployment, as_json=as_json)


def _make_placements(given: UpOptions) -> tuple[RobotPlacement, ...]:
    layout = given.layout or ("row" if given.robots <= MOST_IN_ROW else "grid")
    parse_choice("--layout", layout, LAYOUTS)
    made = make_placements(given.model, given.robots, layout, given.spacing) if given.robots else ()
    return tuple(made)


def _choose_agents(given: UpOptions) -> LaunchAgentsConfig:
    agents, robots = given.agents, given.robots
    is_pooled = agents.agents == "pooled" or (not agents.agents and robots > MAX_AGENT_PROCESSES)
    return LaunchAgentsConfig(
        choose_pool_count(robots, os.cpu_count() or 1) if is_pooled else None,
        given.rates,
        drives_others=agents.drive_others,
    )


def _refuse_pools_that_drive_others(config: LaunchConfig, given: UpOptions) -> None:
    if not given.agents.drive_others and config.agents.pools:
        raise ValueError(
            "--no-drive-others, but pools drive every robot; add --agents per-robot, or in a "
            "scenario name robots under agents"
        )


@contextmanager
def _show_progress(count: int) -> Iterator[LaunchProgress]:
    """Show the numbers of spawned and driven robots if standard error is a terminal."""
    if not console.is_terminal:
        yield LaunchProgress(lambda: None, lambda: None)
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<9}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as progress:
        spawned = progress.add_task("spawned", total=count)
        driving = progress.add_task("driving", total=count)
        yield LaunchProgress(lambda: progress.advance(spawned), lambda: progress.advance(driving))


def _print_ready(deployment: LocalDeployment, plan: UpPlan, *, as_json: bool) -> None:
    config, names = deployment.config, plan.names
    if as_json:
        _print_json(
            {
                "ready_s": round(deployment.ready_s, 3),
                "robots": len(names),
                "endpoint": config.reached_endpoint,
                "engine": deployment.ready_info.engine,
                "viewer": deployment.viewer_url or None,
                "drives_others": config.agents.drives_others,
                "end_s": plan.end_s,
            }
        )
        return
    first = names[0] if names else "NAME"
    where = _make_client_options(config)
    lines = {
        "page": _write_page(deployment) or "none (--no-viewer)",
        "endpoint": config.reached_endpoint,
        "engine": deployment.ready_info.engine,
        "drive": f"zensim drive {first} 0.2 0.5{where}",
        "subscribe": f"zensim echo {first}/odom{where}",
        "others": _describe_others(config.agents),
    }
    if config.client_endpoint != config.reached_endpoint and not config.join_addresses:
        elsewhere = config.client_endpoint.replace("127.0.0.1", socket.gethostname())
        lines["elsewhere"] = f"--connect {elsewhere.replace('[::1]', socket.gethostname())}"
    if plan.end_s is not None:
        lines["end"] = f"at {plan.end_s:g} s of simulation time (--set end.at=null: runs on)"
    print_lines(f"{len(names)} robots ready in {deployment.ready_s:.1f} s")
    for word, line in lines.items():
        print_lines(f"  {word:<10} {line}")
    if config.join_addresses:
        print_users(open_secure_folder(config.network.world_name))
    print_lines("Ctrl-C or 'zensim down' to stop.")


def _write_page(deployment: LocalDeployment) -> str:
    """Write the address of the page, with its token on a terminal only."""
    bare, token = split_token(deployment.viewer_url)
    if not token or sys.stdout.isatty():
        return deployment.viewer_url
    return add_token_of_file(bare, deployment.config.page_token)


def _describe_others(agents: LaunchAgentsConfig) -> str:
    if agents.drives_others:
        return "robots that others spawn are driven by a pool, too (--no-drive-others: not)"
    return "nothing drives robots that others spawn; start: zensim agent NAME"


def _make_client_options(config: LaunchConfig) -> str:
    """Make the options that a client in the same shell needs."""
    default = os.environ.get("ZENSIM_CONNECT") or DEFAULT_ENDPOINT
    connect = f" --connect {config.client_endpoint}" if config.client_endpoint != default else ""
    if config.join_addresses:
        connect = f" --join {config.join_addresses[OPERATOR]}"
    named = os.environ.get("ZENSIM_WORLD") or "default"
    world = config.network.world_name
    return f"{connect} --world-name {world}" if world != named else connect


def _open_page(url: str, open_page: bool | None) -> None:
    """Open the page if the option says so, or by default on a terminal of a desktop."""
    has_desktop = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    should_open = open_page if open_page is not None else has_desktop and sys.stdout.isatty()
    if url and should_open:
        webbrowser.open(url)


def _print_summary(deployment: LocalDeployment, *, as_json: bool) -> None:
    figures = summarize_run(deployment)
    if as_json:
        _print_json(figures)
    else:
        print_lines(f"real-time factor {figures['real_time_factor']:.3f}", err=True)


def _print_json(figures: object) -> None:
    print_lines(msgspec.json.encode(figures).decode())
    sys.stdout.flush()


def _print_restart(program: SupervisedProgram, status: int) -> None:
    fate = "restarting it" if isfinite(program.restart_at_s) else "it is not started again"
    print_lines(f"zensim up: {program.name} exited with status {status}; {fate}", err=True)
