"""Command line of the server: `zensim serve`."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import typer

from zensim.proto.bus import Bus
from zensim.proto.cli_options import RosOptions, options_from
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.stop_signal import StopFlag
from zensim.sim_server.journal.sqlite_store import JournalError
from zensim.sim_server.pacing.lockstep import LOCKSTEP_TIMEOUT_S, LockstepSettings, OnMiss
from zensim.sim_server.physics.engine_config import (
    Clustering,
    EngineName,
    EngineOptions,
    choose_engine,
    find_installed_engines,
    parse_engine_name,
)
from zensim.sim_server.server_config import (
    CONTROL_HZ,
    ConfigError,
    ServerConfig,
    WorldAlreadyServed,
    make_server_bus_config,
)

SERVER_EXTRA = ("yourdfpy", "lxml", "scipy", "trimesh")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class MissingServerExtra(Exception):
    """The server's packages are not installed."""


ServeConnect = Annotated[
    str, typer.Option(help="Join this router instead of being one.", envvar="ZENSIM_CONNECT")
]
ServeWorldName = Annotated[
    str, typer.Option(help="What the world is called on the network.", envvar="ZENSIM_WORLD")
]
ServeStepHz = Annotated[
    float | None,
    typer.Option(help="Physics steps a simulated second.", show_default="the world's, or 240"),
]
ServeControlHz = Annotated[
    float, typer.Option(help="How often agents are told of a simulated second, at most.")
]
ServeRealTimeFactor = Annotated[
    float | None,
    typer.Option(help="Real-time factor to hold; 0 = flat out.", show_default="the world's, or 1"),
]
ServeModelPath = Annotated[
    list[Path] | None,
    typer.Option(
        help="Folder to look for a world's included models in.", envvar="GAZEBO_MODEL_PATH"
    ),
]
ServeWait = Annotated[float, typer.Option(min=0.0, help="Seconds to wait for the router to join.")]
ServeStrict = Annotated[
    bool, typer.Option("--strict", help="Refuse a world of which anything is suspicious.")
]
ServeJournal = Annotated[
    Path | None,
    typer.Option(
        help="Folder that keeps the world; a server that finds one there goes on with it.",
        envvar="ZENSIM_JOURNAL",
    ),
]
ServeEngine = Annotated[
    str,
    typer.Option(
        help="pybullet or mujoco: what computes physics.",
        show_default="pybullet where it is installed",
        envvar="ZENSIM_ENGINE",
    ),
]
ServeDynamics = Annotated[
    str,
    typer.Option(
        "--dynamics",
        help="How robots move that ask for nothing else: full, kinematic, or auto: full only "
        "where they may touch.",
    ),
]
ServeLockstep = Annotated[
    bool, typer.Option("--lockstep", help="Wait at each control step for every agent's command.")
]
ServeLockstepTimeout = Annotated[
    float, typer.Option(help="Seconds that an agent has for its command, at requested steps too.")
]
ServeOnMiss = Annotated[
    str,
    typer.Option(help="After that: wait on, hold the old targets and go on, or fail: stand still."),
]
ServeClusters = Annotated[
    str,
    typer.Option(
        help="Step robots that cannot touch apart: auto (when there are many), on or off."
    ),
]
ServeEngineWorkers = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Processes beside the server's own that step clusters.",
        show_default="a process for each further core",
    ),
]


def parse_clustering(word: str) -> Clustering:
    """Read when worlds are to be clustered.

    Raises:
        BadParameter: There is no such word.
    """
    for known in get_args(Clustering):
        if known == word:
            return known  # type: ignore[no-any-return]
    raise typer.BadParameter(
        f"--clusters {word!r} is unknown; use {', '.join(get_args(Clustering))}"
    )


def parse_dynamics(word: str) -> Dynamics:
    """Read how entities move that do not ask for any dynamics.

    Raises:
        BadParameter: There is no such way.
    """
    for known in get_args(Dynamics):
        if known and known == word:
            return known  # type: ignore[no-any-return]
    kinds = ", ".join(known for known in get_args(Dynamics) if known)
    raise typer.BadParameter(f"--dynamics {word!r} is unknown; use {kinds}")


