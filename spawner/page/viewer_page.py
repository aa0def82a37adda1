"""The page of the viewer: a port, the scene that all visitors share, and the visitors."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from types import MappingProxyType
from typing import Final

import msgspec
import viser

from zensim.proto.messages.world_messages import Scene
from zensim.proto.web_access import OPEN_ACCESS, PageAccess
from zensim.spawner.page.drive_panel import DrivePanel
from zensim.spawner.page.edit_panel import EditPanel
from zensim.spawner.page.entity_panel import EntityPanel
from zensim.spawner.page.fleet_nodes import FleetNodes
from zensim.spawner.page.floor_picking import Act
from zensim.spawner.page.page_server import close_server, open_server
from zensim.spawner.page.page_theme import DARK, LIGHT
from zensim.spawner.page.plot_panel import PlotPanel
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
)
from zensim.spawner.page.robot_driver import RobotDriver
from zensim.spawner.page.scene_lighting import SceneLighting, set_up_scene
from zensim.spawner.page.script_messages import (
    HeadOrder,
    ScriptMessage,
    ZensimAct,
    ZensimModel,
    ZensimSelect,
    ZensimTheme,
)
from zensim.spawner.page.sensor_views import SensedFrame, SensorChoice
from zensim.spawner.page.shortcuts import SHORTCUTS
from zensim.spawner.page.side_panel import (
    CONNECTING,
    Order,
    WatchedTopic,
    WorldCall,
    make_status_html,
)
from zensim.spawner.page.time_panel import TimePanel
from zensim.spawner.page.view_panel import ViewPanel
from zensim.spawner.page.viewer_client import PageState, PanelFactory, ViewerClient
from zensim.spawner.page.world_run import WorldRun

PANELS: Final[Mapping[str, PanelFactory]] = MappingProxyType(
    {"Entities": EntityPanel, "See": ViewPanel, "Plots": PlotPanel}
)
"""Panels of each visitor by title of their tab, from left to right."""
MAX_INPUT_S: Final = 0.02
"""Time for which events are handled before the next frame is drawn."""
HEAD: Final = '<div data-zensim-part="head"></div>'
"""Place of the buttons of the simulation, which the page's script fills."""
TEXT_PERIOD_S: Final = 0.15
"""Update period of the texts of panels."""


class ClientConnected(msgspec.Struct, frozen=True):
    """A client opened the page."""

    client_id: int


class ClientDisconnected(msgspec.Struct, frozen=True):
    """A client closed the page."""

    client_id: int


class ControlUsed(msgspec.Struct, frozen=True, eq=False):
    """A client used a control, or clicked in the scene."""

    client_id: int
    act: Act
    """Handler; not called once the client has left."""


class EntityPicked(msgspec.Struct, frozen=True):
    """A client clicked an entity in the scene."""

    client_id: int
    entity: str
    is_added: bool
    """Whether the rest of the selection stays."""


ClientEvent = ClientConnected | ClientDisconnected | ControlUsed | EntityPicked


