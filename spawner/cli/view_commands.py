"""`zensim view`: serve a web page that shows the world in 3D."""

import json
import os
import re
import secrets
import webbrowser
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from zensim.proto.bus import BusConfig, open_bus
from zensim.proto.cli_options import ConnectionOptions, JsonOption, expand_options, make_app
from zensim.proto.endpoints import DEFAULT_ENDPOINT, Exposed, is_loopback, is_port_taken
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.printable_text import print_lines
from zensim.proto.process_limits import raise_niceness
from zensim.proto.stop_signal import StopFlag

app = make_app()

TOKEN_BYTES = 16
TOKEN_PATTERN = re.compile(r"[A-Za-z0-9_-]{22,}")
PAGE_NICENESS = 5
"""A third of the share of others: visitors do not delay the simulation where cores are busy."""
_access = partial(typer.Option, rich_help_panel="Access")
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


@dataclass(frozen=True, kw_only=True)
class ViewOptions(ConnectionOptions):
    """All options of `zensim view`."""

    host: Annotated[str, typer.Option(metavar="ADDRESS", help="Address to serve the page on.")] = (
        "127.0.0.1"
    )
    port: Annotated[
        int,
        typer.Option(min=0, max=65535, metavar="PORT", help="TCP port of the page; 0 = any free."),
    ] = 8080
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", metavar="", help="Open the page in a browser.")
    ] = False
    secure: Annotated[
        bool, _access("--secure", metavar="", help="Serve only browsers that have the token.")
    ] = False
    insecure: Annotated[
        bool, _access("--insecure", metavar="", help="Serve everybody, also on other hosts.")
    ] = False
    certificate: Annotated[
        Path | None,
        _access("--certificate", metavar="FILE", help="Certificate and chain of HTTPS, PEM."),
    ] = None
    key: Annotated[
        Path | None, _access("--key", metavar="FILE", help="Private key of the certificate, PEM.")
    ] = None
    page_token: Annotated[
        Path | None,
        _access(
            "--page-token",
            metavar="FILE",
            help="File of the token, made if it is missing, so that the page keeps its address.",
        ),
    ] = None
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim view --open
  zensim view --host 0.0.0.0 --port 9000 --secure --certificate page.pem --key page.key"""
)
@expand_options
def view(given: ViewOptions) -> None:
    """Serve a web page that shows the world in 3D, until Ctrl-C."""
    stop = StopFlag()
    with exit_on_failure("view", MissingViewerExtra):
        check_name(given.world_name, "world")
        check_page_exposure(
            given.host,
            has_tls=check_certificate(given.certificate, given.key),
            is_secure=given.secure,
            is_insecure=given.insecure,
        )
        _serve_page(given, read_page_token(given.page_token) if given.secure else "", stop)


def check_certificate(certificate: Path | None, key: Path | None) -> bool:
    """Return whether the page is served by HTTPS.

    Raises:
        ValueError: Only one of the files is given.
    """
    if (certificate is None) != (key is None):
        raise ValueError("--certificate and --key belong together; give both or none")
    return certificate is not None


def check_page_exposure(host: str, *, has_tls: bool, is_secure: bool, is_insecure: bool) -> None:
    """Refuse to serve other hosts unless the user says how.

    Raises:
        Exposed: The address is not on loopback, and nothing is chosen, or no certificate is there.
        ValueError: Both are chosen.
    """
    if is_secure and is_insecure:
        raise ValueError("--secure and --insecure exclude each other; give one of them")
    if is_loopback(host) or is_insecure:
        return
    if not is_secure:
        raise Exposed(
            f"the page on {host} could be opened from other hosts by everybody; type 'zensim view "
            f"--host {host} --secure --certificate FILE --key FILE', or add --insecure in a "
            "network that you trust"
        )
    if not has_tls:
        raise Exposed(
            f"the token of a page on {host} could be read on its way; add --certificate FILE "
            "--key FILE, or serve it on 127.0.0.1"
        )


def read_page_token(path: Path | None) -> str:
    """Read the token of the page from its file; make both if the file is missing.

    Raises:
        OSError: The file cannot be read or written.
        ValueError: It has no token.
    """
    if path is None:
        return secrets.token_urlsafe(TOKEN_BYTES)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if not TOKEN_PATTERN.fullmatch(token := path.read_text("ascii").strip()):
            raise ValueError(
                f"{path} has no token of 22 or more letters, digits, '-' and '_'; remove the file"
            ) from None
        return token
    with os.fdopen(descriptor, "w") as file:
        file.write(token := secrets.token_urlsafe(TOKEN_BYTES))
    return token


def make_page_url(host: str, port: int, token: str, *, has_tls: bool) -> str:
    """Make the address of the page as a browser on this host opens it."""
    name = ANY_ADDRESS.get(host, host)
    query = f"/?zensim_token={token}" if token else ""
    return f"http{'s' if has_tls else ''}://{f'[{name}]' if ':' in name else name}:{port}{query}"


def _serve_page(given: ViewOptions, token: str, stop: StopFlag) -> None:
    try:
        from zensim.spawner.page.page_server import PageAccess
        from zensim.spawner.page.viewer_loop import Viewer
        from zensim.spawner.page.viewer_page import ViewerPage
    except ModuleNotFoundError as error:
        if error.name not in VIEWER_EXTRA:
            raise
        raise MissingViewerExtra(
            f"{error.name} is not installed; use pip install 'zensim[viewer]'"
        ) from error
    access = PageAccess(token, str(given.certificate or ""), str(given.key or ""))
    config = BusConfig(connect=(given.connect or DEFAULT_ENDPOINT,))
    raise_niceness(PAGE_NICENESS)
    with open_bus(config) as bus, closing(ViewerPage(given.host, given.port, access)) as page:
        viewer = Viewer(bus, page, given.world_name)
        _announce(given, page.port, token)
        while not stop.is_set:
            viewer.tick()


def _announce(given: ViewOptions, port: int, token: str) -> None:
    url = make_page_url(given.host, port, token, has_tls=given.certificate is not None)
    print_lines(json.dumps({"viewer": url}) if given.as_json else f"viewer {url}")
    if given.open_page:
        webbrowser.open(url)
