"""`zensim up`: server, robots, agents and page on this machine, from one command."""

import os
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from zensim.deploy.launcher import (
    LaunchAgentsConfig,
    LaunchConfig,
    LaunchFailed,
    LaunchProgress,
    LocalDeployment,
    choose_pool_count,
    launch,
    summarize_run,
    supervise,
)
from zensim.deploy.supervisor import ProgramDied, SupervisedProgram, Supervisor
from zensim.proto.bus import DEFAULT_ENDPOINT, with_free_port
from zensim.proto.cli_options import RosTfOptions, options_from
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.stop_signal import StopFlag
from zensim.spawner.cli.spawn_arguments import parse_dynamics
from zensim.spawner.spawn.spawn_poses import (
    LAYOUTS,
    RobotPlacement,
    derive_prefix,
    make_fleet_layout,
)

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

console = Console(stderr=True)
MAX_AGENT_PROCESSES = 20
"""Robots that have an agent process each unless it is said otherwise: each is 40 MB."""


Robots = Annotated[int, typer.Option("--robots", min=0, help="How many.")]
ModelOption = Annotated[str, typer.Option("--model", help="Shipped model, or path of a URDF.")]
LayoutName = Annotated[str, typer.Option("--layout", help="row, grid or circle.")]
Spacing = Annotated[float, typer.Option("--spacing", help="Metres between neighbours.")]
WorldFile = Annotated[str, typer.Option("--world", help="Shipped world, or path of an SDF file.")]
WorldName = Annotated[
    str,
    typer.Option("--world-name", help="What it is called on the network.", envvar="ZENSIM_WORLD"),
]
Listen = Annotated[str, typer.Option("--listen", help="Endpoint to serve at.")]
RealTimeFactor = Annotated[
    float | None,
    typer.Option(
        "--rtf", help="Real-time factor to hold; 0 = flat out.", show_default="the world's, or 1"
    ),
]
ModelPath = Annotated[
    list[Path] | None,
    typer.Option(
        "--model-path", help="Folder to look for a world's models in.", envvar="GAZEBO_MODEL_PATH"
    ),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Refuse a world of which anything is suspicious.")
]
HasViewer = Annotated[bool, typer.Option("--viewer/--no-viewer", help="Serve the 3D page.")]
ViewerPort = Annotated[int, typer.Option("--viewer-port", help="Port of the page.")]
OpenPage = Annotated[
    bool | None, typer.Option("--open/--no-open", help="Open the page in a browser.")
]
Duration = Annotated[
    float, typer.Option("--duration", help="Seconds once ready; 0 = until Ctrl-C.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON lines.")]
Engine = Annotated[
    str,
    typer.Option(
        "--engine",
        help="pybullet or mujoco: what computes physics.",
        show_default="pybullet where it is installed",
        envvar="ZENSIM_ENGINE",
    ),
]
Locked = Annotated[
    bool, typer.Option("--lockstep", help="Wait at each control step for every agent's command.")
]
Agents = Annotated[
    str,
    typer.Option(
        "--agents",
        help="per-robot: a process for each; pooled: a few processes that drive many each.",
        show_default=f"per-robot up to {MAX_AGENT_PROCESSES} robots",
    ),
]
OdomHz = Annotated[
    float | None,
    typer.Option(
        "--odom-hz",
        min=0.0,
        help="Odometry of each robot, and tf unless told, a simulated second.",
        show_default="as described",
    ),
]
TfHz = Annotated[
    float | None,
    typer.Option("--tf-hz", min=0.0, help="tf of each robot.", show_default="with odometry"),
]

DynamicsWord = Annotated[
    str, typer.Option("--dynamics", help="How robots move: full, kinematic, or auto.")
]
ClustersWord = Annotated[
    str, typer.Option("--clusters", help="Step robots that cannot touch apart: auto, on or off.")
]
EngineWorkers = Annotated[
    int | None,
    typer.Option(
        "--engine-workers",
        min=0,
        help="Processes beside the server's own that step clusters.",
        show_default="a process for each further core",
    ),
]


@dataclass(frozen=True, kw_only=True)
class UpOptions(RosTfOptions):
    """What is run."""

    robots: Robots = 10
    model: ModelOption = "box_bot"
    layout: LayoutName = "row"
    spacing: Spacing = 1.0
    world: WorldFile = "empty"
    world_name: WorldName = "default"
    listen: Listen = DEFAULT_ENDPOINT
    rtf: RealTimeFactor = None
    model_path: ModelPath = None
    strict: Strict = False
    lockstep: Locked = False
    engine: Engine = ""
    clusters: ClustersWord = "auto"
    engine_workers: EngineWorkers = None
    agents: Agents = ""
    odom_hz: OdomHz = None
    tf_hz: TfHz = None
    dynamics: DynamicsWord = "full"
    viewer: HasViewer = True
    viewer_port: ViewerPort = 8080
    open_page: OpenPage = None
    duration: Duration = 0.0
    as_json: AsJson = False


@app.command()
@options_from(UpOptions)
def up(given: UpOptions) -> None:
    """Run a world, its robots, their agents and the page, all on this machine."""
    began_s = time.monotonic()
    with exit_on_failure("up", LaunchFailed, ProgramDied):
        _launch_and_run(
            _make_config(given), began_s, given.duration, given.open_page, as_json=given.as_json
        )


