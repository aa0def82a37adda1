"""`zensim view`: serve a web page that shows the world in 3D."""

import json
import webbrowser
from collections.abc import Callable
from contextlib import closing
from importlib.util import find_spec
from typing import Annotated

import typer

from zensim.proto.bus import BusConfig, open_bus
from zensim.proto.cli_options import ConnectionOptions, JsonOption, expand_options, make_app
from zensim.proto.endpoints import DEFAULT_ENDPOINT, is_port_taken
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.stop_signal import StopFlag

app = make_app()

VIEWER_EXTRA = ("viser", "websockets")
ANY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Address in the printed URL of a page that is served on all addresses."""


class MissingViewerExtra(Exception):
    """The packages of the viewer extra are not installed."""


def check_page(port: int) -> None:
    """Check that a page can be served on a port of this host, before anything else is started.

    Raises:
        MissingViewerExtra: A package is missing.
        OSError: Another program listens on the port.
    """
    missing = [name for name in VIEWER_EXTRA if find_spec(name) is None]
    if missing:
        raise MissingViewerExtra(
            f"{missing[0]} is not installed; use pip install 'zensim[viewer]', or --no-viewer"
        )
    if port and is_port_taken("127.0.0.1", port):
        raise OSError(
            f"another program listens on port {port} of this host; use --viewer-port with "
            "another, 0 for any free one, or --no-viewer"
        )


@app.command(
    epilog="""Examples:
  zensim view --open
  zensim view --host 0.0.0.0 --port 9000"""
)
@expand_options
def view(
    *,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Address to serve the page on.")
    ] = "127.0.0.1",
    port: Annotated[
        int,
        typer.Option(min=0, max=65535, metavar="PORT", help="TCP port of the page; 0 = any free."),
    ] = 8080,
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", metavar="", help="Open the page in a browser.")
    ] = False,
    as_json: JsonOption = False,
    server: ConnectionOptions,
) -> None:
    """Serve a web page that shows the world in 3D, until Ctrl-C."""

    def announce(page_port: int) -> None:
        name = ANY_ADDRESS.get(host, host)
        url = f"http://{f'[{name}]' if ':' in name else name}:{page_port}"
        typer.echo(json.dumps({"viewer": url}) if as_json else f"viewer {url}")
        if open_page:
            webbrowser.open(url)

    stop = StopFlag()
    with exit_on_failure("view", MissingViewerExtra):
        check_name(server.world_name, "world")
        config = BusConfig(connect=(server.connect or DEFAULT_ENDPOINT,))
        _serve_page(config, server.world_name, host=host, port=port, announce=announce, stop=stop)


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
