"""`zensim foxglove`: serve the topics of a world to Foxglove."""

import json
import re
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Annotated

import typer

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name, check_namespace
from zensim.proto.options.access_options import AccessOptions
from zensim.proto.options.command_options import (
    ConnectionOptions,
    JsonOption,
    RosDomainOption,
    flag,
)
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.process_limits import raise_niceness
from zensim.proto.ros2.rmw_keys import parse_domain
from zensim.proto.stop_signal import StopFlag
from zensim.proto.verbosity import configure_logging, print_note
from zensim.proto.web_access import PageAccess, make_page_url

app = make_app()

NICENESS = 5
"""A third of the share of others: clients do not delay the simulation where cores are busy."""
EXTRA = "websockets"


class MissingFoxgloveExtra(Exception):
    """The packages of the foxglove extra are not installed."""


@dataclass(frozen=True, kw_only=True)
class FoxgloveOptions(AccessOptions, ConnectionOptions):
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
        typer.Option(
            metavar="ORIGIN",
            help="Admit the page of another site, such as https://app.foxglove.dev; repeatable.",
            rich_help_panel="Access",
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
def foxglove(given: FoxgloveOptions) -> None:
    """Serve the topics of a world to Foxglove, until Ctrl-C."""
    with exit_on_failure("foxglove", MissingFoxgloveExtra):
        check_name(given.world_name, "world")
        for origin in given.allow_origin or ():
            if not re.fullmatch(r"[a-z][a-z0-9+.-]*://[^/]*", origin):
                raise ValueError(
                    f"--allow-origin '{origin[:80]}' is no origin; use SCHEME://HOST[:PORT], such "
                    "as https://app.foxglove.dev"
                )
        if given.layout:
            from zensim.foxglove.panel_layout import write_layout

            print_lines(write_layout(given.world_name, check_namespace(given.robot)))
            return
        if find_spec(EXTRA) is None:
            raise MissingFoxgloveExtra(
                f"{EXTRA} is not installed; use pip install 'zensim[foxglove]'"
            )
        _serve(given, given.make_access("zensim foxglove", given.host, given.connect))


def _serve(given: FoxgloveOptions, access: PageAccess) -> None:
    from zensim.foxglove.foxglove_server import FoxgloveServer, ServedAddress
    from zensim.foxglove.live_hub import LiveHub
    from zensim.foxglove.mesh_files import MeshFiles
    from zensim.foxglove.world_control import WorldControl

    configure_logging()
    stop = StopFlag(is_armed=False)
    world, domain = given.world_name, parse_domain(given.ros_domain)
    address = ServedAddress(given.host, given.port, access, tuple(given.allow_origin or ()))
    raise_niceness(NICENESS)
    with open_bus(BusConfig(connect=(given.connect or DEFAULT_ENDPOINT,))) as bus:
        control = WorldControl(bus, world, domain) if given.allow_control else None
        files = MeshFiles(bus, world)
        hub = LiveHub(bus, world, domain, control=control, read_asset=files.read)
        server = FoxgloveServer(hub, address, partial(print_note, "foxglove"))
        stop.arm()
        url = make_page_url(
            given.host, server.port, access.token, has_tls=bool(access.certificate), protocol="ws"
        )
        print_lines(
            json.dumps({"foxglove": url}) if given.as_json else given.write_address("foxglove", url)
        )
        server.run(stop)
