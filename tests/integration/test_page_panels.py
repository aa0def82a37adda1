"""Every control of the page, used by a visitor without a browser."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
import pytest
from websockets.sync.client import ClientConnection

from tests.fakes import ManualClock, MemoryBus, StandingClock
from tests.integration.page_client import (
    PageVisitor,
    connect_page,
    encode_act,
    encode_camera,
    encode_click,
    encode_drive,
    encode_floor_click,
    encode_leave,
    encode_model,
    encode_selection,
    encode_update,
)
from tests.integration.processes import eventually
from tests.spawner.page.builders import (
    CUBE,
    make_models_by_name,
    make_robot,
    make_sensing_robot,
    make_snapshot,
    make_wall,
)
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.drive_messages import AckermannDrive
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.replay_messages import ReplayRequest
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    RunToRequest,
    RunToResponse,
    SetSpeedRequest,
)
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    GetSpawnablesRequest,
    GetSpawnablesResponse,
    Resource,
    Spawnable,
)
from zensim.proto.messages.standard_messages import LaserScan, Twist
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.network_protocols import Subscription
from zensim.proto.topic_catalog import CMD_VEL
from zensim.spawner.page.pending_deletions import UNDO_S
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    SimulationStatus,
    make_fleet,
    make_frame,
)
from zensim.spawner.page.replay_panel import ReplayPanel
from zensim.spawner.page.robot_driver import RobotDriver
from zensim.spawner.page.sensor_views import SensorChoice
from zensim.spawner.page.side_panel import Order, WatchedTopic, WorldCall
from zensim.spawner.page.viewer_client import PanelFactory, ViewerClient
from zensim.spawner.page.viewer_page import ViewerPage
from zensim.spawner.teleop.drive_twists import USUAL_SPEED_M_S, USUAL_TURN_RAD_S

WITHIN_S = 10.0


def a_robot() -> Model:
    """Make a robot with a collision shape."""
    robot = make_robot()
    base = msgspec.structs.replace(robot.links[0], collisions=(CUBE,))
    return msgspec.structs.replace(robot, links=(base, *robot.links[1:]))


def a_car() -> Model:
    """Make a robot that is steered."""
    return msgspec.structs.replace(make_robot("car"), drive=AckermannDrive())


@dataclass
class Visit:
    """A page with a scene, and one visitor."""

    page: ViewerPage
    connection: ClientConnection
    fleet: RenderedFleet = field(default_factory=RenderedFleet)
    commands: dict[str, LastCommand] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.visitor = PageVisitor(self.connection)
        self.base_x = self.speed_mps = self.time_s = 0.0
        self.factor = 1.0
        self.orders: list[Order] = []

    def set_world(self, *names: str) -> None:
        """Set robots; with sensors for names with s, steered ones with c, walls with w."""
        makers = {"w": make_wall, "s": make_sensing_robot, "c": a_car}
        kinds = {name: makers.get(name[0], a_robot)() for name in names}
        self.fleet = make_fleet(names, make_models_by_name(kinds))

    def show(self) -> None:
        """Draw a frame and handle what the visitor has done."""
        names = self.fleet.names
        snapshot = make_snapshot(*names, joints=self.fleet.joints, at_x=self.base_x)
        base = np.frombuffer(snapshot.base).reshape(-1, STATE_COLUMNS).copy()
        base[:, 7] = self.speed_mps
        snapshot = msgspec.structs.replace(snapshot, base=base.tobytes())
        self.time_s += 0.05
        robots = len(self.fleet.robots)
        stats = Stats(state="playing", target_real_time_factor=self.factor)
        status = SimulationStatus("playing", self.time_s, 1.0, robots, len(names), stats=stats)
        self.page.show(self.fleet, make_frame(self.fleet, snapshot), status, self.commands)
        self.orders += self.page.wait_for_input(0.02)
        self.visitor.read()

    def list_requests(self, kind: type[msgspec.Struct]) -> list[msgspec.Struct]:
        """List the requests of this type."""
        calls = [one for one in self.orders if isinstance(one, WorldCall)]
        return [one.request for one in calls if isinstance(one.request, kind)]

    def was_cleared(self, label: str) -> bool:
        """Whether the server has cleared a box; what the visitor sets is not sent back."""
        box = self.visitor.controls[self.visitor.find(label)]
        return bool(box.get("updates")) and not box["value"]

    def until(self, claim: Callable[[], object], what: str) -> None:
        def look() -> bool:
            self.show()
            return bool(claim())

        eventually(look, WITHIN_S, what)

    def until_selected(self, *names: str) -> None:
        self.until(lambda: self.page.selected == set(names), f"{names} selected")

    def set(self, label: str, value: object) -> None:
        """Set the value of a control when it is there."""
        self.until(lambda: label in self.visitor.labels(), label)
        self.visitor.set(label, value)

    def press(self, label: str) -> None:
        """Press a button when it is there."""
        self.set(label, value=True)

    def shows(self, prefix: str) -> bool:
        """Whether the visitor has a scene node, other than an empty parent, below a path."""
        nodes = self.visitor.nodes.items()
        return any(p.startswith(prefix) and n["kind"] != "FrameMessage" for p, n in nodes)

    def charts(self) -> list[dict[str, Any]]:
        """List the charts."""
        controls = self.visitor.controls.values()
        return [one for one in controls if one["kind"] == "GuiUplotMessage"]

    def updates_of_charts(self) -> int:
        """Return how often the data of charts have been set."""
        return sum(one.get("updates", 0) for one in self.charts())

    @property
    def client(self) -> ViewerClient:
        """What the page has of its first visitor."""
        return next(iter(self.page._clients.values()))  # noqa: SLF001

    def click(self, name: str, modifier: str | None = None) -> None:
        """Click an entity in the scene, once the visitor has what the click hits."""
        self.until(lambda: self._find_place(name), f"{name} in the scene")
        path, index = self._find_place(name)[0]
        self.connection.send(encode_click(path, index, modifier))

    def _find_place(self, name: str) -> list[tuple[str, int]]:
        """Find the nodes of the visitor that are an entity, and its number in each."""
        drawn: dict[str, list[str]] = msgspec.json.decode(self.page._names)  # noqa: SLF001
        return [
            (f"{path}/0/0", names.index(name))
            for path, names in drawn.items()
            if name in names and f"{path}/0/0" in self.visitor.nodes
        ]


@contextmanager
def visiting(
    driver: RobotDriver | None = None,
    clock: Callable[[], float] = time.monotonic,
    more_panels: Mapping[str, PanelFactory] = MappingProxyType({}),
) -> Iterator[Visit]:
    with (
        closing(
            ViewerPage("127.0.0.1", 0, driver=driver, more_panels=more_panels, clock=clock)
        ) as page,
        closing(connect_page(f"http://127.0.0.1:{page.port}")) as connection,
    ):
        connection.send(encode_camera())
        visit = Visit(page, connection)
        visit.set_world("r1", "r2", "w1", "s1")
        visit.until(lambda: page.is_watched, "a visitor")
        visit.until(lambda: "r1 · no agent" in visit.visitor.page_list.rows(), "a list")
        yield visit


@pytest.fixture
def visit() -> Iterator[Visit]:
    with visiting() as found:
        yield found


@pytest.fixture
def driver() -> Iterator[RobotDriver]:
    with closing(RobotDriver(MemoryBus())) as found:
        yield found


@pytest.fixture
def acting(driver: RobotDriver) -> Iterator[Visit]:
    """Visit a page that may act."""
    with visiting(driver) as found:
        yield found


@pytest.fixture
def bus() -> MemoryBus:
    return MemoryBus()


@pytest.fixture
def driving(bus: MemoryBus) -> Iterator[Visit]:
    """Visit a page whose driver has a clock that stands."""
    clock = StandingClock()
    with closing(RobotDriver(bus, clock)) as driver:
        with visiting(driver) as found:
            yield found
        clock.stands = False


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def editing(driver: RobotDriver, clock: ManualClock) -> Iterator[Visit]:
    """Visit a page whose clock a test advances."""
    with visiting(driver, clock) as found:
        yield found


@pytest.fixture
def commands(bus: MemoryBus) -> Subscription:
    return bus.subscribe(CMD_VEL.key("r1"), depth=1000)


def rows_of(visit: Visit) -> list[str]:
    return [row.split(" · ")[0] for row in visit.visitor.page_list.rows()]


def test_list_has_all_entities_by_category(visit: Visit) -> None:
    visit.until(lambda: sorted(rows_of(visit)) == ["r1", "r2", "s1", "w1"], "four rows")
    categories = {one[0]: one[1] for one in visit.visitor.page_list.entities}
    assert categories == {"r1": 0, "r2": 0, "s1": 0, "w1": 1}


def test_row_selects_its_entity(visit: Visit) -> None:
    visit.set("Names", value=False)
    visit.connection.send(encode_selection("r2"))

    visit.until_selected("r2")
    visit.until(lambda: "Stop following" in visit.visitor.labels(), "details")
    visit.until(lambda: "/selected/0" in visit.visitor.nodes, "an outline")
    visit.until(lambda: "/names/r2" in visit.visitor.nodes, "its name")
    visit.press("Stop following")
    visit.until_selected()
    visit.until(lambda: "/selected/0" not in visit.visitor.nodes, "no outline")
    visit.until(lambda: "/names/r2" not in visit.visitor.nodes, "no name")


def test_list_has_what_a_search_finds_and_colours_of_robots(visit: Visit) -> None:
    visit.set_world(*(f"r{number}" for number in range(300)))
    visit.until(lambda: len(rows_of(visit)) == 300, "all rows")

    assert visit.visitor.page_list.entities[1] == ["r1", 0, "r1 bot", "#e69f00"]


def test_an_empty_world_says_how_to_begin_where_a_visitor_may_act(acting: Visit) -> None:
    acting.set_world()

    acting.until(lambda: "empty: spawn a model in the tab Edit" in acting.visitor.texts(), "a hint")


def test_an_empty_world_does_not_offer_a_tab_that_is_not_there(visit: Visit) -> None:
    visit.set_world()

    visit.until(lambda: "The world is empty." in visit.visitor.texts(), "a note")


def test_shift_click_adds_and_removes(visit: Visit) -> None:
    visit.click("r1")
    visit.until_selected("r1")
    visit.click("r2", "shift")
    visit.until_selected("r1", "r2")
    visit.until(lambda: "/selected/1" in visit.visitor.nodes, "two outlines")
    visit.click("r1", "shift")
    visit.until_selected("r2")
    visit.click("w1")
    visit.until_selected("w1")


def test_selection_of_a_deleted_entity_ends(visit: Visit) -> None:
    visit.click("r1")
    visit.click("r2", "shift")
    visit.until_selected("r1", "r2")

    visit.set_world("r2", "w1")

    visit.until_selected("r2")
    visit.set_world()
    visit.until_selected()


def test_selection_ends_when_models_still_have_a_deleted_entity(visit: Visit) -> None:
    kinds = {"r1": a_robot(), "r2": a_robot()}
    visit.click("r1")
    visit.click("r2", "shift")
    visit.until_selected("r1", "r2")

    visit.fleet = make_fleet(("r2",), make_models_by_name(kinds))

    visit.until_selected("r2")
    visit.connection.send(encode_selection("r1"))
    visit.until_selected()


def test_show_all_ends_the_selection(visit: Visit) -> None:
    visit.click("r1")
    visit.until_selected("r1")

    visit.connection.send(encode_act("Show all"))

    visit.until_selected()


def test_camera_moves_as_chosen(visit: Visit) -> None:
    visit.click("r1")
    visit.until_selected("r1")
    camera = next(iter(visit.page._server.get_clients().values())).camera  # noqa: SLF001

    visit.set("Camera", "Top")
    visit.until(lambda: camera.position[2] > 2.9, "a camera above")
    visit.set("Camera", "Chase")
    visit.until(lambda: camera.position[2] < 1.0 and camera.position[0] < -1.0, "one behind")
    visit.set("Camera", "Fixed")
    visit.until(lambda: visit.client.camera_mode == "Fixed", "a camera that stays")
    before = np.array(camera.position)
    visit.base_x = 5.0
    visit.show()
    assert np.allclose(camera.position, before)
    visit.set("Camera", "Orbit")
    visit.until(lambda: camera.look_at[0] > 4.5, "an orbit around the robot")


def test_names_are_shown_above_robots_as_switched(visit: Visit) -> None:
    visit.set("Names", value=True)
    visit.until(lambda: {"/names/r1", "/names/s1"} <= visit.visitor.nodes.keys(), "names")
    assert "/names/w1" not in visit.visitor.nodes

    visit.base_x = 5.0
    visit.until(lambda: visit.visitor.stuck["/names/r1"][:2] == place_in_batch(visit, "r1"), "it")
    visit.set("Names", value=False)
    visit.until(lambda: "/names/r1" not in visit.visitor.nodes, "no names")


def test_names_are_sent_once(visit: Visit) -> None:
    visit.set("Names", value=True)
    visit.until(lambda: "/names/s1" in visit.visitor.nodes, "names")
    node = visit.visitor.nodes["/names/r1"]
    node["position"] = None

    shown_s = visit.time_s
    visit.base_x = 2.0
    visit.until(lambda: visit.time_s > shown_s + 1.0, "further frames")
    assert node["position"] is None


def test_outline_sticks_to_its_robot_when_others_come_and_go(visit: Visit) -> None:
    visit.set("Names", value=False)
    visit.click("r2")
    visit.until(lambda: "/selected/0" in visit.visitor.stuck, "an outline")
    assert visit.visitor.stuck["/selected/0"] == [*place_in_batch(visit, "r2"), None]

    visit.set_world("r2", "w1")

    visit.until(lambda: visit.visitor.stuck["/selected/0"][1] == 0, "its new number")
    visit.press("Stop following")
    visit.until(lambda: not visit.visitor.stuck, "nothing that sticks")


def place_in_batch(visit: Visit, name: str) -> list[object]:
    """Return the batch of the base of an entity, and its number there."""
    return [*(visit.client.state.find_instance(name) or ())]


@pytest.mark.parametrize(
    ("label", "path"),
    [
        ("Trails", "/trails"),
        ("Velocity arrows", "/velocities/"),
        ("Frames", "/frames"),
        ("Collision shapes", "/collisions/"),
    ],
)
def test_overlay_is_drawn_as_switched(visit: Visit, label: str, path: str) -> None:
    visit.speed_mps = 0.5
    visit.set(label, value=True)
    visit.until(lambda: visit.shows(path), f"{path} is shown")

    visit.set("Draw for", "Selection")
    visit.until(lambda: not visit.shows(path), "nothing is selected")
    visit.set("Draw for", "All entities")
    visit.until(lambda: visit.shows(path), f"{path} is shown again")
    visit.set_world("r2")
    visit.until(lambda: rows_of(visit) == ["r2"], "another world")
    visit.set(label, value=False)
    visit.until(lambda: not visit.shows(path), "nothing is shown")


def test_contacts_are_watched_and_drawn_as_switched(visit: Visit) -> None:
    watch = WatchedTopic("contacts")
    visit.set("Contacts", value=True)
    visit.until(lambda: watch in visit.page.watched, "a subscription")
    row = np.array([1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 9.0])

    def touch() -> bool:
        """Publish contacts, which are shown for a moment; whether the visitor has them."""
        visit.page.show_messages({watch: Contacts(0, 0, 0, (), (), b"", b"1234")})
        visit.page.show_messages({watch: Contacts(0, 0, 0, (), (), b"", row.tobytes())})
        visit.visitor.read()
        return visit.shows("/contacts/points") and visit.shows("/contacts/forces")

    visit.until(touch, "a point of contact, and its force")
    visit.until(lambda: not visit.shows("/contacts/"), "old contacts are removed")
    visit.until(touch, "a point of contact, and its force")
    visit.set("Contacts", value=False)
    visit.until(lambda: not visit.page.watched, "no subscription")
    visit.until(lambda: not visit.shows("/contacts/"), "no contacts")


def click_floor(visit: Visit, x: float, y: float, height_m: float = 5.0) -> None:
    """Click a point of the floor when the page waits for it."""
    visit.until(lambda: visit.visitor.waits_for_clicks, "waiting for a click")
    visit.connection.send(encode_floor_click(x, y, height_m))


def test_distance_of_two_clicks_is_shown_while_measuring(visit: Visit) -> None:
    visit.set("Measure", value=True)
    click_floor(visit, 1.0, 1.0)
    visit.until(lambda: visit.shows("/measure/start"), "the first point")
    click_floor(visit, 4.0, 5.0)
    visit.until(lambda: visit.shows("/measure/line"), "a line")
    visit.until(lambda: visit.shows("/measure/distance"), "the distance")
    assert visit.visitor.nodes["/measure/distance"]["text"] == "5.000 m"

    visit.set("Measure", value=False)
    visit.until(lambda: not visit.shows("/measure/"), "nothing")


@pytest.mark.parametrize("title", ["Speed", "Turn rate", "Position", "Real-time factor"])
def test_chart_is_there_as_switched(visit: Visit, title: str) -> None:
    visit.set("Speed", value=False)
    visit.click("r1")
    visit.until_selected("r1")

    visit.set(title, value=True)
    visit.until(visit.charts, "a chart")
    visit.until(lambda: visit.updates_of_charts() > 1, "new points")
    visit.set(title, value=False)
    visit.until(lambda: not visit.charts(), "no chart")


def test_sensor_is_plotted_as_chosen(visit: Visit) -> None:
    watch = WatchedTopic("scan", "s1", "scan")
    visit.set("Speed", value=False)
    visit.click("s1")
    visit.until_selected("s1")
    visit.set("Sensor", "scan")
    visit.until(lambda: watch in visit.page.watched, "a subscription")

    visit.page.show_messages({watch: LaserScan(range_max=9.0, ranges=(1.0,))})
    visit.until(visit.charts, "a chart")
    visit.set("Sensor", "none")
    visit.until(lambda: not visit.charts() and watch not in visit.page.watched, "no chart")


def test_plots_are_saved_as_csv(visit: Visit) -> None:
    visit.press("Save as CSV")
    visit.until(lambda: visit.visitor.notices, "a notification that nothing is plotted")
    visit.click("r1")
    visit.until(visit.charts, "the chart of the speed")

    visit.press("Save as CSV")

    visit.until(lambda: visit.visitor.downloads == ["zensim_plot.csv"], "a download")


def test_sensor_is_shown_as_switched(visit: Visit) -> None:
    visit.click("s1")
    visit.until_selected("s1")
    visit.until(lambda: "Show scan scan" in visit.visitor.labels(), "switches")

    visit.set("Show scan scan", value=True)
    visit.until(lambda: visit.page.shown_sensors == {SensorChoice("s1", "scan")}, "a scan")
    visit.set("Show scan scan", value=False)
    visit.until(lambda: not visit.page.shown_sensors, "no scan")


@pytest.mark.parametrize(
    ("label", "value"),
    [
        ("Draw for", "Exploded"),
        ("Draw for", [1.0, 2.0, 3.0]),
        ("Names", "yes"),
        ("Names", 1.0),
        ("Save as CSV", "now"),
    ],
)
def test_control_takes_no_value_that_it_does_not_offer(
    visit: Visit, capfd: pytest.CaptureFixture[str], label: str, value: object
) -> None:
    visit.set(label, value)
    visit.connection.send(encode_selection("r1"))

    visit.until_selected("r1")
    assert len(rows_of(visit)) == 4
    assert capfd.readouterr() == ("", "")


def test_removed_control_is_without_effect(visit: Visit) -> None:
    visit.click("r1")
    visit.until(lambda: "Stop following" in visit.visitor.labels(), "details")
    uuid = visit.visitor.find("Stop following")
    visit.click("r2")
    visit.until_selected("r2")

    visit.connection.send(encode_update(uuid, value=True))
    visit.set("Names", value=True)

    visit.until(lambda: "/names/r1" in visit.visitor.nodes, "what was sent after it")
    assert visit.page.selected == {"r2"}


def test_a_speed_set_by_others_is_shown_and_not_set_again(acting: Visit) -> None:
    acting.factor = 20.0
    acting.until(lambda: acting.visitor.controls[speed_of(acting)]["value"] == 10.0, "the slider")
    acting.show()

    acting.set("Speed", 2.0)
    acting.until(lambda: acting.list_requests(SetSpeedRequest), "a request")

    assert acting.list_requests(SetSpeedRequest) == [SetSpeedRequest(2.0)]


def speed_of(visit: Visit) -> str:
    """Return the uuid of the slider of the real-time factor."""
    return visit.visitor.find("Speed")


def read(commands: Subscription) -> list[Twist]:
    return [decode_twist(one.payload, one.encoding) for one in commands.take()]


def is_driven(commands: Subscription) -> bool:
    return any(one != Twist() for one in read(commands))


def wait_for_stop(visit: Visit, commands: Subscription) -> None:
    def is_stopped() -> bool:
        visit.page.wait_for_input(0.01)
        return Twist() in read(commands)

    eventually(is_stopped, WITHIN_S, "a stop")


ENDS: dict[str, Callable[[Visit], None]] = {
    "released key": lambda visit: visit.connection.send(encode_drive()),
    "hidden page": lambda visit: visit.connection.send(encode_leave()),
    "closed page": lambda visit: visit.connection.close(),
    "Stop all": lambda visit: visit.press("Stop all"),
    "another robot": lambda visit: visit.click("r2"),
    "no robot": lambda visit: visit.press("Stop following"),
}


@pytest.mark.parametrize("end", ENDS.values(), ids=ENDS)
def test_a_robot_that_is_driven_stops_at_each_end(
    driving: Visit, commands: Subscription, end: Callable[[Visit], None]
) -> None:
    select(driving, "r1")
    driving.connection.send(encode_drive(forward=1.0))
    driving.until(lambda: is_driven(commands), "driving")

    end(driving)

    wait_for_stop(driving, commands)


@pytest.mark.parametrize(("forward", "turn"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_what_is_held_drives_at_the_chosen_share_until_it_is_released(
    driving: Visit, commands: Subscription, forward: float, turn: float
) -> None:
    select(driving, "r1")
    driving.set("Speed [%]", 50)
    driving.show()

    driving.connection.send(encode_drive(forward=forward, turn=turn))
    first = eventually(lambda: next(iter(read(commands)), None), WITHIN_S, "a command")
    driving.connection.send(encode_drive())

    assert first.linear.x == pytest.approx(0.5 * forward * USUAL_SPEED_M_S)
    assert first.angular.z == pytest.approx(0.5 * turn * USUAL_TURN_RAD_S)
    wait_for_stop(driving, commands)


@contextmanager
def joining(visit: Visit) -> Iterator[tuple[ClientConnection, PageVisitor]]:
    """Open the page a second time."""
    with closing(connect_page(f"http://127.0.0.1:{visit.page.port}")) as connection:
        visitor = PageVisitor(connection)
        connection.send(encode_camera())
        visit.until(lambda: "Select a robot" in visitor.texts(), "controls of another visitor")
        yield connection, visitor


def test_the_first_visitor_is_another_visitor_to_the_second(
    acting: Visit, driver: RobotDriver
) -> None:
    with joining(acting) as (connection, second):
        connection.send(encode_selection("r1"))
        acting.until(lambda: "driven by" in second.texts(), "a selection")

        driver.take_over(0, "r1")

        acting.until(lambda: "driven by another visitor" in second.texts(), "the driver")


@pytest.mark.parametrize(
    ("speed_mps", "command", "who"),
    [
        (0.0, None, "nothing"),
        (0.3, None, "its behaviour"),
        (0.3, LastCommand(0.3, 0.0, age_s=0.1), "cmd_vel  v 0.30 m/s"),
        (0.0, LastCommand(0.3, 0.0, age_s=9.0), "nothing; cmd_vel  v 0.30 m/s"),
    ],
)
def test_it_is_said_who_drives_a_robot_that_no_visitor_drives(
    acting: Visit, speed_mps: float, command: LastCommand | None, who: str
) -> None:
    acting.speed_mps = speed_mps
    acting.commands = {"r1": command} if command is not None else {}
    select(acting, "r1")

    acting.until(lambda: f"r1: driven by {who}" in acting.visitor.texts(), "who drives it")


def test_of_two_visitors_one_drives_and_the_other_may_take_over(
    driving: Visit, commands: Subscription
) -> None:
    select(driving, "r1")
    with joining(driving) as (connection, other):
        connection.send(encode_selection("r1"))
        driving.connection.send(encode_drive(forward=1.0))
        driving.until(lambda: "driven by another visitor" in other.texts(), "a selection")

        connection.send(encode_drive(forward=-1.0))
        driving.until(lambda: other.was_notified("another visitor drives r1"), "a refusal")
        other.set("Take over", value=True)
        driving.until(lambda: driving.visitor.was_notified("taken over r1"), "a notification")
        wait_for_stop(driving, commands)
        connection.send(encode_drive(forward=0.0))  # the key is released, and pressed anew
        connection.send(encode_drive(forward=-1.0))

        driving.until(lambda: any(one.linear.x < 0.0 for one in read(commands)), "driving")
        driving.until(lambda: "r1: driven by you" in other.texts(), "the new driver")


def delete(visit: Visit, name: str) -> None:
    select(visit, name)
    visit.press("Delete")
    visit.until(lambda: visit.visitor.was_notified(f"{name}: deleted in"), "a notification")


def test_a_deletion_takes_effect_after_the_time_to_undo_it(
    editing: Visit, clock: ManualClock
) -> None:
    delete(editing, "r1")
    clock.sleep(UNDO_S - 0.1)
    editing.show()
    assert editing.list_requests(DeleteEntityRequest) == []

    clock.sleep(0.1)

    editing.until(lambda: editing.list_requests(DeleteEntityRequest), "a request")
    assert editing.list_requests(DeleteEntityRequest) == [DeleteEntityRequest("r1")]


def test_an_undone_deletion_has_no_effect(editing: Visit, clock: ManualClock) -> None:
    delete(editing, "r1")
    editing.press("Undo")
    editing.until(lambda: editing.visitor.was_notified("r1: kept"), "a notification")

    delete(editing, "r2")
    clock.sleep(UNDO_S)

    editing.until(lambda: editing.list_requests(DeleteEntityRequest), "a request")
    assert editing.list_requests(DeleteEntityRequest) == [DeleteEntityRequest("r2")]


@pytest.mark.parametrize("is_closed", [True, False], ids=["by its visitor", "by the server"])
def test_what_could_still_be_undone_is_deleted_when_the_page_is_closed(
    editing: Visit, *, is_closed: bool
) -> None:
    delete(editing, "r1")
    if is_closed:
        editing.connection.close()
        orders: list[Order] = []

        def is_left() -> bool:
            orders.extend(editing.page.wait_for_input(0.01))
            return not editing.page.is_watched

        eventually(is_left, WITHIN_S, "leaving")
        orders += editing.page.wait_for_input(0.0)
    else:
        orders = editing.page.end_visits()

    assert [one.request for one in orders if isinstance(one, WorldCall)] == [
        DeleteEntityRequest("r1")
    ]


def test_a_model_is_chosen_by_its_picture(acting: Visit) -> None:
    acting.until(lambda: acting.list_requests(GetSpawnablesRequest), "a request for models")
    (asked,) = (
        one
        for one in acting.orders
        if isinstance(one, WorldCall) and isinstance(one.request, GetSpawnablesRequest)
    )
    uris = (f"zensim://{model}" for model in ("box_bot", "car_bot"))
    asked.on_reply(GetSpawnablesResponse(spawnables=tuple(map(make_spawnable, uris))))
    acting.until(lambda: 'data-zensim-model="car_bot"' in acting.visitor.texts(), "pictures")

    acting.connection.send(encode_model("car_bot"))
    acting.until(lambda: acting.visitor.value_of("Model") == "car_bot", "a model")
    acting.connection.send(encode_model("unknown"))
    acting.connection.send(encode_selection("r1"))
    acting.until_selected("r1")
    assert acting.visitor.value_of("Model") == "car_bot"


def make_spawnable(uri: str) -> Spawnable:
    return Spawnable(entity_resource=Resource(uri=uri))


def test_a_world_runs_to_one_time_at_a_time_for_all_visitors(acting: Visit) -> None:
    def list_runs() -> list[WorldCall]:
        calls = [one for one in acting.orders if isinstance(one, WorldCall)]
        return [one for one in calls if isinstance(one.request, RunToRequest)]

    acting.set("Time [s]", 20.0)
    acting.press("Run to this time")
    acting.until(list_runs, "a run")
    with joining(acting) as (_, other):
        acting.until(lambda: "Run to this time" in other.labels(), "its tab")
        other.set("Run to this time", value=True)
        acting.until(lambda: other.was_notified("another visitor runs the world"), "a refusal")
        acting.until(lambda: "Running to 20 s, for another visitor" in other.texts(), "its text")

        list_runs()[0].on_reply(RunToResponse())
        acting.until(lambda: "Running to" not in other.texts(), "the end of the run")
        other.set("Run to this time", value=True)
        acting.until(lambda: len(list_runs()) == 2, "a second run")

        acting.press("Cancel run")
        acting.until(lambda: acting.list_requests(CancelStepsRequest), "a request")
        list_runs()[1].on_error("canceled")
        acting.until(lambda: other.was_notified("canceled"), "a notification")


def test_a_time_line_goes_on_after_a_request_that_failed() -> None:
    with visiting(more_panels={"Recording": ReplayPanel}) as visit:
        visit.until(lambda: visit.list_requests(ReplayRequest), "a request for the position")
        (asked,) = (one for one in visit.orders if isinstance(one, WorldCall))

        asked.on_error("the server replies too late")

        visit.until(lambda: len(visit.list_requests(ReplayRequest)) == 2, "the next request")


def begin(visit: Visit, label: str, purpose: str) -> None:
    """Use a control that takes the next click; callbacks of controls have no order among them."""
    visit.set(label, value=True)
    visit.until(lambda: visit.client.picker.purpose == purpose, label)


def test_a_click_serves_the_last_purpose_only(acting: Visit, driver: RobotDriver) -> None:
    select(acting, "r1")
    begin(acting, "Measure", "measure")
    begin(acting, "Drive to", "drive")
    begin(acting, "Place by click", "place")
    acting.until(lambda: acting.was_cleared("Measure"), "no measuring")

    click_floor(acting, 1.5, 2.5)

    place = "Place x, y [m]"
    acting.until(lambda: list(acting.visitor.value_of(place)) == [1.5, 2.5], "a place")
    assert driver.list_paths(0) == frozenset()
    assert not acting.shows("/measure/")


def test_another_selection_cancels_a_drive_to(acting: Visit) -> None:
    select(acting, "r1")
    begin(acting, "Drive to", "drive")
    acting.until(lambda: acting.visitor.waits_for_clicks, "waiting for a click")

    select(acting, "r2")

    acting.until(lambda: not acting.visitor.waits_for_clicks, "no waiting")


def test_a_click_on_the_sky_ends_measuring(acting: Visit) -> None:
    acting.set("Measure", value=True)

    click_floor(acting, 1.0, 1.0, height_m=-5.0)

    acting.until(lambda: acting.was_cleared("Measure"), "no measuring")


def select(visit: Visit, name: str) -> None:
    visit.click(name)
    visit.until_selected(name)


def test_input_without_end_does_not_stop_the_drawing(visit: Visit) -> None:
    def act() -> None:
        visit.page._use(0, act)  # noqa: SLF001  as a message would

    act()

    visit.page.wait_for_input(0.1)


def test_a_steered_robot_is_not_sent_to_a_point(acting: Visit) -> None:
    acting.set_world("c1")
    select(acting, "c1")

    acting.press("Drive to")

    acting.until(lambda: acting.visitor.was_notified("c1 is steered"), "a refusal")
    assert not acting.visitor.waits_for_clicks
