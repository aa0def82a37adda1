"""`zensim foxglove`: serve the topics of a world to Foxglove."""

import json
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from zensim.proto.bus import BusConfig, open_bus
from zensim.proto.cli_options import (
    ConnectionOptions,
    JsonOption,
    RosDomainOption,
    expand_options,
    flag,
    make_app,
)
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name, check_namespace
from zensim.proto.printable_text import print_lines
from zensim.proto.process_limits import raise_niceness
from zensim.proto.ros2.rmw_keys import parse_domain
from zensim.proto.stop_signal import StopFlag
from zensim.proto.verbosity import print_note
from zensim.proto.web_access import (
    PageAccess,
    check_certificate,
    check_page_exposure,
    make_page_url,
    read_page_token,
)

app = make_app()

NICENESS = 5
"""A third of the share of others: clients do not delay the simulation where cores are busy."""
EXTRA = "websockets"
_access = partial(typer.Option, rich_help_panel="Access")


class MissingFoxgloveExtra(Exception):
    """The packages of the foxglove extra are not installed."""


@dataclass(frozen=True, kw_only=True)
class FoxgloveOptions(ConnectionOptions):
    """All options of `zensim foxglove`."""

    host: Annotated[str, typer.Option(metavar="ADDRESS", help="Address to serve on.")] = "127.0.0.1"
    port: Annotated[
        int, typer.Option(min=0, max=65535, metavar="PORT", help="TCP port; 0 = any free.")
    ] = 8765
    allow_control: Annotated[
        bool,
        flag(
            "--allow-control",
            help="Let clients drive robots, call services, and set the real-time factor.",
            rich_help_panel="Access",
        ),
    ] = False
    allow_origin: Annotated[
        list[str] | None,
        _access(
            metavar="ORIGIN",
            help="Admit the page of another site, such as https://app.foxglove.dev; repeatable.",
        ),
    ] = None
    secure: Annotated[
        bool, _access("--secure", metavar="", help="Serve only clients that have the token.")
    ] = False
    insecure: Annotated[
        bool, _access("--insecure", metavar="", help="Serve every client, also on other hosts.")
    ] = False
    certificate: Annotated[
        Path | None, _access("--certificate", metavar="FILE", help="Certificate and chain, PEM.")
    ] = None
    key: Annotated[
        Path | None, _access("--key", metavar="FILE", help="Private key of the certificate, PEM.")
    ] = None
    page_token: Annotated[
        Path | None,
        _access(
            "--page-token",
            metavar="FILE",
            help="File of the token, made if it is missing, so that the address stays the same.",
        ),
    ] = None
    layout: Annotated[bool, flag("--layout", help="Print a layout for Foxglove, and exit.")] = False
    robot: Annotated[
        str, typer.Option(metavar="NAMESPACE", help="Robot that the layout plots and drives.")
    ] = "r1"
    ros_domain: RosDomainOption = "0"
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim foxglove --allow-origin https://app.foxglove.dev
  zensim foxglove --allow-control
  zensim foxglove --layout > zensim.foxglove.json"""
)
@expand_options
def foxglove(given: FoxgloveOptions) -> None:
    """Serve the topics of a world to Foxglove, until Ctrl-C."""
    with exit_on_failure("foxglove", MissingFoxgloveExtra):
        check_name(given.world_name, "world")
        if given.layout:
            from zensim.foxglove.panel_layout import write_layout

            print_lines(write_layout(given.world_name, check_namespace(given.robot)))
            return
        if find_spec(EXTRA) is None:
            raise MissingFoxgloveExtra(
                f"{EXTRA} is not installed; use pip install 'zensim[foxglove]'"
            )
        check_page_exposure(
            "zensim foxglove",
            given.host,
            has_tls=check_certificate(given.certificate, given.key),
            is_secure=given.secure,
            is_insecure=given.insecure,
        )
        _serve(given, read_page_token(given.page_token) if given.secure else "")


def _serve(given: FoxgloveOptions, token: str) -> None:
    from zensim.foxglove.foxglove_server import FoxgloveServer, ServedAddress
    from zensim.foxglove.live_hub import LiveHub
    from zensim.foxglove.mesh_files import MeshFiles
    from zensim.foxglove.world_control import WorldControl

    stop = StopFlag(is_armed=False)
    world, domain = given.world_name, parse_domain(given.ros_domain)
    access = PageAccess(token, str(given.certificate or ""), str(given.key or ""))
    address = ServedAddress(given.host, given.port, access, tuple(given.allow_origin or ()))
    raise_niceness(NICENESS)
    with open_bus(BusConfig(connect=(given.connect or DEFAULT_ENDPOINT,))) as bus:
        control = WorldControl(bus, world, domain) if given.allow_control else None
        files = MeshFiles(bus, world)
        hub = LiveHub(bus, world, domain, control=control, read_asset=files.read)
        server = FoxgloveServer(hub, address, partial(print_note, "foxglove"))
        stop.arm()
        url = make_page_url(
            given.host, server.port, token, has_tls=given.certificate is not None, protocol="ws"
        )
        print_lines(json.dumps({"foxglove": url}) if given.as_json else f"foxglove {url}")
        server.run(stop)