def _make_config(given: UpOptions) -> LaunchConfig:
    return LaunchConfig(
        places=_make_places(given.model, given.robots, given.layout, given.spacing),
        model=given.model,
        world=given.world,
        world_name=check_name(given.world_name, "world name"),
        endpoint=with_free_port(given.listen),
        real_time_factor=given.rtf,
        model_paths=tuple(map(str, given.model_path or ())),
        is_strict=given.strict,
        is_lockstep=given.lockstep,
        dynamics=parse_dynamics(given.dynamics),
        engine=given.engine,
        clusters=given.clusters,
        engine_workers=given.engine_workers,
        ros=given.ros,
        agents=_choose_agents(given.agents, given.robots, given.odom_hz, given.tf_hz),
        has_viewer=given.viewer,
        viewer_port=given.viewer_port,
    )


def _launch_and_run(
    config: LaunchConfig, began_s: float, duration: float, open_page: bool | None, *, as_json: bool
) -> None:
    stop = StopFlag(is_armed=False)
    with closing(Supervisor(_print_restart)) as supervisor:
        with _show_progress(len(config.places)) as steps:
            demo = launch(config, supervisor, steps, began_s)
        stop.arm()
        _run_until_stopped(
            demo, partial(supervise, demo, duration, stop), open_page, as_json=as_json
        )


def _run_until_stopped(
    demo: LocalDeployment, run_on: Callable[[], None], open_page: bool | None, *, as_json: bool
) -> None:
    with demo.bus:
        _print_ready(demo, as_json=as_json)
        _open_page_if_wanted(demo.viewer_url, open_page)
        run_on()
        _print_summary(demo, as_json=as_json)


def _make_places(model: str, count: int, layout: str, spacing: float) -> tuple[RobotPlacement, ...]:
    if (shape := next((known for known in LAYOUTS if known == layout), None)) is None:
        raise ValueError(f"--layout {layout!r} is unknown; use {', '.join(LAYOUTS)}")
    return tuple(make_fleet_layout(derive_prefix(model), count, shape, spacing)) if count else ()


def _choose_agents(
    agents: str, robots: int, odom_hz: float | None, tf_hz: float | None
) -> LaunchAgentsConfig:
    """Choose what drives the robots."""
    if agents not in ("", "per-robot", "pooled"):
        raise ValueError(f"--agents {agents!r} is unknown; use per-robot or pooled")
    if agents == "per-robot" or (not agents and robots <= MAX_AGENT_PROCESSES):
        return LaunchAgentsConfig(None, odom_hz, tf_hz)
    return LaunchAgentsConfig(choose_pool_count(robots, os.cpu_count() or 1), odom_hz, tf_hz)


@contextmanager
def _show_progress(count: int) -> Iterator[LaunchProgress]:
    """Show robots as they come up; silent when standard error is no terminal."""
    columns = (TextColumn("{task.description:<9}"), BarColumn(), MofNCompleteColumn())
    with Progress(
        *columns,
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
        transient=True,
    ) as progress:
        spawned = progress.add_task("spawned", total=count)
        driving = progress.add_task("driving", total=count)
        yield LaunchProgress(lambda: progress.advance(spawned), lambda: progress.advance(driving))


def _print_ready(demo: LocalDeployment, *, as_json: bool) -> None:
    config = demo.config
    if as_json:
        _print_json(
            {
                "ready_s": round(demo.ready_s, 3),
                "robots": len(config.places),
                "endpoint": config.endpoint,
                "viewer": demo.viewer_url or None,
            }
        )
        return
    first = config.places[0].name if config.places else "NAME"
    elsewhere = "" if config.endpoint == DEFAULT_ENDPOINT else f" --connect {config.endpoint}"
    lines = {
        "page": demo.viewer_url or "none (--no-viewer)",
        "endpoint": config.endpoint,
        "drive": f"zensim drive {first} 0.2 0.5{elsewhere}",
        "subscribe": f"zensim echo {first}/odom{elsewhere}",
    }
    typer.echo(f"{len(config.places)} robots ready in {demo.ready_s:.1f} s")
    for word, line in lines.items():
        typer.echo(f"  {word:<10} {line}")
    typer.echo("Ctrl-C ends everything.")


def _open_page_if_wanted(url: str, open_page: bool | None) -> None:
    """Open the page when asked, or when a person at a desktop is likely to want it."""
    has_desktop = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    is_wanted = open_page if open_page is not None else has_desktop and sys.stdout.isatty()
    if url and is_wanted:
        webbrowser.open(url)


def _print_summary(demo: LocalDeployment, *, as_json: bool) -> None:
    figures = summarize_run(demo)
    if as_json:
        _print_json(figures)
    else:
        typer.echo(f"real-time factor {figures['real_time_factor']:.3f}", err=True)


def _print_json(figures: object) -> None:
    typer.echo(msgspec.json.encode(figures).decode())
    sys.stdout.flush()


def _print_restart(program: SupervisedProgram, status: int) -> None:
    typer.echo(f"zensim up: {program.name} ended with status {status}; starting it again", err=True)