class ViewerPage:
    """A page on a port. Threads of viser only queue events; the thread of the caller handles them.

    Raises:
        PortTaken: Another program listens on the port.
        CannotListen: The operating system refuses.
    """

    def __init__(
        self,
        host: str,
        port: int,
        access: PageAccess = OPEN_ACCESS,
        driver: RobotDriver | None = None,
        more_panels: Mapping[str, PanelFactory] = MappingProxyType({}),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Serve a page; see `open_server`.

        Args:
            host: An address of this host.
            port: 0 to 65535.
            access: Who may open it.
            driver: Publishes commands; None = visitors may look only.
            more_panels: Panels beside `PANELS`, before them.
            clock: Reads the monotonic time [s] at which what visitors can undo takes effect.
        """
        self._driver, self._more_panels, self._clock = driver, more_panels, clock
        self._run = WorldRun()
        self._events: SimpleQueue[ClientEvent | HeadOrder] = SimpleQueue()
        self._orders: list[Order] = []
        self._clients: dict[int, ViewerClient] = {}
        self._state = PageState()
        self._names, self._is_grey = b"{}", False
        self._next_text_at, self._has_new_text = 0.0, False
        keys = SHORTCUTS if driver is not None else ()  # without commands, viser has no palette
        self._server = open_server(host, port, lambda: self._names, access, self._receive, keys)
        set_up_scene(self._server)
        self._lighting = SceneLighting(self._server.scene)
        self._lighting.show(Scene())
        self._fleet_nodes = FleetNodes(self._server.scene, self._pick)
        self._status = self._server.gui.add_html(make_status_html(CONNECTING))
        if driver is not None:
            self._server.gui.add_html(HEAD)
        self._server.on_client_connect(
            lambda client: self._events.put(ClientConnected(client.client_id))
        )
        self._server.on_client_disconnect(self._handle_leave)

    @property
    def port(self) -> int:
        """Port of the page."""
        return self._server.get_port()

    @property
    def is_watched(self) -> bool:
        """Whether a client has the page open."""
        return bool(self._clients)

    @property
    def selected(self) -> frozenset[str]:
        """Entities that a client has selected."""
        return frozenset[str]().union(*(client.selected for client in self._clients.values()))

    @property
    def shown_sensors(self) -> frozenset[SensorChoice]:
        """Sensors that a client shows."""
        return frozenset[SensorChoice]().union(*(o.sensors.chosen for o in self._clients.values()))

    @property
    def watched(self) -> frozenset[WatchedTopic]:
        """Topics that a client watches."""
        return frozenset[WatchedTopic]().union(*(one.watched for one in self._clients.values()))

    def wait_for_input(self, timeout_s: float) -> list[Order]:
        """Wait for events of clients, handle them, and return the orders of clients.

        Events that come faster than they are handled wait for the next call.
        """
        with suppress(Empty):
            event = self._events.get(timeout=timeout_s)
            end_s = time.monotonic() + MAX_INPUT_S
            self._handle_event(event)
            while time.monotonic() < end_s:
                self._handle_event(self._events.get_nowait())
        orders, self._orders = self._orders, []
        return orders

    def show(
        self,
        fleet: RenderedFleet,
        frame: RenderedFrame,
        status: SimulationStatus,
        commands: Mapping[str, LastCommand],
    ) -> None:
        """Draw one snapshot."""
        before = self._state
        self._state = PageState(
            *(fleet, frame, status, commands),
            self._fleet_nodes.find_bounds,
            self._fleet_nodes.find_instance,
        )
        if frame is not before.frame:
            with self._server.atomic():
                self._lighting.show(fleet.scene, frame.lights)
                self._fleet_nodes.show(fleet, frame)
        if fleet is not before.fleet:
            self._names = self._fleet_nodes.names_json()
        self._set_grey(is_grey=False)
        for client in self._connected_clients():
            client.draw(self._state)
        self._has_new_text = True
        self.move_cameras()

    def show_sensors(self, sensed: SensedFrame) -> None:
        """Draw what is new of the shown sensors."""
        for client in self._connected_clients():
            client.sensors.show(sensed)

    def show_messages(self, messages: Mapping[WatchedTopic, msgspec.Struct]) -> None:
        """Show new messages of watched topics."""
        for client in self._connected_clients():
            client.show_messages(messages)

    def move_cameras(self) -> None:
        """Move each camera towards the entity that it follows; call periodically."""
        for client in self._connected_clients():
            client.move()
        self._update_texts()

    def _update_texts(self) -> None:
        """Show the texts of the last snapshot, which may be the last for a while."""
        now_s = time.monotonic()
        if not self._has_new_text or now_s < self._next_text_at:
            return
        self._has_new_text, self._next_text_at = False, now_s + TEXT_PERIOD_S
        self._status.content = make_status_html(self._state.status)
        for client in self._connected_clients():
            client.update()

    def show_disconnected(self) -> None:
        """Show that no server replies, in a grey scene."""
        self._has_new_text = False
        self._status.content = make_status_html(SimulationStatus())
        self._set_grey(is_grey=True)

    def warn(self, text: str) -> None:
        """Notify all clients of a failure."""
        for client in self._connected_clients():
            client.warn(text)

    def inform(self, text: str) -> None:
        """Notify all clients of what works."""
        for client in self._connected_clients():
            client.inform(text)

    def end_visits(self) -> list[Order]:
        """End what visitors have begun, as nobody can undo it any more; return their orders."""
        orders = self.wait_for_input(0.0)
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        last, self._orders = self._orders, []
        return [*orders, *last]

    def close(self) -> None:
        """Stop serving."""
        close_server(self._server)

    def _connected_clients(self) -> list[ViewerClient]:
        """List the clients that viser still has; disconnect events may be queued."""
        connected = self._server.get_clients()
        return [client for client_id, client in self._clients.items() if client_id in connected]

    def _set_grey(self, *, is_grey: bool) -> None:
        if is_grey != self._is_grey:
            self._is_grey = is_grey
            for client in self._connected_clients():
                client.grey(is_grey=is_grey)

    def _handle_leave(self, client: viser.ClientHandle) -> None:
        if self._driver is not None:
            # At once: the thread that draws may wait for a reply.
            self._driver.leave(client.client_id)
        self._events.put(ClientDisconnected(client.client_id))

    def _receive(self, client_id: int, message: ScriptMessage) -> None:
        """Handle a message of the page's script; called by the thread of the server."""
        client = self._clients.get(client_id)
        if client is None:
            return
        if isinstance(message, ZensimSelect):
            self._events.put(EntityPicked(client_id, message.entity, message.is_added))
        elif isinstance(message, ZensimAct):
            self._take_act(client, message)
        elif isinstance(message, ZensimTheme):
            theme = DARK if message.is_dark else LIGHT
            self._events.put(ControlUsed(client_id, partial(client.scenery.switch, theme)))
        elif isinstance(message, ZensimModel):
            self._events.put(ControlUsed(client_id, partial(client.choose_model, message.model)))
        else:
            client.receive(message)

    def _take_act(self, client: ViewerClient, message: ZensimAct) -> None:
        visitor = client.client.client_id
        if message.act == "Show all":
            self._events.put(ControlUsed(visitor, client.look_at_all))
        elif message.act == "Give up":
            self._events.put(ControlUsed(visitor, client.picker.give_up))
        elif self._driver is not None:  # else visitors may look only
            self._events.put(message.act)

    def _notify(self, client_id: int, text: str) -> None:
        if client_id in self._clients:
            self._clients[client_id].warn(text)

    def _pick(self, client_id: int, entity: str, is_added: bool) -> None:  # noqa: FBT001
        self._events.put(EntityPicked(client_id, entity, is_added))

    def _order(self, call: WorldCall) -> None:
        self._orders.append(call)

    def _use(self, client_id: int, act: Act) -> None:
        self._events.put(ControlUsed(client_id, act))

    def _handle_event(self, event: ClientEvent | HeadOrder) -> None:
        if isinstance(event, str):
            self._orders.append(event)
            return
        handle = self._server.get_clients().get(event.client_id)
        if isinstance(event, ClientDisconnected) or handle is None:
            gone = self._clients.pop(event.client_id, None)
            if gone is not None:
                gone.close()
        elif isinstance(event, ClientConnected):
            self._clients[event.client_id] = self._welcome(handle)
        elif isinstance(event, ControlUsed):
            event.act()
        else:
            self._take_pick(event)

    def _take_pick(self, event: EntityPicked) -> None:
        """Select what was clicked; a click may come before the event of its connection."""
        client = self._clients.get(event.client_id)
        if client is None:
            return
        if event.is_added:
            client.toggle(event.entity)
        else:
            client.select(event.entity)

    def _welcome(self, handle: viser.ClientHandle) -> ViewerClient:
        post: Callable[[Act], None] = partial(self._use, handle.client_id)
        can_act = self._driver is not None
        client = ViewerClient(handle, post, self._order, self._clock, can_act=can_act)
        client.state, client.notify = self._state, self._notify
        acting: dict[str, PanelFactory] = {}
        if self._driver is not None:
            acting = {
                "Drive": partial(DrivePanel, driver=self._driver),
                "Edit": EditPanel,
                "Time": partial(TimePanel, run=self._run),
            }
        client.add_tabs({**self._more_panels, **PANELS, **acting})
        client.begin(is_grey=self._is_grey)
        return client
