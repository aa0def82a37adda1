"""The viewer's loop: snapshots in, page out; without an open page it subscribes to nothing."""

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
"""How long a page waits for its first visitor before it looks whether to end."""
POLL_S: Final = 1.0 / 60.0


class PageProtocol(Protocol):
    """What the loop needs of a page."""

    @property
    def is_watched(self) -> bool:
        """Whether anybody has the page open."""

    @property
    def followed(self) -> frozenset[str]:
        """The entities that somebody follows."""

    def wait_for_input(self, timeout_s: float) -> list[Button]:
        """Wait so long for visitors to do something; return the buttons that they pressed."""

    def show(
        self,
        fleet: RenderedFleet,
        frame: RenderedFrame,
        status: SimulationStatus,
        commands: Mapping[str, LastCommand],
    ) -> None:
        """Draw one snapshot."""

    def move_cameras(self) -> None:
        """Bring every camera nearer to the robot that it follows."""

    def show_disconnected(self) -> None:
        """Show that no server answers."""

    def warn(self, text: str) -> None:
        """Tell every visitor once."""


class Viewer:
    """Keeps a page up to date; call `tick` over and over."""

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
        self._feed: ViewerDataSource | None = None
        self._warned = ""
        self._state = ""

    def tick(self) -> None:
        """Heed visitors and, when there are any, show what is new."""
        is_watched = self._page.is_watched
        for button in self._page.wait_for_input(POLL_S if is_watched else IDLE_S):
            self._handle_button(button)
        if self._page.is_watched:
            self._update(self._feed or self._open_data_source())
        else:
            self.close()

    def close(self) -> None:
        """Ask the network for nothing any more."""
        if self._feed is not None:
            self._feed.close()
            self._feed, self._warned = None, ""

    def _open_data_source(self) -> ViewerDataSource:
        self._feed = ViewerDataSource(self._network, self._world, self._clock, self._fetcher)
        return self._feed

    def _update(self, feed: ViewerDataSource) -> None:
        view = feed.newest()
        if view is not None:
            self._state = view.status.state
            commands = feed.commands(self._page.followed)
            self._page.show(view.fleet, view.frame, view.status, commands)
        elif feed.is_silent:
            self._page.show_disconnected()
        self._page.move_cameras()
        if feed.error_text != self._warned:
            self._warned = feed.error_text
            self._page.warn(feed.error_text or "the models of the robots are here again")

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
