"""Loop of the viewer with a fake page and a fake server."""

from collections.abc import Mapping

import pytest

from tests.fakes import ManualClock, MemoryBus
from tests.spawner.page.builders import FakeServer, make_models, make_robot, make_snapshot
from zensim.proto import topic_catalog
from zensim.proto.messages.result_messages import Result, ResultCode, SetSimulationStateCode
from zensim.proto.messages.simulation_messages import (
    ResetSimulationRequest,
    SetSimulationStateRequest,
    SetSimulationStateResponse,
    SimulationState,
    State,
    StepSimulationRequest,
)
from zensim.proto.messages.telemetry_messages import GetModelsRequest
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
)
from zensim.spawner.page.side_panel import BUTTONS, Button
from zensim.spawner.page.viewer_loop import Viewer

SNAPSHOT = topic_catalog.SNAPSHOT.key("default")


class FakePage:
    """Records what is shown."""

    def __init__(self, clock: ManualClock) -> None:
        self.is_watched = False
        self.followed: frozenset[str] = frozenset()
        self.pressed: list[Button] = []
        self.shown: list[tuple[SimulationStatus, Mapping[str, LastCommand]]] = []
        self.warnings: list[str] = []
        self.losses = 0
        self._clock = clock

    def wait_for_input(self, timeout_s: float) -> list[Button]:
        self._clock.sleep(timeout_s)
        pressed, self.pressed = self.pressed, []
        return pressed

    def show(
        self,
        fleet: RenderedFleet,
        frame: RenderedFrame,
        status: SimulationStatus,
        commands: Mapping[str, LastCommand],
    ) -> None:
        assert len(fleet.names) == len(frame.base)
        self.shown.append((status, commands))

    def move_cameras(self) -> None:
        pass

    def show_disconnected(self) -> None:
        self.losses += 1

    def warn(self, text: str) -> None:
        self.warnings.append(text)


class Setup:
    """A viewer, its page and its server."""

    def __init__(self, *, is_watched: bool = True) -> None:
        self.bus = MemoryBus()
        self.clock = ManualClock()
        self.server = FakeServer(self.bus, make_models(r1=make_robot()))
        self.page = FakePage(self.clock)
        self.page.is_watched = is_watched
        self.viewer = Viewer(self.bus, self.page, "default", clock=self.clock)

    def tick(self, state: str = "") -> None:
        """Tick; with a state, after a snapshot with that state."""
        if state:
            self.clock.sleep(1.0)
            self.server.publish(make_snapshot("r1", joints=1, state=state))
        self.viewer.tick()

    def press(self, *buttons: Button) -> None:
        self.page.pressed += buttons
        self.tick()


def test_viewer_makes_no_calls_without_clients() -> None:
    setup = Setup(is_watched=False)

    setup.tick()

    assert not setup.bus.has_subscriber("**")
    assert setup.server.requests == []


def test_viewer_shows_snapshots_with_a_client() -> None:
    setup = Setup()

    setup.tick()
    setup.tick("playing")

    ((status, commands),) = setup.page.shown
    assert (status.state, status.robots) == ("playing", 1)
    assert commands == {}


def test_viewer_unsubscribes_without_clients() -> None:
    setup = Setup()
    setup.page.followed = frozenset({"r1"})
    setup.tick()
    setup.tick("playing")

    setup.page.is_watched = False
    setup.tick()

    assert not setup.bus.has_subscriber("**")


def test_viewer_requests_models_again_for_a_new_client() -> None:
    setup = Setup()
    setup.tick()
    setup.tick("playing")
    setup.page.is_watched = False
    setup.tick()

    setup.page.is_watched = True
    setup.tick()
    setup.tick("playing")

    assert setup.server.count(GetModelsRequest) == 2


def test_viewer_shows_a_silent_server() -> None:
    setup = Setup()
    setup.tick()

    setup.clock.sleep(10.0)
    setup.tick()

    assert setup.page.losses == 1


def test_viewer_warns_once_without_models() -> None:
    setup = Setup()
    setup.tick()
    setup.server.is_silent = True

    setup.tick("playing")
    setup.tick("playing")
    setup.server.is_silent = False
    setup.tick("playing")

    assert len(setup.page.warnings) == 2


def set_state(state: State) -> SetSimulationStateRequest:
    return SetSimulationStateRequest(state=SimulationState(state=state))


@pytest.mark.parametrize(
    ("button", "request_"),
    [
        ("Play", set_state(State.PLAYING)),
        ("Pause", set_state(State.PAUSED)),
        ("Step", StepSimulationRequest(steps=1)),
        ("Reset", ResetSimulationRequest(scope=3)),
    ],
)
def test_button_calls_its_service(button: Button, request_: object) -> None:
    setup = Setup()

    setup.press(button)

    assert setup.server.requests == [request_]
    assert setup.page.warnings == []


def test_step_button_pauses_a_playing_world() -> None:
    setup = Setup()
    setup.tick()
    setup.tick("playing")
    setup.server.requests.clear()

    setup.press("Step")

    assert setup.server.requests == [set_state(State.PAUSED), StepSimulationRequest(steps=1)]


def test_viewer_warns_of_a_refusal() -> None:
    setup = Setup()
    refusal = Result(ResultCode.OPERATION_FAILED, "not now")
    setup.server.responses["set_simulation_state"] = SetSimulationStateResponse(refusal)

    setup.press("Play")

    (warning,) = setup.page.warnings
    assert "not now" in warning


def test_viewer_ignores_a_repeated_play() -> None:
    setup = Setup()
    refusal = Result(SetSimulationStateCode.ALREADY_IN_TARGET_STATE, "playing")
    setup.server.responses["set_simulation_state"] = SetSimulationStateResponse(refusal)

    setup.press("Play")

    assert setup.page.warnings == []


def test_viewer_warns_without_a_reply() -> None:
    setup = Setup()
    setup.server.is_silent = True

    setup.press(*BUTTONS)

    assert len(setup.page.warnings) == len(BUTTONS)
