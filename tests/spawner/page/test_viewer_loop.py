"""Loop of the viewer with a fake page and a fake server."""

from collections.abc import Mapping
from typing import get_args

import msgspec
import pytest

from tests.fakes import ManualClock, MemoryBus
from tests.integration.processes import eventually
from tests.spawner.page.builders import (
    FakeServer,
    make_models,
    make_robot,
    make_sensing_robot,
    make_snapshot,
)
from zensim.proto import memory_bus, topic_catalog
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.result_messages import Result, ResultCode, SetSimulationStateCode
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    ResetSimulationRequest,
    SetSimulationStateRequest,
    SetSimulationStateResponse,
    SimulationState,
    State,
    StepSimulationRequest,
)
from zensim.proto.messages.spawn_messages import DeleteEntityRequest
from zensim.proto.messages.standard_messages import Image, LaserScan
from zensim.proto.messages.telemetry_messages import GetModelsRequest
from zensim.proto.service_catalog import DELETE_ENTITY, STEP_SIMULATION
from zensim.proto.topic_catalog import CONTACTS
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
)
from zensim.spawner.page.script_messages import HeadOrder
from zensim.spawner.page.sensor_views import SensedFrame, SensorChoice
from zensim.spawner.page.side_panel import Order, WatchedTopic, WorldCall
from zensim.spawner.page.viewer_loop import POLL_S, Viewer
from zensim.spawner.page.world_calls import RESET_TIMEOUT_S

SNAPSHOT = topic_catalog.SNAPSHOT.key("default")


class FakePage:
    """Records what is shown."""

    def __init__(self, clock: ManualClock) -> None:
        self.is_watched = False
        self.selected: frozenset[str] = frozenset()
        self.shown_sensors: frozenset[SensorChoice] = frozenset()
        self.sensed: list[SensedFrame] = []
        self.watched: frozenset[WatchedTopic] = frozenset()
        self.messages: dict[WatchedTopic, msgspec.Struct] = {}
        self.pressed: list[Order] = []
        self.shown: list[tuple[SimulationStatus, Mapping[str, LastCommand]]] = []
        self.warnings: list[str] = []
        self.notices: list[str] = []
        self.losses = 0
        self.last: list[Order] = []
        self._clock = clock

    def wait_for_input(self, timeout_s: float) -> list[Order]:
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

    def show_sensors(self, sensed: SensedFrame) -> None:
        self.sensed.append(sensed)

    def show_messages(self, messages: Mapping[WatchedTopic, msgspec.Struct]) -> None:
        self.messages.update(messages)

    def move_cameras(self) -> None:
        pass

    def end_visits(self) -> list[Order]:
        return self.last

    def show_disconnected(self) -> None:
        self.losses += 1

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def inform(self, text: str) -> None:
        self.notices.append(text)


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

    def press(self, *buttons: HeadOrder) -> None:
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
    setup.page.selected = frozenset({"r1"})
    setup.tick()
    setup.tick("playing")

    setup.page.is_watched = False
    setup.tick()

    assert not setup.bus.has_subscriber("**")


def test_viewer_requests_what_was_ordered_last_when_it_ends() -> None:
    setup = Setup()
    setup.tick("playing")
    orders = [WorldCall(DELETE_ENTITY, DeleteEntityRequest(f"r{i}"), timeout_s=9.0) for i in (1, 2)]
    step = WorldCall(STEP_SIMULATION, StepSimulationRequest(steps=1))
    setup.page.last = ["Play", step, *orders]

    setup.viewer.end()

    eventually(lambda: setup.server.count(DeleteEntityRequest) == 2, 5.0, "two requests")
    assert setup.server.count(StepSimulationRequest) == 0
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

    assert len(setup.page.warnings) == len(setup.page.notices) == 1


def set_state(state: State) -> SetSimulationStateRequest:
    return SetSimulationStateRequest(state=SimulationState(state=state))


@pytest.mark.parametrize(
    ("button", "request_"),
    [
        ("Play", set_state(State.PLAYING)),
        ("Pause", set_state(State.PAUSED)),
        ("Step", StepSimulationRequest(steps=1)),
        ("Reset time and poses", ResetSimulationRequest(scope=3)),
        ("Reset poses", ResetSimulationRequest(scope=ResetScope.STATE)),
        ("Reset time", ResetSimulationRequest(scope=ResetScope.TIME)),
        ("Reset all", ResetSimulationRequest(scope=ResetScope.ALL)),
    ],
)
def test_button_calls_its_service(button: HeadOrder, request_: object) -> None:
    setup = Setup()

    setup.press(button)

    eventually(lambda: setup.server.requests == [request_], 10.0, "the request")
    assert setup.page.warnings == []


def test_a_reset_may_take_longer_than_drawing_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = Setup()
    limits: list[object] = []
    monkeypatch.setattr(setup.bus, "call", lambda *_, **options: limits.append(options))

    setup.press("Reset all")

    eventually(lambda: limits, 10.0, "the call")
    assert limits == [{"world": "default", "timeout_s": RESET_TIMEOUT_S}]


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


def test_calls_that_a_slow_server_delays_are_dropped_with_a_warning() -> None:
    setup = Setup()
    errors: list[str] = []
    call = WorldCall(STEP_SIMULATION, StepSimulationRequest(steps=1), on_error=errors.append)
    setup.bus.pumps.append(lambda: setup.clock.sleep(1.0))

    setup.page.pressed += [call] * 8
    setup.press("Step", "Step")

    assert setup.server.count(StepSimulationRequest) == 1
    assert len(errors) == 7
    assert len(setup.page.warnings) == 2

    setup.press("Step")
    assert setup.server.count(StepSimulationRequest) == 2


