from collections.abc import Mapping

import pytest

from tests.fakes import ManualClock, MemoryBus
from tests.spawner.page.builders import World, a_robot, a_snapshot, models_of
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
    """A page that notes what it is shown."""

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


class Stand:
    """A viewer between a page and a world."""

    def __init__(self, *, is_watched: bool = True) -> None:
        self.bus = MemoryBus()
        self.clock = ManualClock()
        self.world = World(self.bus, models_of(r1=a_robot()))
        self.page = FakePage(self.clock)
        self.page.is_watched = is_watched
        self.viewer = Viewer(self.bus, self.page, "default", clock=self.clock)

    def tick(self, state: str = "") -> None:
        """Tick; with a state, after a snapshot in that state."""
        if state:
            self.clock.sleep(1.0)
            self.world.publish(a_snapshot("r1", joints=1, state=state))
        self.viewer.tick()

    def press(self, *buttons: Button) -> None:
        self.page.pressed += buttons
        self.tick()


def test_viewer_asks_for_nothing_when_nobody_looks() -> None:
    stand = Stand(is_watched=False)

    stand.tick()

    assert not stand.bus.is_heard("**")
    assert stand.world.asked == []


def test_viewer_shows_snapshots_when_somebody_looks() -> None:
    stand = Stand()

    stand.tick()
    stand.tick("playing")

    ((status, commands),) = stand.page.shown
    assert (status.state, status.robots) == ("playing", 1)
    assert commands == {}


def test_viewer_stops_listening_when_the_last_page_is_closed() -> None:
    stand = Stand()
    stand.page.followed = frozenset({"r1"})
    stand.tick()
    stand.tick("playing")

    stand.page.is_watched = False
    stand.tick()

    assert not stand.bus.is_heard("**")


def test_viewer_asks_afresh_when_a_page_is_opened_again() -> None:
    stand = Stand()
    stand.tick()
    stand.tick("playing")
    stand.page.is_watched = False
    stand.tick()

    stand.page.is_watched = True
    stand.tick()
    stand.tick("playing")

    assert stand.world.count(GetModelsRequest) == 2


def test_viewer_says_so_when_the_server_is_silent() -> None:
    stand = Stand()
    stand.tick()

    stand.clock.sleep(10.0)
    stand.tick()

    assert stand.page.losses == 1


def test_viewer_warns_once_when_models_stay_away() -> None:
    stand = Stand()
    stand.tick()
    stand.world.is_deaf = True

    stand.tick("playing")
    stand.tick("playing")
    stand.world.is_deaf = False
    stand.tick("playing")

    first, second = stand.page.warnings
    assert "missing" in first
    assert "here again" in second


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
    stand = Stand()

    stand.press(button)

    assert stand.world.asked == [request_]
    assert stand.page.warnings == []


def test_step_pauses_first_when_the_world_plays() -> None:
    stand = Stand()
    stand.tick()
    stand.tick("playing")
    stand.world.asked.clear()

    stand.press("Step")

    assert stand.world.asked == [set_state(State.PAUSED), StepSimulationRequest(steps=1)]


def test_viewer_warns_when_a_button_is_refused() -> None:
    stand = Stand()
    refusal = Result(ResultCode.OPERATION_FAILED, "not now")
    stand.world.answers["set_simulation_state"] = SetSimulationStateResponse(refusal)

    stand.press("Play")

    (warning,) = stand.page.warnings
    assert "not now" in warning


def test_viewer_says_nothing_when_the_world_plays_already() -> None:
    stand = Stand()
    refusal = Result(SetSimulationStateCode.ALREADY_IN_TARGET_STATE, "it plays")
    stand.world.answers["set_simulation_state"] = SetSimulationStateResponse(refusal)

    stand.press("Play")

    assert stand.page.warnings == []


def test_viewer_warns_when_no_server_answers_a_button() -> None:
    stand = Stand()
    stand.world.is_deaf = True

    stand.press(*BUTTONS)

    assert len(stand.page.warnings) == len(BUTTONS)
