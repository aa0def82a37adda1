"""`zensim serve` and `zensim model`."""

import json
import logging
import signal
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from proto.bus import Bus, BusError
from sim_server.config import ConfigError, ServerConfig, server_bus
from sim_server.errors import SimError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

FAILED, USAGE, NOT_FOUND, UNREACHABLE = 1, 2, 3, 4


class _Stop:
    """Set by the first SIGINT or SIGTERM."""

    def __init__(self) -> None:
        self.is_set = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._set)

    def _set(self, _number: int, _frame: object) -> None:
        self.is_set = True


@app.command()
def serve(
    *,
    listen: Annotated[str, typer.Option(help="Endpoint to be the router at.")] = "",
    connect: Annotated[
        str, typer.Option(help="Join this router instead of being one.", envvar="ZENSIM_CONNECT")
    ] = "",
    world: Annotated[str, typer.Option(help="Shipped world, or path of an SDF file.")] = "empty",
    world_name: Annotated[
        str, typer.Option(help="What the world is called on the network.", envvar="ZENSIM_WORLD")
    ] = "default",
    step_hz: Annotated[float, typer.Option(help="Physics steps a simulated second.")] = 240.0,
    rtf: Annotated[float, typer.Option(help="Real-time factor to hold; 0 = flat out.")] = 1.0,
    paused: Annotated[bool, typer.Option("--paused", help="Start with time standing.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the world's random draws.")] = 0,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log every event.")] = False,
) -> None:
    """Run a world and serve it on the network."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(levelname)s %(name)s %(message)s",
        stream=sys.stderr,
    )
    if listen and connect:
        _fail("serve", "--listen and --connect exclude each other; give one", USAGE)
    stop = _Stop()
    config = ServerConfig(
        bus=server_bus(listen, connect),
        world=world_name,
        world_file=world,
        step_hz=step_hz,
        real_time_factor=rtf,
        is_paused=paused,
        seed=seed,
    )
    _serve(config, stop)


def _serve(config: ServerConfig, stop: _Stop) -> None:
    try:
        from sim_server.server import AlreadyServed
        from sim_server.server import serve as run_server
    except ModuleNotFoundError as error:
        _fail("serve", f"{error.name} is not installed; use pip install 'zensim[server]'", FAILED)

    def announce(bus: Bus) -> None:
        typer.echo(
            f"zensim serve: world '{config.world}' at {bus.endpoint} "
            f"({config.step_hz:g} Hz, real-time factor {config.real_time_factor:g})",
            err=True,
        )

    try:
        run_server(config, lambda: stop.is_set, announce)
    except (ConfigError, ValueError) as error:
        _fail("serve", str(error), USAGE)
    except (AlreadyServed, BusError) as error:
        _fail("serve", str(error), UNREACHABLE if "nobody listens" in str(error) else FAILED)


@app.command()
def model(
    file: Annotated[str, typer.Argument(help="URDF file, or the name of a shipped model.")],
    *,
    package_path: Annotated[
        list[Path] | None, typer.Option(help="Folder to look for package:// meshes in.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what a description says, without any server."""
    from sim_server.description.show import model_json, model_tree

    try:
        found = _read_model(file, package_path or [])
    except SimError as error:
        _fail("model", str(error), FAILED)
    except OSError as error:
        _fail("model", f"{file}: {error.strerror}", NOT_FOUND)
    typer.echo(json.dumps(model_json(found)) if as_json else model_tree(found))


def _fail(command: str, message: str, status: int) -> NoReturn:
    typer.echo(f"zensim {command}: {message}", err=True)
    raise typer.Exit(status)