def parse_on_miss(word: str) -> OnMiss:
    """Read what is to be done when an agent is late.

    Raises:
        BadParameter: There is no such policy.
    """
    for known in get_args(OnMiss):
        if known == word:
            return known  # type: ignore[no-any-return]
    raise typer.BadParameter(f"--on-miss {word!r} is unknown; use {', '.join(get_args(OnMiss))}")


def parse_engine(word: str) -> EngineName | None:
    """Read which engine is asked for.

    Raises:
        BadParameter: There is no such engine.
    """
    try:
        return parse_engine_name(word)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


@dataclass(frozen=True, kw_only=True)
class ServeOptions(RosOptions):
    """What a server is told."""

    listen: Annotated[str, typer.Option(help="Endpoint to be the router at.")] = ""
    connect: ServeConnect = ""
    wait: ServeWait = 30.0
    world: Annotated[str, typer.Option(help="Shipped world, or path of an SDF file.")] = "empty"
    world_name: ServeWorldName = "default"
    step_hz: ServeStepHz = None
    control_hz: ServeControlHz = CONTROL_HZ
    rtf: ServeRealTimeFactor = None
    paused: Annotated[bool, typer.Option("--paused", help="Start with time standing.")] = False
    seed: Annotated[int, typer.Option(help="Seed of the world's random draws.")] = 0
    model_path: ServeModelPath = None
    strict: ServeStrict = False
    dynamics: ServeDynamics = "full"
    journal: ServeJournal = None
    engine: ServeEngine = ""
    lockstep: ServeLockstep = False
    lockstep_timeout: ServeLockstepTimeout = LOCKSTEP_TIMEOUT_S
    on_miss: ServeOnMiss = "hold"
    clusters: ServeClusters = "auto"
    engine_workers: ServeEngineWorkers = None
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log every event.")] = False


@app.command()
@options_from(ServeOptions)
def serve(given: ServeOptions) -> None:
    """Run a world and serve it on the network."""
    _configure_logging(is_verbose=given.verbose)
    stop = StopFlag()
    with exit_on_failure("serve"):
        config = _make_server_config(given)
    _run_server(config, stop)


def _make_server_config(given: ServeOptions) -> ServerConfig:
    if given.listen and given.connect:
        raise typer.BadParameter("--listen and --connect exclude each other; give one")
    on_miss = parse_on_miss(given.on_miss)
    return ServerConfig(
        bus=make_server_bus_config(given.listen, given.connect),
        world=given.world_name,
        world_file=given.world,
        step_hz=given.step_hz,
        control_hz=given.control_hz,
        real_time_factor=given.rtf,
        is_paused=given.paused,
        seed=given.seed,
        model_paths=tuple(map(str, given.model_path or ())),
        is_strict=given.strict,
        wait_s=given.wait,
        journal=str(given.journal or ""),
        lockstep=LockstepSettings(given.lockstep, given.lockstep_timeout, on_miss),
        ros=given.ros,
        physics=EngineOptions(
            engine=parse_engine(given.engine),
            clusters=parse_clustering(given.clusters),
            dynamics=parse_dynamics(given.dynamics),
            workers=given.engine_workers,
        ),
    )


def _configure_logging(*, is_verbose: bool) -> None:
    logging.basicConfig(
        level=logging.INFO if is_verbose else logging.WARNING,
        format="%(levelname)s %(name)s %(message)s",
        stream=sys.stderr,
    )


def _run_server(config: ServerConfig, stop: StopFlag) -> None:
    def announce(bus: Bus, config: ServerConfig) -> None:
        typer.echo(
            f"zensim serve: world '{config.world}' at {bus.endpoint} "
            f"({config.step_hz:g} Hz, real-time factor {config.real_time_factor:g}, "
            f"{choose_engine(config.physics, find_installed_engines())})",
            err=True,
        )

    with exit_on_failure(
        "serve", ConfigError, WorldAlreadyServed, JournalError, MissingServerExtra
    ):
        _import_server()(config, stop, announce)


def _import_server() -> Callable[..., None]:
    with server_extra():
        from zensim.sim_server.server import run_server
    return run_server


@contextmanager
def server_extra() -> Iterator[None]:
    """Import what only the server's extra brings.

    Raises:
        MissingExtra: It is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in SERVER_EXTRA:
            raise
        raise MissingServerExtra(
            f"{error.name} is not installed; use pip install 'zensim[server]'"
        ) from error
