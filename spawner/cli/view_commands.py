"""`zensim view`: serve the 3D page of a world."""

import webbrowser
from collections.abc import Callable
from contextlib import closing
from typing import Annotated

import typer

from zensim.proto.bus import DEFAULT_ENDPOINT, BusConfig, open_bus
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.stop_signal import StopFlag
from zensim.spawner.cli.command_session import Connect, WorldName

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

VIEWER_EXTRA = ("viser", "websockets")
ANY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""A page that is served on every address is opened on this one."""


class MissingViewerExtra(Exception):
    """The page's packages are not installed."""


@app.command()
def view(
    *,
    connect: Connect = "",
    world_name: WorldName = "default",
    host: Annotated[str, typer.Option(help="Address to serve the page on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 = any free port.")] = 8080,
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in a browser.")
    ] = False,
) -> None:
    """Show the world on a 3D page, whose address is printed; Ctrl-C ends it."""

    def announce(page_port: int) -> None:
        name = ANY_ADDRESS.get(host, host)
        url = f"http://{f'[{name}]' if ':' in name else name}:{page_port}"
        typer.echo(f"viewer {url}")
        if open_page:
            webbrowser.open(url)

    stop = StopFlag()
    with exit_on_failure("view", MissingViewerExtra):
        check_name(world_name, "world")
        config = BusConfig(connect=(connect or DEFAULT_ENDPOINT,))
        _serve_page(config, world_name, host=host, port=port, announce=announce, stop=stop)


def _serve_page(
    config: BusConfig,
    world: str,
    *,
    host: str,
    port: int,
    announce: Callable[[int], None],
    stop: StopFlag,
) -> None:
    try:
        from zensim.spawner.page.viewer_loop import Viewer
        from zensim.spawner.page.viewer_page import ViewerPage
    except ModuleNotFoundError as error:
        if error.name not in VIEWER_EXTRA:
            raise
        raise MissingViewerExtra(
            f"{error.name} is not installed; use pip install 'zensim[viewer]'"
        ) from error
    with open_bus(config) as bus, closing(ViewerPage(host, port)) as page:
        viewer = Viewer(bus, page, world)
        announce(page.port)
        while not stop.is_set:
            viewer.tick()
