"""Serves the web page of `zensim view`, and its options."""

import json
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from importlib.util import find_spec
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.endpoints import DEFAULT_ENDPOINT, is_port_taken
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.names import check_name
from zensim.proto.network_protocols import FollowingNetwork
from zensim.proto.options.access_options import AccessOptions
from zensim.proto.options.command_options import ConnectionOptions, JsonOption, flag
from zensim.proto.printable_text import print_lines
from zensim.proto.process_limits import raise_niceness
from zensim.proto.security.roles import ROLES
from zensim.proto.service_catalog import INFO, SPAWN_ENTITY
from zensim.proto.stop_signal import StopFlag
from zensim.proto.verbosity import print_note
from zensim.proto.web_access import make_page_url

if TYPE_CHECKING:
    from zensim.spawner.page.robot_driver import RobotDriver
    from zensim.spawner.page.viewer_client import PanelFactory

PAGE_NICENESS = 5
"""A third of the CPU share of niceness 0, so that visitors do not delay the simulation."""
INFO_TIMEOUT_S = 2.0
VIEWER_EXTRA = ("viser", "websockets")


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
            f"another program listens on port {port} of this host; use --port with "
            "another, 0 for any free one, or --no-viewer"
        )


@dataclass(frozen=True, kw_only=True)
class ViewOptions(AccessOptions, ConnectionOptions):
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
    read_only: Annotated[
        bool,
        flag(
            "--read-only",
            help="Visitors look; nothing can be changed or driven.",
            rich_help_panel="Access",
        ),
    ] = False
    as_json: JsonOption = False


class PageSource(NamedTuple):
    """What a page shows, and how visitors act on it."""

    network: FollowingNetwork
    world: str
    driver: "RobotDriver | None" = None
    """Publishes commands; None = visitors may look only."""
    panels: "Mapping[str, PanelFactory]" = MappingProxyType({})
    """Further tabs by title."""


SourceOpener = Callable[[ExitStack], PageSource]


def serve_page(given: ViewOptions, open_source: SourceOpener, stop: StopFlag) -> None:
    """Serve a page until a signal.

    Raises:
        MissingViewerExtra: A package is missing.
        Exposed: The page would be open to other hosts, and no option permits it.
        ValueError: Options contradict each other, or a name is not valid.
        OSError: A port or a file cannot be used.
    """
    check_name(given.world_name, "world")
    access = given.make_access("zensim view", given.host, given.connect)
    try:
        from zensim.spawner.page.viewer_loop import Viewer
        from zensim.spawner.page.viewer_page import ViewerPage
    except ModuleNotFoundError as error:
        if error.name not in VIEWER_EXTRA:
            raise
        raise MissingViewerExtra(
            f"{error.name} is not installed; use pip install 'zensim[viewer]'"
        ) from error
    raise_niceness(PAGE_NICENESS)
    with ExitStack() as stack:
        source = open_source(stack)
        page = ViewerPage(given.host, given.port, access, source.driver, source.panels)
        stack.enter_context(closing(page))
        viewer = Viewer(source.network, page, source.world)
        stack.callback(viewer.end)
        _announce(given, page.port, access.token)
        while not stop.is_set:
            viewer.tick()


def open_world(given: ViewOptions, stack: ExitStack) -> PageSource:
    """Open a session to a running world."""
    from zensim.spawner.page.robot_driver import RobotDriver

    bus = stack.enter_context(open_bus(BusConfig(connect=(given.connect or DEFAULT_ENDPOINT,))))
    can_act = not given.read_only and may_act(bus, given.world_name)
    driver = stack.enter_context(closing(RobotDriver(bus))) if can_act else None
    return PageSource(bus, given.world_name, driver)


def may_act(bus: Bus, world: str) -> bool:
    """Whether the role of this session may change the world; without one, or unknown: yes."""
    if not bus.user:
        return True
    try:
        role = bus.call(INFO, InfoRequest(), world=world, timeout_s=INFO_TIMEOUT_S).role
    except (BusError, ServiceError, TimeoutError, MalformedPayload):
        return True
    if role not in ROLES or SPAWN_ENTITY.name in ROLES[role].services:
        return True
    print_note(
        "view", f"role '{role}' may not change the world, so the page has no controls for it"
    )
    return False


def _announce(given: ViewOptions, port: int, token: str) -> None:
    url = make_page_url(given.host, port, token, has_tls=given.certificate is not None)
    print_lines(
        json.dumps({"viewer": url}) if given.as_json else given.write_address("viewer", url)
    )
    if given.open_page:
        webbrowser.open(url)
