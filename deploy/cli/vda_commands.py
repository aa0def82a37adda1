"""`zensim vda5050`: serve the robots of a world as vehicles of VDA 5050."""

import json
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zensim.proto.bounded_files import read_text_file
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.names import check_name
from zensim.proto.options.command_options import ConnectionOptions, JsonOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.process_limits import raise_file_limit
from zensim.proto.security.role_checks import require_access
from zensim.proto.security.roles import Operation
from zensim.proto.stop_signal import StopFlag
from zensim.proto.topic_catalog import TWISTS
from zensim.proto.verbosity import configure_logging, print_note

if TYPE_CHECKING:
    from zensim.vda5050.broker_links import BrokerAddress

app = make_app()

EXTRA = "paho"
INTERFACES = {"2.0": "uagv", "2.1": "uagv", "3.0": "vda5050"}
"""First level of topics by version, as the standard's examples have it."""
LEVELS = "/+#$"
"""Characters that have a meaning in topics."""


class MissingVdaExtra(Exception):
    """The packages of the vda5050 extra are not installed."""


@dataclass(frozen=True, kw_only=True)
class VdaOptions(ConnectionOptions):
    """All options of `zensim vda5050`."""

    broker: Annotated[
        str, typer.Option(metavar="URL", help="MQTT broker: mqtt://HOST:PORT, or mqtts:// for TLS.")
    ] = "mqtt://127.0.0.1:1883"
    broker_ca: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Authorities to trust instead of the system's, PEM."),
    ] = None
    broker_login: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File with USER:PASSWORD of the broker.")
    ] = None
    standard: Annotated[
        str, typer.Option(metavar="VERSION", help="Version of VDA 5050: 2.0, 2.1 or 3.0.")
    ] = "2.1"
    interface: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="First level of all topics.", show_default="uagv; vda5050 for 3.0"
        ),
    ] = ""
    robots: Annotated[
        str, typer.Option(metavar="PATTERN", help="Robots that are vehicles, as in 'amr*'.")
    ] = "*"
    avoid: Annotated[
        str,
        typer.Option(
            metavar="none|stop", help="Whether vehicles stop before what their boxes would meet."
        ),
    ] = "none"
    state: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Keep orders here, so that a restart continues them."),
    ] = None
    vehicles: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Settings in JSON: speeds, actions, battery."),
    ] = None
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim vda5050 --broker mqtt://127.0.0.1:1883
  zensim vda5050 --standard 3.0 --robots 'amr*' --avoid stop --state vehicles.db"""
)
def vda5050(given: VdaOptions) -> None:
    """Serve the robots of a world as vehicles of VDA 5050 to a fleet manager, until Ctrl-C."""
    with exit_on_failure("vda5050", MissingVdaExtra):
        check_name(given.world_name, "world")
        _check(given)
        if find_spec(EXTRA) is None:
            raise MissingVdaExtra("paho-mqtt is not installed; use pip install 'zensim[vda5050]'")
        _serve(given)


def _check(given: VdaOptions) -> None:
    if given.standard not in INTERFACES:
        raise ValueError(f"`standard` {given.standard[:20]!r} is unknown; use 2.0, 2.1 or 3.0")
    if given.avoid not in ("none", "stop"):
        raise ValueError(f"`avoid` {given.avoid[:20]!r} is unknown; use none or stop")
    if any(one in given.interface for one in LEVELS):
        raise ValueError(f"`interface` {given.interface[:40]!r} has one of {LEVELS}; use letters")


def _read_broker(given: VdaOptions) -> "BrokerAddress":
    from zensim.vda5050.broker_links import parse_broker

    found = parse_broker(given.broker, given.broker_ca)
    if given.broker_login is None:
        return found
    user, colon, password = read_text_file(given.broker_login, 4096).strip().partition(":")
    if not colon or not user:
        raise ValueError(f"`broker_login` {given.broker_login}: write one line USER:PASSWORD")
    return found._replace(user=user, password=password)


def _serve(given: VdaOptions) -> None:
    from zensim.vda5050.broker_links import BrokerLinks
    from zensim.vda5050.fleet_program import FleetProgram, ServedFleet
    from zensim.vda5050.record_store import RecordStore
    from zensim.vda5050.vehicle_settings import FleetSettings, read_settings

    configure_logging()
    stop = StopFlag(is_armed=False)
    settings = read_settings(given.vehicles) if given.vehicles else FleetSettings()
    address, interface = _read_broker(given), given.interface or INTERFACES[given.standard]
    # A vehicle is a connection.
    raise_file_limit()
    options = ServedFleet(
        given.world_name,
        3 if given.standard == "3.0" else 2,
        given.robots,
        given.avoid == "stop",
        settings,
    )
    with open_bus(BusConfig(connect=(given.connect or DEFAULT_ENDPOINT,))) as bus:
        twists = TWISTS.key(given.world_name)
        require_access(bus, given.world_name, Operation.PUBLISH, twists)
        links = BrokerLinks(
            address,
            topic_root=f"{interface}/v{options.major}/{settings.manufacturer}",
            version=f"{given.standard}.0",
            note=partial(print_note, "vda5050"),
        )
        program = FleetProgram(bus, links, RecordStore(given.state), options)
        stop.arm()
        serves = {"vda5050": f"{interface}/v{options.major}/{settings.manufacturer}/+"}
        where = f"vehicles: {serves['vda5050']} at {address.host}:{address.port}"
        print_lines(json.dumps(serves) if given.as_json else where)
        program.run(stop)