def test_viewer_warns_without_a_reply(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory_bus, "MAX_PUMP_S", 0.0)  # of each of the seven calls
    setup = Setup()
    setup.server.is_silent = True

    setup.press(*get_args(HeadOrder))

    def look() -> bool:
        setup.tick()
        return len(setup.page.warnings) == len(get_args(HeadOrder))

    eventually(look, 10.0, "warnings")


SCAN_CHOICE = SensorChoice("r1", "scan")
PICTURE_CHOICE = SensorChoice("r1", "camera/image_raw")
SCAN = LaserScan(range_max=9.0, ranges=(2.0,))


class SensingSetup(Setup):
    """A viewer of a robot with a lidar and a camera."""

    def __init__(self, *choices: SensorChoice) -> None:
        super().__init__()
        self.server.models = make_models(r1=make_sensing_robot())
        self.page.shown_sensors = frozenset(choices)
        self.tick()
        self.tick("playing")


def test_viewer_subscribes_to_shown_sensors_only() -> None:
    setup = SensingSetup(SCAN_CHOICE)

    assert setup.bus.has_subscriber("r1/scan")
    assert not setup.bus.has_subscriber("r1/camera/**")


@pytest.mark.parametrize("end", ["switched off", "deleted", "not watched"])
def test_viewer_unsubscribes_from_sensors(end: str) -> None:
    setup = SensingSetup(SCAN_CHOICE, PICTURE_CHOICE)
    assert setup.bus.has_subscriber("r1/camera/image_raw")

    if end == "switched off":
        setup.page.shown_sensors = frozenset()
        setup.tick("playing")
    elif end == "deleted":
        setup.server.models = make_models(2)
        setup.clock.sleep(1.0)
        setup.server.publish(make_snapshot(roster=2))
        setup.tick()
    else:
        setup.page.is_watched = False
        setup.tick()

    assert not setup.bus.has_subscriber("r1/**")


def test_viewer_subscribes_anew_when_the_namespace_changes() -> None:
    setup = SensingSetup(SCAN_CHOICE)
    models = make_models(2, r1=make_sensing_robot())
    moved = msgspec.structs.replace(models.entities[0], namespace="ns")
    setup.server.models = msgspec.structs.replace(models, entities=(moved,))

    setup.clock.sleep(1.0)
    setup.server.publish(make_snapshot("r1", roster=2, joints=1))
    setup.tick()

    assert setup.bus.has_subscriber("ns/scan")
    assert not setup.bus.has_subscriber("r1/scan")


def test_newest_scan_is_shown_in_the_world() -> None:
    setup = SensingSetup(SCAN_CHOICE)
    setup.bus.put_message("r1/scan", msgspec.structs.replace(SCAN, ranges=(3.0,)))
    setup.bus.put_message("r1/scan", SCAN)

    setup.tick("playing")
    setup.tick("playing")

    _, sensed, after = setup.page.sensed
    assert sensed.points[SCAN_CHOICE].tolist() == [pytest.approx([2.0, 0.05, 0.2])]
    assert after.points == {}


def test_scans_and_pictures_are_limited_in_rate() -> None:
    setup = SensingSetup(SCAN_CHOICE, PICTURE_CHOICE)
    image = Image(height=1, width=1, encoding="rgb8", step=3, data=b"abc")
    started = len(setup.page.sensed)

    for _ in range(40):
        setup.clock.sleep(0.05)
        setup.bus.put_message("r1/scan", SCAN)
        setup.bus.put_message("r1/camera/image_raw", image)
        setup.server.publish(make_snapshot("r1", joints=1))
        setup.viewer.tick()

    span_s = 40 * (0.05 + POLL_S)
    sensed = setup.page.sensed[started:]
    assert 9.0 < sum(bool(one.points) for one in sensed) / span_s <= 10.0
    assert 4.0 < sum(bool(one.pictures) for one in sensed) / span_s <= 5.0


def test_malformed_messages_of_sensors_are_counted() -> None:
    setup = SensingSetup(SCAN_CHOICE, PICTURE_CHOICE)
    setup.bus.put("r1/scan", b"\0\1\0\0\1")
    setup.bus.put_message("r1/camera/image_raw", SCAN)

    setup.tick("playing")
    setup.bus.put_message("r1/scan", SCAN)
    setup.tick("playing")

    assert setup.page.shown[-1][0].malformed == 2
    assert [*setup.page.sensed[-1].points] == [SCAN_CHOICE]


def test_viewer_receives_a_watched_topic_while_it_is_watched() -> None:
    setup = Setup()
    setup.server.models = make_models(s1=make_sensing_robot())
    scan, contacts = WatchedTopic("scan", "s1", "scan"), WatchedTopic("contacts")
    setup.page.watched = frozenset({scan, contacts, WatchedTopic("scan", "gone", "scan")})

    def tick() -> None:
        setup.clock.sleep(1.0)
        setup.server.publish(make_snapshot("s1", joints=1))
        setup.viewer.tick()

    setup.tick()
    tick()
    for message in (LaserScan(range_max=9.0, ranges=(1.0,)), LaserScan(range_max=8.0)):
        setup.bus.put_message("s1/scan", message, Format.CDR)
    tick()
    assert setup.page.messages == {scan: LaserScan(range_max=8.0)}
    setup.bus.put_message("s1/scan", Image(), Format.CDR)
    setup.bus.put_message(
        CONTACTS.key("default"), Contacts(0, 0, 0, (), (), b"", b""), Format.MSGPACK
    )
    tick()
    assert contacts in setup.page.messages
    assert setup.page.shown[-1][0].malformed == 0

    setup.page.watched = frozenset()
    tick()
    assert not setup.bus.has_subscriber("s1/scan")
