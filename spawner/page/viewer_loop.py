"""Loop of the viewer; it subscribes only while a client has the page open."""

import time
from collections.abc import Mapping
from typing import Final, Protocol

from zensim.proto.bus import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.result_messages import ServiceError, SetSimulationStateCode
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    ResetSimulationRequest,
    SetSimulationStateRequest,
    SimulationState,
    State,
    StepSimulationRequest,
)
from zensim.proto.network_protocols import ViewerNetwork
from zensim.proto.service_catalog import (
    RESET_SIMULATION,
    SET_SIMULATION_STATE,
    STEP_SIMULATION,
    Request,
    Response,
    Service,
)
from zensim.spawner.page.data_source import (
    CALL_TIMEOUT_S,
    MeshFetcher,
    MonotonicClock,
    ViewerDataSource,
)
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
)
from zensim.spawner.page.side_panel import Button

IDLE_S: Final = 0.1
"""Period of the loop without clients."""
POLL_S: Final = 1.0 / 60.0


class PageProtocol(Protocol):
    """Page as the loop uses it."""

    @property
    def is_watched(self) -> bool:
        """Whether a client has the page open."""

    @property
    def followed(self) -> frozenset[str]:
        """Entities that a client follows."""

    def wait_for_input(self, timeout_s: float) -> list[Button]:
        """Wait for events of clients, and return the pressed buttons."""

    def show(
        self,
        fleet: RenderedFleet,
        frame: RenderedFrame,
        status: SimulationStatus,
        commands: Mapping[str, LastCommand],
    ) -> None:
        """Draw one snapshot."""

    def move_cameras(self) -> None:
        """Move each camera towards the robot that it follows."""

    def show_disconnected(self) -> None:
        """Show that no server replies."""

    def warn(self, text: str) -> None:
        """Notify all clients."""


class Viewer:
    """Updates a page; call `tick` periodically."""

    def __init__(
        self,
        network: ViewerNetwork,
        page: PageProtocol,
        world: str,
        *,
        clock: MonotonicClock = time.monotonic,
    ) -> None:
        self._network, self._page, self._world, self._clock = network, page, world, clock
        self._fetcher = MeshFetcher(network, world, clock)
        self._data_source: ViewerDataSource | None = None
        self._error_text = ""
        self._state = ""

    def tick(self) -> None:
        """Handle events of clients, and show new data if there are clients."""
        is_watched = self._page.is_watched
        for button in self._page.wait_for_input(POLL_S if is_watched else IDLE_S):
            self._handle_button(button)
        if self._page.is_watched:
            self._update(self._data_source or self._open_data_source())
        else:
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
        view = source.newest()
        if view is not None:
            self._state = view.status.state
            commands = source.commands(self._page.followed)
            self._page.show(view.fleet, view.frame, view.status, commands)
        elif source.is_silent:
            self._page.show_disconnected()
        self._page.move_cameras()
        if source.error_text != self._error_text:
            self._error_text = source.error_text
            self._page.warn(source.error_text or "the models of the robots are available again")

    def _handle_button(self, button: Button) -> None:
        if button == "Play":
            self._set_state(State.PLAYING)
        elif button == "Pause":
            self._set_state(State.PAUSED)
        elif button == "Step":
            if self._state == "playing":
                self._set_state(State.PAUSED)
            self._call(STEP_SIMULATION, StepSimulationRequest(steps=1))
        else:
            scope = ResetScope.TIME | ResetScope.STATE
            self._call(RESET_SIMULATION, ResetSimulationRequest(scope=scope))

    def _set_state(self, state: State) -> None:
        self._call(
            SET_SIMULATION_STATE, SetSimulationStateRequest(state=SimulationState(state=state))
        )

    def _call(self, service: Service[Request, Response], request: Request) -> None:
        try:
            self._network.call(service, request, world=self._world, timeout_s=CALL_TIMEOUT_S)
        except ServiceError as error:
            if error.code != SetSimulationStateCode.ALREADY_IN_TARGET_STATE:
                self._page.warn(str(error))
        except (BusError, TimeoutError, MalformedPayload) as error:
            self._page.warn(str(error))
