"""Loop of the viewer; it subscribes only while a client has the page open."""

import time
from collections.abc import Mapping
from typing import Final, Protocol

import msgspec

from zensim.proto.messages.simulation_messages import (
    ResetScope,
    ResetSimulationRequest,
    SetSimulationStateRequest,
    SimulationState,
    State,
    StepSimulationRequest,
)
from zensim.proto.network_protocols import FollowingNetwork
from zensim.proto.service_catalog import (
    DELETE_ENTITY,
    RESET_SIMULATION,
    SET_SIMULATION_STATE,
    STEP_SIMULATION,
    Request,
    Response,
    Service,
)
from zensim.spawner.page.mesh_fetcher import MeshFetcher
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
)
from zensim.spawner.page.script_messages import HeadOrder
from zensim.spawner.page.sensor_views import SensedFrame, SensorChoice
from zensim.spawner.page.side_panel import Order, WatchedTopic, WorldCall
from zensim.spawner.page.viewer_data import MonotonicClock, ViewerDataSource
from zensim.spawner.page.world_calls import RESET_TIMEOUT_S, WorldCalls

RESETS: Final[Mapping[str, int]] = {
    "Reset time and poses": ResetScope.TIME | ResetScope.STATE,
    "Reset poses": ResetScope.STATE,
    "Reset time": ResetScope.TIME,
    "Reset all": ResetScope.ALL,
}
"""Scopes of the orders that reset."""
IDLE_S: Final = 0.1
"""Period of the loop without clients."""
POLL_S: Final = 1.0 / 60.0
MAX_CALLS_S: Final = 0.5
"""Time after which no further short call is made before the next frame is drawn."""
LATE: Final = "the server replies too late, so this was not requested; try again"


class PageProtocol(Protocol):
    """Page as the loop uses it."""

    @property
    def is_watched(self) -> bool:
        """Whether a client has the page open."""

    @property
    def selected(self) -> frozenset[str]:
        """Entities that a client has selected."""

    @property
    def shown_sensors(self) -> frozenset[SensorChoice]:
        """Sensors that a client shows."""

    @property
    def watched(self) -> frozenset[WatchedTopic]:
        """Topics that a client watches."""

    def wait_for_input(self, timeout_s: float) -> list[Order]:
        """Wait for events of clients, and return their orders."""

    def show(
        self,
        fleet: RenderedFleet,
        frame: RenderedFrame,
        status: SimulationStatus,
        commands: Mapping[str, LastCommand],
    ) -> None:
        """Draw one snapshot."""

    def show_sensors(self, sensed: SensedFrame) -> None:
        """Draw what is new of the shown sensors."""

    def show_messages(self, messages: Mapping[WatchedTopic, msgspec.Struct]) -> None:
        """Show new messages of watched topics."""

    def move_cameras(self) -> None:
        """Move each camera towards the robot that it follows."""

    def end_visits(self) -> list[Order]:
        """End what clients have begun, and return their last orders."""

    def show_disconnected(self) -> None:
        """Show that no server replies."""

    def warn(self, text: str) -> None:
        """Notify all clients of a failure."""

    def inform(self, text: str) -> None:
        """Notify all clients of what works."""


class Viewer:
    """Updates a page; call `tick` periodically."""

    def __init__(
        self,
        network: FollowingNetwork,
        page: PageProtocol,
        world: str,
        *,
        clock: MonotonicClock = time.monotonic,
    ) -> None:
        self._network, self._page, self._world, self._clock = network, page, world, clock
        self._fetcher = MeshFetcher(network, world, clock)
        self._calls = WorldCalls(network, world)
        self._data_source: ViewerDataSource | None = None
        self._error_text = ""
        self._state = ""

    def tick(self) -> None:
        """Handle events of clients, and show new data if there are clients."""
        is_watched = self._page.is_watched
        orders = self._page.wait_for_input(POLL_S if is_watched else IDLE_S)
        end_s = self._clock() + MAX_CALLS_S
        for order in orders:
            is_late = self._clock() >= end_s
            if isinstance(order, WorldCall):
                self._make(order, is_late=is_late)
            elif is_late:
                self._page.warn(LATE)
            else:
                self._handle_button(order)
        self._calls.settle()
        if self._page.is_watched:
            self._update(self._data_source or self._open_data_source())
        else:
            self.close()

    def _make(self, call: WorldCall, *, is_late: bool) -> None:
        # A long call has a thread of its own.
        if is_late and not call.timeout_s:
            call.on_error(LATE)
        else:
            self._calls.make(call)

    def end(self) -> None:
        """Request the deletions that clients can no longer undo, and close all subscriptions."""
        calls = [one for one in self._page.end_visits() if isinstance(one, WorldCall)]
        # What else was ordered a moment ago would act on a world that the client no longer sees.
        self._calls.make_last(call for call in calls if call.service is DELETE_ENTITY)
        self.close()

    def close(self) -> None:
        """Close all subscriptions."""
        if self._data_source is not None:
            self._data_source.close()
            self._data_source, self._error_text = None, ""

    def _open_data_source(self) -> ViewerDataSource:
        self._data_source = ViewerDataSource(self._network, self._world, self._clock, self._fetcher)
        return self._data_source

    def _update(self, source: ViewerDataSource) -> None:
        # Sensors and watched topics are drawn with the views.
        is_sensing = bool(self._page.shown_sensors or self._page.watched)
        view = source.newest(is_still_shown=is_sensing)
        if view is not None:
            self._state = view.status.state
            commands = source.commands(self._page.selected)
            self._page.show(view.fleet, view.frame, view.status, commands)
            self._page.show_sensors(source.sense(self._page.shown_sensors, view))
            self._page.show_messages(source.receive(self._page.watched))
        elif source.is_silent:
            self._page.show_disconnected()
        self._page.move_cameras()
        if source.error_text != self._error_text:
            self._error_text = source.error_text
            if source.error_text:
                self._page.warn(source.error_text)
            else:
                self._page.inform("the models of the robots are available again")

    def _handle_button(self, button: HeadOrder) -> None:
        if button == "Play":
            self._set_state(State.PLAYING)
        elif button == "Pause":
            self._set_state(State.PAUSED)
        elif button == "Step":
            if self._state == "playing":
                self._set_state(State.PAUSED)
            self._call(STEP_SIMULATION, StepSimulationRequest(steps=1))
        else:
            request = ResetSimulationRequest(scope=RESETS[button])
            self._call(RESET_SIMULATION, request, RESET_TIMEOUT_S)

    def _set_state(self, state: State) -> None:
        self._call(
            SET_SIMULATION_STATE, SetSimulationStateRequest(state=SimulationState(state=state))
        )

    def _call(
        self, service: Service[Request, Response], request: Request, timeout_s: float = 0.0
    ) -> None:
        call = WorldCall(service, request, on_error=self._page.warn, timeout_s=timeout_s)
        self._calls.make(call)
