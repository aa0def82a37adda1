"""Every control of the page, used by a real pointer and real keys in Chromium.

Each test names the controls that it uses, and observes their effect on the world, the bus, the
scene or a file. The page lists its controls by its accessibility tree, its keys and mouse by its
help, and its commands by its palette: one that no test names fails the last test.
"""

import functools
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.deploy.recorded_worlds import write_world
from tests.integration.chromium import Chromium, Tab
from tests.integration.docs_media import HAS_ROBOTS
from tests.integration.page_controls import Control, PageControls
from tests.integration.page_user import PageUser
from tests.integration.processes import Server, eventually, running, serving
from tests.integration.test_page_sensors import PLACE_OF, POINTS_OF, WALL
from tests.integration.test_view import CAMERA, read, viewing
from zensim.proto import keys
from zensim.proto.bus import BusPublisher
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.sensor_messages import Contacts
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntitiesOrder, SpawnEntity
from zensim.proto.messages.standard_messages import (
    Image,
    Imu,
    LaserScan,
    Point,
    Pose,
    PoseStamped,
    Twist,
    Vector3,
)
from zensim.proto.messages.telemetry_messages import Info
from zensim.proto.network_protocols import Subscription
from zensim.proto.topic_catalog import CMD_VEL, CONTACTS, SCAN
from zensim.sim_server.description.builtin_models import list_builtin_models, read_builtin_model
from zensim.spawner.page.drive_control import REPEAT_S
from zensim.spawner.page.shortcuts import COMMANDS, PageCommand

pytestmark = pytest.mark.browser

WINDOW = (900, 700)
COARSE = 0.3
"""Pixels of the scene per pixel of the window: WebGL in software draws the fewer faster."""
WITHIN_S = 60.0
TABS = ("Entities", "See", "Plots", "Drive", "Edit", "Time")
ROBOTS = {
    "r1": ("box_bot", (0.0, 0.0)),
    "r2": ("box_bot_lidar", (0.0, 1.5)),
    "r3": ("box_bot_camera", (1.5, 0.0)),
    "r4": ("omni_bot", (1.5, 1.5)),
}
WALL_AT = (4.0, 0.0, 0.5)
SHIFT = 8
"""Bit of a modifier in messages of the browser."""
FLOOR_SHARE = (0.5, 0.85)
"""Place in the scene where the ground is, of a camera that follows a robot."""
SCENE_BOX = """
(() => {
  const box = window.__viserMutable.canvas.getBoundingClientRect();
  return [box.left, box.top, box.width, box.height];
})()
"""
HAS_NODE = """Object.entries(window.__viserSceneTree.getState()).some(([path, node]) =>
  path.startsWith('%s') && node.message.type !== "FrameMessage")"""
"""Whether the scene has a node, other than an empty parent, whose path begins so."""
SELECT_ALONE = """
(() => {
  const now = performance.now(), named = Object.keys(window.__viserSceneTree.getState())
    .filter((one) => one.startsWith("/names/")).map((one) => one.slice(7));
  if (!(window.zensimAskedAt > now - 3000)) {
    window.zensimAskedAt = now;
    window.__viserMutable.sendMessage({type: "ZensimSelect", entity: "%s"});
  }
  const isDone = named.join() === "%s";
  if (isDone) window.zensimAskedAt = -Infinity;
  return isDone;
})()
"""
"""Selects an entity or none; whether its name alone is shown. Asks again rarely."""
ALONG_HANDLES = """
(() => {
  const {camera, canvas, nodeRefFromName} = window.__viserMutable;
  const box = canvas.getBoundingClientRect(), at = (metres) => {
    const seen = camera.position.clone().set(metres, 0, 0)
      .applyMatrix4(nodeRefFromName["/handles"].matrixWorld).project(camera);
    return [box.left + (seen.x + 1) / 2 * box.width, box.top + (1 - seen.y) / 2 * box.height];
  };
  return [at(0.5), at(1.0)];
})()
"""
"""Places on the screen along the x axis of the handles of an entity."""
NOTE_DRIVING = """
(() => {
  const drives = window.zensimDrives;
  window.zensimDrives = (value) => { window.zensimIsDriving = value; drives(value); };
})()
"""
"""Notes whether keys drive a robot, of which the server notifies the script of the page."""
HELP_ENTRIES = """
[...document.querySelectorAll("#zensim-help h3")].filter((one) => one.innerText !== "What is drawn")
  .flatMap((one) => [...one.nextElementSibling.querySelectorAll("dt")].map((two) => two.innerText))
"""
PALETTE_ENTRIES = """
[...document.querySelectorAll(".mantine-Spotlight-actionLabel, [class*=Spotlight-actionLabel]")]
  .map((one) => one.innerText)
"""
PALETTE_PLACE = """
(() => {
  const found = [...document.querySelectorAll("[class*=Spotlight-actionLabel]")].find(
    (one) => one.innerText === %r);
  const box = found && found.getBoundingClientRect();
  return box && box.width && [box.left + box.width / 2, box.top + box.height / 2];
})()
"""
USED: set[Control] = set()
"""Controls that tests name."""
Exercise = Callable[..., None]


def a_button(tab: str, name: str, number: int = 0) -> Control:
    return Control(tab, "button", name, number)


def a_checkbox(tab: str, name: str) -> Control:
    return Control(tab, "checkbox", name)


def a_field(tab: str, name: str, number: int = 0) -> Control:
    return Control(tab, "textbox", name, number)


def a_choice(tab: str, name: str) -> Control:
    return Control(tab, "combobox", name)


def a_key(entry: str) -> Control:
    """Name keys, or what the mouse does, as the help has it."""
    return Control("", "help", entry)


def a_command(label: str) -> Control:
    """Name a command of the palette."""
    return Control("", "command", label)


def normalize(control: Control) -> Control:
    """Replace what depends on the world in the name of a control."""
    name = re.sub(r"\(\d+\)$", "(N)", control.name)
    name = re.sub(r"^.+ · .+$", "ROW", name)
    name = re.sub(r"^(Show scan|Show picture)\b.*$", r"\1", name)
    name = re.sub(r"^r\d$", "SELECTED", name)
    number = 0 if name in ("ROW", "Show scan", "Show picture") else control.number
    return Control(control.tab, control.role, name, number)


def uses(*controls: Control) -> Callable[[Exercise], Exercise]:
    """Name the controls that a test uses; it fails if it did not."""
    USED.update(map(normalize, controls))

    def wrap(test: Exercise) -> Exercise:
        @functools.wraps(test)
        def run(page: "Page", **more: object) -> None:
            page.controls.used.clear()
            test(page, **more)
            assert {*controls} <= page.controls.used

        return run

    return wrap


@dataclass(frozen=True)
class Page:
    """A page in a browser, and its server."""

    server: Server
    url: str
    tab: Tab
    controls: PageControls
    downloads: Path

    def select(self, name: str) -> None:
        """Select a robot alone, as the address of the page could, until keys drive it."""
        self.controls.until(SELECT_ALONE % (name, name))
        self.controls.until("window.zensimIsDriving")

    def deselect(self) -> None:
        """Select nothing."""
        self.controls.until(SELECT_ALONE % ("", ""))
        self.controls.until("!window.zensimIsDriving")

    def click_scene(self, share: tuple[float, float] = FLOOR_SHARE) -> None:
        """Click a place in the scene, as shares of its width and height."""
        left, top, width, height = self.tab.evaluate(SCENE_BOX)
        self.tab.click(left + share[0] * width, top + share[1] * height)

    def click_scene_until(
        self,
        is_done: Callable[[], bool],
        what: str,
        share: tuple[float, float] = FLOOR_SHARE,
    ) -> None:
        """Click the floor until it has an effect: the page may not wait for a click yet."""

        def attempt() -> bool:
            self.click_scene(share)
            return bool(self.tab.evaluate(PAUSE % 500)) and is_done()

        eventually(attempt, WITHIN_S, what)

    def has_node(self, path: str) -> bool:
        """Whether the scene has such a node."""
        return bool(self.tab.evaluate(HAS_NODE % path))

    def until_node(self, path: str) -> None:
        """Wait until the scene has such a node."""
        self.controls.until(HAS_NODE % path)

    def until_no_node(self, path: str) -> None:
        """Wait until the scene has no such node."""
        self.controls.until("!" + HAS_NODE % path)

    def until_info(self, is_so: Callable[[Info], bool], what: str) -> Info:
        """Wait for the state of the world."""

        def find() -> Info | None:
            info = self.server.client.info()
            return info if is_so(info) else None

        return eventually(find, WITHIN_S, what)

    def state_of(self, entity: str) -> EntityState:
        """Get the state of an entity."""
        return self.server.client.entity_state(entity)

    def until_file(self, pattern: str) -> Path:
        """Wait for a file that the browser saves."""

        def find() -> Path | None:
            return next((one for one in self.downloads.glob(pattern) if one.stat().st_size), None)

        return eventually(find, WITHIN_S, f"a file {pattern}")

    @contextmanager
    def commands(self, robot: str) -> Iterator[Subscription]:
        """Subscribe to the commands of a robot."""
        with closing(self.server.bus.subscribe(CMD_VEL.key(robot), depth=1000)) as found:
            yield found

    @contextmanager
    def publishing(self, key: str, kind: type[Any]) -> Iterator[BusPublisher]:
        """Publish on a key, to see whether the page subscribes to it."""
        with closing(self.server.bus.advertise(key, make_encoding(kind, Format.CDR))) as found:
            yield found

    def press(self, key: str, entry: str, *, modifiers: int = 0, text: str = "") -> None:
        """Press a key that the help has."""
        self.controls.leave_field()
        more = {"text": text} if text else {}
        self.controls.press_key(key, modifiers=modifiers, **more)
        self.controls.used.add(a_key(entry))

    def run_command(self, label: str) -> None:
        """Choose a command of the palette by its keys and a click."""
        self.press("k", "Ctrl+K", modifiers=2)
        self.controls.until(PALETTE_PLACE % label)
        self.tab.evaluate(PAUSE % 400)  # it slides in
        self.tab.click(*self.tab.evaluate(PALETTE_PLACE % label))
        self.controls.used.add(a_command(label))


PAUSE = "new Promise((done) => setTimeout(() => done(true), %d))"


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """Open the page of four robots and a wall once for all tests."""
    folder = tmp_path_factory.mktemp("downloads")
    with serving() as server:
        server.client.spawn_all(SpawnEntitiesOrder((*list_spawns(),)))
        with viewing(server.endpoint) as (url, _), Chromium() as browser:
            tab = open_small(browser, url, folder)
            tab.until("document.body.innerText.includes('playing')", 120.0)
            yield Page(server, url, tab, PageControls(tab), folder)


def open_small(browser: Chromium, url: str, folder: Path) -> Tab:
    """Open a page in a small window, with the focus, and with files saved in a folder."""
    tab = browser.tab()
    tab.call("Emulation.setFocusEmulationEnabled", enabled=True)
    tab.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    tab.set_size(*WINDOW)
    tab.call("Page.navigate", url=f"{url}/?fixedDpr={COARSE}")
    tab.until(HAS_ROBOTS, 120.0)
    tab.evaluate(NOTE_DRIVING)
    tab.until("document.body.innerText.includes('Software WebGL')", 120.0)
    PageControls(tab).click(a_button("", "Close"))
    tab.until("!document.body.innerText.includes('Software WebGL')")
    return tab


def list_spawns() -> Iterator[SpawnEntity]:
    """List the entities of the world."""
    for name, (model, (x, y)) in ROBOTS.items():
        yield SpawnEntity(
            name=name,
            entity_namespace=name,
            entity_resource=Resource(resource_string=read_builtin_model(model)),
            initial_pose=PoseStamped(pose=Pose(Point(x, y))),
        )
    yield SpawnEntity(
        name="wall",
        entity_resource=Resource(resource_string=WALL),
        initial_pose=PoseStamped(pose=Pose(Point(*WALL_AT))),
    )


@pytest.fixture
def page(opened: Page) -> Page:
    """Return the page with nothing selected, in a world that plays and is as it was."""
    for name in set(opened.server.client.entities()) - {*ROBOTS, "wall"}:
        opened.server.client.delete(name)
    opened.controls.press_key("Escape")
    opened.controls.leave_field()
    if opened.server.client.simulation_state() != State.PLAYING:
        opened.server.client.set_simulation_state(State.PLAYING)
    opened.controls.until_text("playing")
    opened.deselect()
    return opened


def is_moving(commands: Subscription, is_so: Callable[[Twist], bool]) -> Callable[[], bool]:
    """Make a claim that a command has come."""
    return lambda: any(is_so(one) for one in read(commands))


def is_stopped(commands: Subscription) -> Callable[[], bool]:
    return lambda: Twist() in read(commands)


# Beside the tabs: the simulation, and tools.


@uses(a_button("", "Pause"), a_button("", "Step"), a_button("", "Reset"), a_button("", "Play"))
def test_buttons_of_the_simulation(page: Page) -> None:
    page.controls.click(a_button("", "Pause"))
    before = page.until_info(lambda info: info.state == "paused", "a pause")
    page.controls.click(a_button("", "Step"))
    page.until_info(lambda info: info.steps == before.steps + 1, "a step")
    page.controls.click(a_button("", "Reset"))
    page.until_info(lambda info: info.epoch == before.epoch + 1, "a reset")
    page.controls.click(a_button("", "Play"))
    page.until_info(lambda info: info.state == "playing", "playing")


@uses(*(Control("", "tab", title) for title in TABS))
def test_tabs_show_their_controls(page: Page) -> None:
    for title, control in {
        "See": a_checkbox("See", "Trails"),
        "Plots": a_button("Plots", "Save as CSV"),
        "Drive": a_button("Drive", "Forward"),
        "Edit": a_button("Edit", "Spawn"),
        "Time": a_button("Time", "Cancel run"),
        "Entities": a_button("Entities", "Show all"),
    }.items():
        page.controls.click(Control("", "tab", title))
        page.controls.until_there(control)


HELP = "Help: mouse, keys, what is drawn"
IS_HELP_OPEN = "document.getElementById('zensim-help').open"


@uses(a_button("", HELP), a_button("", "Close help"), a_key("?"))
def test_help_opens_and_closes(page: Page) -> None:
    page.controls.click(a_button("", HELP))
    page.controls.until(IS_HELP_OPEN)
    page.controls.click(a_button("", "Close help"))
    page.controls.until(f"!{IS_HELP_OPEN}")

    for is_open in ("", "!"):
        page.press("?", "?", text="?")
        page.controls.until(is_open + IS_HELP_OPEN)


@uses(a_button("", "Copy a link to this view"))
def test_link_is_in_the_address_bar(page: Page) -> None:
    page.select("r1")

    page.controls.click(a_button("", "Copy a link to this view"))

    page.controls.until("location.search.includes('robot=r1')")


PICTURE, FILM = "Save a picture of the view, PNG", "Save a film of the view, WebM"


@uses(a_button("", PICTURE), a_button("", FILM))
def test_view_is_saved_in_files(page: Page) -> None:
    page.controls.click(a_button("", PICTURE))
    assert page.until_file("*.png").read_bytes().startswith(b"\x89PNG")

    page.controls.click(a_button("", FILM))
    page.controls.until("document.getElementById('zensim-tools').innerText.includes('Stop')")
    page.controls.click(a_button("", FILM))
    assert page.until_file("*.webm").read_bytes().startswith(b"\x1a\x45\xdf\xa3")


@uses(a_button("", "Switch between light and dark"))
def test_theme_is_switched(page: Page) -> None:
    scheme = "document.documentElement.dataset.mantineColorScheme"
    for _ in range(2):
        before = page.tab.evaluate(scheme)
        page.controls.click(a_button("", "Switch between light and dark"))
        page.controls.until(f"{scheme} !== '{before}'")


@uses(a_button("", "Settings"), a_button("", "Collapse panel area"))
def test_panel_shows_settings_and_is_collapsed(page: Page) -> None:
    shows_all = a_button("Entities", "Show all")
    page.controls.turn_to("Entities")
    page.controls.click(a_button("", "Settings"))
    page.controls.click(a_button("", "Back to the controls"))
    page.controls.until_there(shows_all)

    page.controls.click(a_button("", "Collapse panel area"))
    eventually(lambda: page.controls.find(shows_all) is None, WITHIN_S, "a panel out of the way")
    page.controls.click(a_button("", "Expand column"))
    page.controls.until_there(shows_all)


# Mouse and keys.


@uses(a_key("Drag"), a_key("Drag with the right button, or with two fingers"))
@uses(a_key("Wheel, or two fingers apart"))
def test_camera_is_turned_moved_and_zoomed(page: Page) -> None:
    left, top, width, height = page.tab.evaluate(SCENE_BOX)
    x, y = left + width / 2.0, top + height / 3.0

    def changes(act: Callable[[], None], entry: str) -> None:
        before = page.tab.evaluate(CAMERA)
        act()
        eventually(lambda: page.tab.evaluate(CAMERA) != before, WITHIN_S, entry)
        page.controls.used.add(a_key(entry))

    def wheel() -> None:
        at = {"x": x, "y": y}
        page.tab.call("Input.dispatchMouseEvent", type="mouseWheel", deltaX=0, deltaY=120, **at)

    changes(lambda: page.controls.drag((x, y), (x + 60.0, y)), "Drag")
    changes(
        lambda: page.controls.drag((x, y), (x + 60.0, y), button="right"),
        "Drag with the right button, or with two fingers",
    )
    changes(wheel, "Wheel, or two fingers apart")


@uses(a_key("Click on a robot"), a_key("Shift and click on a robot"), a_key("Pointer over a robot"))
def test_robots_are_named_and_selected_by_the_pointer(page: Page) -> None:
    page.controls.click(a_button("Entities", "Show all"))
    tip = "document.getElementById('zensim-name')"

    def point() -> bool:
        page.tab.point(*page.tab.evaluate(PLACE_OF % ("r1", "r1")))
        return bool(page.tab.evaluate(f"{tip}.style.display !== 'none' && {tip}.innerText"))

    def click(*, modifiers: int, is_selected: bool) -> bool:
        page.tab.click(*page.tab.evaluate(PLACE_OF % ("r1", "r1")), modifiers=modifiers)
        page.tab.evaluate(PAUSE % 1000)
        return page.has_node("/selected/0") == is_selected

    eventually(point, WITHIN_S, "its name")
    eventually(lambda: click(modifiers=0, is_selected=True), WITHIN_S, "a selection")
    eventually(lambda: click(modifiers=SHIFT, is_selected=False), WITHIN_S, "its end")
    page.controls.used |= {
        a_key("Pointer over a robot"),
        a_key("Click on a robot"),
        a_key("Shift and click on a robot"),
    }


HELD: dict[tuple[str, str], tuple[str, Callable[[Twist], bool]]] = {
    ("KeyW", "w"): ("W S or arrows", lambda one: one.linear.x > 0.0),
    ("KeyS", "s"): ("W S or arrows", lambda one: one.linear.x < 0.0),
    ("ArrowUp", "ArrowUp"): ("W S or arrows", lambda one: one.linear.x > 0.0),
    ("ArrowDown", "ArrowDown"): ("W S or arrows", lambda one: one.linear.x < 0.0),
    ("KeyA", "a"): ("A D or arrows", lambda one: one.angular.z > 0.0),
    ("KeyD", "d"): ("A D or arrows", lambda one: one.angular.z < 0.0),
    ("ArrowLeft", "ArrowLeft"): ("A D or arrows", lambda one: one.angular.z > 0.0),
    ("ArrowRight", "ArrowRight"): ("A D or arrows", lambda one: one.angular.z < 0.0),
    ("KeyQ", "q"): ("Q E", lambda one: one.linear.y > 0.0),
    ("KeyE", "e"): ("Q E", lambda one: one.linear.y < 0.0),
}


@uses(*(a_key(entry) for entry, _ in HELD.values()))
def test_held_keys_drive_until_they_are_released(page: Page) -> None:
    page.select("r4")
    with page.commands("r4") as commands:
        for (code, key), (entry, is_so) in HELD.items():
            with page.controls.holding_key(code, key):
                eventually(is_moving(commands, is_so), WITHIN_S, code)
            eventually(is_stopped(commands), WITHIN_S, f"the release of {code}")
            page.controls.used.add(a_key(entry))


@uses(a_key("Space"))
def test_space_stops_while_a_key_is_held(page: Page) -> None:
    page.select("r1")
    with page.commands("r1") as commands, page.controls.holding_key("KeyW", "w"):
        eventually(is_moving(commands, lambda one: one.linear.x > 0.0), WITHIN_S, "driving")
        with page.controls.holding_key("Space", " "):
            eventually(is_stopped(commands), WITHIN_S, "a stop")
        page.controls.used.add(a_key("Space"))


@uses(a_key("Gamepad"))
def test_a_gamepad_drives(page: Page) -> None:
    page.select("r1")
    with page.commands("r1") as commands:
        page.tab.evaluate(
            "navigator.getGamepads = () => [{connected: true, axes: [0, -1, 0, 0]}]; 0"
        )
        eventually(is_moving(commands, lambda one: one.linear.x > 0.0), WITHIN_S, "driving")
        page.tab.evaluate("navigator.getGamepads = () => []; 0")
        eventually(is_stopped(commands), WITHIN_S, "a stop")
        page.controls.used.add(a_key("Gamepad"))


# Commands, by the palette and by keys.


def play_or_pause(page: Page, act: Callable[[], None]) -> None:
    act()
    page.until_info(lambda info: info.state == "paused", "a pause")
    page.controls.until_text("paused")
    act()
    page.until_info(lambda info: info.state == "playing", "playing")


def step_once(page: Page, act: Callable[[], None]) -> None:
    page.server.client.set_simulation_state(State.PAUSED)
    before = page.server.client.info()
    page.controls.until_text("paused")
    act()
    page.until_info(lambda info: info.steps == before.steps + 1, "a step")


def reset(page: Page, act: Callable[[], None]) -> None:
    before = page.server.client.info()
    act()
    page.until_info(lambda info: info.epoch == before.epoch + 1, "a reset")


def stop_all(page: Page, act: Callable[[], None]) -> None:
    with page.commands("r2") as commands:
        act()
        eventually(is_stopped(commands), WITHIN_S, "a stop")


def take_over(page: Page, act: Callable[[], None]) -> None:
    with PageUser(page.url) as other:
        other.wait_for_row("r1")
        other.send("ZensimSelect", entity="r1")
        eventually(lambda: "r1: driven by" in other.texts(), WITHIN_S, "its selection")
        page.select("r1")
        with page.commands("r1") as commands, holding_forward(other):
            eventually(is_moving(commands, lambda one: one.linear.x > 0.0), WITHIN_S, "driving")
            act()
            eventually(lambda: "taken over r1" in str(other.notifications), WITHIN_S, "a notice")


@contextmanager
def holding_forward(user: PageUser) -> Iterator[None]:
    """Repeat the input of a held key as a page does: a visitor keeps its robot for seconds only."""
    is_over = threading.Event()

    def repeat() -> None:
        while not is_over.wait(REPEAT_S):
            user.send("ZensimDrive", forward=1.0, left=0.0, turn=0.0)

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def drive_to(page: Page, act: Callable[[], None]) -> None:
    page.select("r1")
    with page.commands("r1") as commands:
        act()
        page.click_scene_until(is_moving(commands, lambda one: one != Twist()), "driving")
        with page.controls.holding_key("Space", " "):
            eventually(is_stopped(commands), WITHIN_S, "a stop")


def delete(page: Page, act: Callable[[], None]) -> None:
    spawn(page, "doomed")
    page.select("doomed")
    act()
    eventually(lambda: "doomed" not in page.server.client.entities(), WITHIN_S, "a deletion")


def undo(page: Page, act: Callable[[], None]) -> None:
    spawn(page, "kept")
    page.select("kept")
    page.controls.click(a_button("Edit", "Delete"))
    page.controls.until_text("kept: deleted in")
    act()
    page.controls.until_text("kept: kept")
    assert "kept" in page.server.client.entities()
    page.server.client.delete("kept")


def spawn(page: Page, name: str) -> None:
    done = page.server.zensim("spawn", "box_bot", "--name", name, "-x", "-2")
    assert done.returncode == 0, done.stderr


EFFECTS: dict[str, Callable[[Page, Callable[[], None]], None]] = {
    "Play or pause": play_or_pause,
    "Step once": step_once,
    "Reset time and poses": reset,
    "Stop all robots": stop_all,
    "Take over the selected robot": take_over,
    "Drive to a click on the floor": drive_to,
    "Delete what is selected": delete,
    "Undo the deletion": undo,
}
USED |= {a_command(label) for label in EFFECTS}
USED |= {a_key(one.keys) for one in COMMANDS if one.label in EFFECTS} | {a_key("Ctrl+K")}


@pytest.mark.parametrize("label", EFFECTS)
def test_command_of_the_palette_has_its_effect(page: Page, label: str) -> None:
    EFFECTS[label](page, lambda: page.run_command(label))


@pytest.mark.parametrize("command", COMMANDS, ids=lambda one: one.label)
def test_key_of_a_command_has_its_effect(page: Page, command: PageCommand) -> None:
    modifiers = SHIFT if command.modifier else 0
    key = command.key if command.modifier else command.key.lower()

    EFFECTS[command.label](page, lambda: page.press(key, command.keys, modifiers=modifiers))


@uses(a_button("", "Command palette"))
def test_palette_opens_by_its_button(page: Page) -> None:
    page.controls.click(a_button("", "Command palette"))
    page.controls.until(f"({PALETTE_ENTRIES.strip()}).length === {len(EFFECTS)}")
    page.controls.until_there(a_field("", "Search commands..."))


# The tab "Entities".

SEARCH = a_field("Entities", "Search")


@uses(SEARCH)
def test_search_narrows_the_list(page: Page) -> None:
    page.controls.write(SEARCH, "r2")
    page.controls.until_text("1 of 5 found")
    page.controls.write(SEARCH, "")
    page.controls.until_text("5 of 5 found")


STATUS = a_choice("Entities", "Status")


@uses(STATUS)
def test_status_narrows_the_list(page: Page) -> None:
    page.controls.choose(STATUS, "No agent")
    page.controls.until_text("4 of 5 found")
    page.controls.choose(STATUS, "All")
    page.controls.until_text("5 of 5 found")


@uses(
    a_button("Entities", "r1 · no agent"),
    a_button("Entities", "Stop following"),
    a_button("Entities", "Show all"),
)
def test_row_selects_and_buttons_end_it(page: Page) -> None:
    for end in ("Stop following", "Show all"):
        page.controls.click(a_button("Entities", "r1 · no agent"))
        page.controls.until_text("Namespace\nr1")
        page.until_node("/selected/0")
        page.controls.click(a_button("Entities", end))
        page.until_no_node("/selected/0")


@uses(a_choice("Entities", "Camera"))
def test_camera_follows_as_chosen(page: Page) -> None:
    page.select("r1")
    page.controls.choose(a_choice("Entities", "Camera"), "Top")
    page.controls.until(f"{CAMERA.strip()}[1] > 2.5")
    page.controls.choose(a_choice("Entities", "Camera"), "Chase")
    page.controls.until(f"{CAMERA.strip()}[1] < 1.0")
    page.controls.choose(a_choice("Entities", "Camera"), "Orbit")


@uses(a_checkbox("Entities", "Show scan"))
def test_scan_is_shown_and_hidden(page: Page) -> None:
    scan = encode(LaserScan(range_max=9.0, ranges=(1.0, 1.0), angle_increment=0.1), Format.CDR)
    page.select("r2")
    with page.publishing(SCAN.key("r2"), LaserScan) as publisher:
        page.controls.click(a_checkbox("Entities", "Show scan"))

        def is_shown() -> bool:
            publisher.send(scan)
            return page.tab.evaluate(POINTS_OF % "r2") is not None

        eventually(is_shown, WITHIN_S, "points")
        page.controls.click(a_checkbox("Entities", "Show scan"))
        page.until_no_node("/scans/r2")


@uses(a_checkbox("Entities", "Show picture camera/image_raw"))
def test_picture_is_subscribed_to_while_it_is_shown(page: Page) -> None:
    label = "Show picture camera/image_raw"
    page.select("r3")
    with page.publishing(keys.robot("r3", "camera/image_raw"), Image) as publisher:
        page.controls.click(a_checkbox("Entities", label))
        eventually(lambda: publisher.is_matched, WITHIN_S, "a subscription")
        page.controls.click(a_checkbox("Entities", label))
        eventually(lambda: not publisher.is_matched, WITHIN_S, "its end")


FOLDERS = (
    ("Entities", "Robots (4)", "r4 · no agent"),
    ("Entities", "Objects (1)", "wall · static"),
    ("Entities", "Selection", "Stop following"),
    ("Entities", "r2", "Stop following"),
    ("Edit", "Spawn", "Place by click"),
    ("Edit", "Selected entity", "Undo"),
)


@pytest.mark.parametrize(("tab", "name", "inner"), FOLDERS)
def test_folder_is_closed_and_opened(page: Page, tab: str, name: str, inner: str) -> None:
    page.select("r2")
    page.controls.turn_to(tab)
    page.controls.click(a_button(tab, name))
    eventually(lambda: page.controls.find(a_button(tab, inner)) is None, WITHIN_S, "a fold")
    page.controls.click(a_button(tab, name))
    page.controls.until_there(a_button(tab, inner))


@uses(a_button("Entities", "Links and sensors"))
def test_links_and_sensors_are_listed(page: Page) -> None:
    page.select("r2")
    page.controls.click(a_button("Entities", "Links and sensors"))
    page.controls.until_text("lidar: scan")


USED |= {normalize(a_button(tab, name)) for tab, name, _ in FOLDERS}


# The tab "See".

OVERLAYS = {
    "Names": "/names/r1",
    "Trails": "/trails",
    "Velocity arrows": "/velocities/",
    "Frames": "/frames",
    "Collision shapes": "/collisions/",
}


@uses(*(a_checkbox("See", label) for label in OVERLAYS))
def test_overlays_are_drawn_as_switched(page: Page) -> None:
    page.select("r2")
    with page.publishing(CMD_VEL.key("r2"), Twist) as publisher:
        for label, path in OVERLAYS.items():
            page.controls.click(a_checkbox("See", label))

            def is_drawn(path: str = path) -> bool:
                publisher.send(encode(Twist(Vector3(x=0.5)), Format.CDR))
                return page.has_node(path)

            eventually(is_drawn, WITHIN_S, label)
    for label, path in OVERLAYS.items():
        page.controls.click(a_checkbox("See", label))
        page.until_no_node(path)


@uses(a_choice("See", "Draw for"))
def test_overlays_are_drawn_for_the_selection(page: Page) -> None:
    frames = a_checkbox("See", "Frames")
    page.controls.click(frames)
    page.until_node("/frames")
    page.controls.choose(a_choice("See", "Draw for"), "Selection")
    page.until_no_node("/frames")
    page.controls.choose(a_choice("See", "Draw for"), "All entities")
    page.until_node("/frames")
    page.controls.click(frames)


@uses(a_checkbox("See", "Contacts"))
def test_contacts_are_subscribed_to_while_they_are_shown(page: Page) -> None:
    with page.publishing(CONTACTS.key("default"), Contacts) as publisher:
        before = publisher.is_matched
        page.controls.click(a_checkbox("See", "Contacts"))
        eventually(lambda: publisher.is_matched, WITHIN_S, "a subscription")
        page.controls.click(a_checkbox("See", "Contacts"))
        eventually(lambda: not publisher.is_matched, WITHIN_S, "its end")
    assert not before


@uses(a_checkbox("See", "Measure"))
def test_two_clicks_measure_a_distance(page: Page) -> None:
    page.select("r1")
    page.controls.click(a_checkbox("See", "Measure"))
    page.click_scene_until(lambda: page.has_node("/measure/start"), "a start")
    page.click_scene_until(lambda: page.has_node("/measure/distance"), "a distance", (0.3, 0.85))
    page.controls.click(a_checkbox("See", "Measure"))
    page.until_no_node("/measure/")


# The tab "Plots".

CHARTS = ("Speed", "Turn rate", "Position", "Real-time factor")
NUMBER_OF_CHARTS = (
    "[...document.querySelectorAll('.uplot')].filter(o => o.checkVisibility()).length"
)


@uses(
    *(a_checkbox("Plots", title) for title in CHARTS),
    *(a_button("Plots", title) for title in CHARTS),
    a_button("Plots", "Save as CSV"),
)
def test_charts_are_drawn_folded_and_saved(page: Page) -> None:
    page.select("r1")
    for number, title in enumerate(CHARTS):
        page.controls.click(a_checkbox("Plots", title))
        page.controls.until(f"{NUMBER_OF_CHARTS} === {number + 1}")
    page.controls.click(a_button("Plots", "Save as CSV"))
    assert page.until_file("zensim_plot*.csv").read_text().startswith("simulation time [s]")
    for title in CHARTS:
        page.controls.click(a_button("Plots", title))
    page.controls.until(f"{NUMBER_OF_CHARTS} === 0")
    for title in CHARTS:
        page.controls.click(a_checkbox("Plots", title))
        page.controls.until(
            f"![...document.querySelectorAll('.zensim-fold')]"
            f".some(o => o.innerText === '{title}' && o.checkVisibility())"
        )


SENSOR = a_choice("Plots", "Sensor")


@uses(SENSOR, a_button("Plots", "Sensor"))
def test_sensor_is_plotted_as_chosen(page: Page) -> None:
    page.select("r2")
    with page.publishing(keys.robot("r2", "imu"), Imu) as publisher:
        page.controls.choose(SENSOR, "imu")
        eventually(lambda: publisher.is_matched, WITHIN_S, "a subscription")

        def is_drawn() -> bool:
            publisher.send(encode(Imu(), Format.CDR))
            return bool(page.tab.evaluate(f"{NUMBER_OF_CHARTS} === 1"))

        eventually(is_drawn, WITHIN_S, "a chart")
        page.controls.click(a_button("Plots", "Sensor"))
        page.controls.until(f"{NUMBER_OF_CHARTS} === 0")
        page.controls.choose(SENSOR, "none")
        eventually(lambda: not publisher.is_matched, WITHIN_S, "its end")


# The tab "Drive".

PAD: dict[str, Callable[[Twist], bool]] = {
    "Forward": lambda one: one.linear.x > 0.0,
    "Backward": lambda one: one.linear.x < 0.0,
    "Turn left": lambda one: one.angular.z > 0.0,
    "Turn right": lambda one: one.angular.z < 0.0,
}


@uses(*(a_button("Drive", label) for label in PAD))
def test_held_buttons_drive_until_they_are_released(page: Page) -> None:
    page.select("r1")
    with page.commands("r1") as commands:
        for label, is_so in PAD.items():
            with page.controls.holding(a_button("Drive", label)):
                eventually(is_moving(commands, is_so), WITHIN_S, label)
            eventually(is_stopped(commands), WITHIN_S, f"the release of {label}")


SHARE, SHARE_FIELD = Control("Drive", "slider", "Speed [%]"), a_field("Drive", "Speed [%]")


@uses(SHARE, SHARE_FIELD)
def test_speed_of_driving_is_chosen(page: Page) -> None:
    page.select("r1")
    with page.commands("r1") as commands:

        def find_speed() -> float:
            with page.controls.holding_key("KeyW", "w"):
                found: list[float] = []

                def is_found() -> bool:
                    found.extend(one.linear.x for one in read(commands) if one.linear.x)
                    return bool(found)

                eventually(is_found, WITHIN_S, "driving")
            eventually(is_stopped(commands), WITHIN_S, "a stop")
            return found[-1]

        full = find_speed()
        page.controls.slide(SHARE, 0.5)
        page.controls.leave_field()
        eventually(lambda: find_speed() == pytest.approx(0.5 * full, rel=0.2), WITHIN_S, "half")
        page.controls.write(SHARE_FIELD, "100")
        eventually(lambda: find_speed() == pytest.approx(full), WITHIN_S, "full speed")


@uses(a_button("Drive", "Stop"))
def test_stop_stops_a_held_key(page: Page) -> None:
    page.select("r1")
    page.controls.turn_to("Drive")
    with page.commands("r1") as commands, page.controls.holding_key("KeyW", "w"):
        eventually(is_moving(commands, lambda one: one.linear.x > 0.0), WITHIN_S, "driving")
        page.controls.click(a_button("Drive", "Stop"))
        eventually(is_stopped(commands), WITHIN_S, "a stop")


@uses(a_button("Drive", "Take over"))
def test_a_robot_is_taken_over_by_a_button(page: Page) -> None:
    take_over(page, lambda: page.controls.click(a_button("Drive", "Take over")))


@uses(a_button("Drive", "Drive to"))
def test_a_robot_drives_to_a_click(page: Page) -> None:
    drive_to(page, lambda: page.controls.click(a_button("Drive", "Drive to")))


@uses(a_button("Drive", "Stop all"))
def test_all_robots_are_stopped_by_a_button(page: Page) -> None:
    stop_all(page, lambda: page.controls.click(a_button("Drive", "Stop all")))


# The tab "Edit".

PLACE, TARGET = "Place x, y [m]", "Move to x, y [m], heading [deg]"


@uses(
    a_choice("Edit", "Model"),
    a_field("Edit", "Name"),
    a_field("Edit", "Count"),
    a_choice("Edit", "Layout"),
    a_field("Edit", "Spacing [m]"),
    a_field("Edit", PLACE),
    a_field("Edit", PLACE, 1),
    a_field("Edit", "Heading [deg]"),
    a_button("Edit", "Spawn", 1),
)
def test_robots_are_spawned_as_the_form_says(page: Page) -> None:
    page.controls.choose(a_choice("Edit", "Model"), "car_bot")
    page.controls.write(a_field("Edit", "Name"), "made")
    page.controls.write(a_field("Edit", "Count"), "2")
    page.controls.choose(a_choice("Edit", "Layout"), "row")
    page.controls.write(a_field("Edit", "Spacing [m]"), "3")
    page.controls.write(a_field("Edit", PLACE), "-6")
    page.controls.write(a_field("Edit", PLACE, 1), "4")
    page.controls.write(a_field("Edit", "Heading [deg]"), "90")

    page.controls.click(a_button("Edit", "Spawn", 1))

    page.controls.until_text("spawned made")
    places = [page.state_of(name).pose.position for name in ("made0", "made1")]
    assert [(one.x, one.y) for one in places] == [
        pytest.approx((-6.0, 4.0), abs=0.1),
        pytest.approx((-6.0, 7.0), abs=0.1),
    ]
    for name in ("made0", "made1"):
        page.server.client.delete(name)


@uses(*(a_button("Edit", model) for model in list_builtin_models()))
def test_model_is_that_of_a_picture(page: Page) -> None:
    for model in list_builtin_models():
        page.controls.click(a_button("Edit", model))
        is_chosen = functools.partial(has_value, page, a_choice("Edit", "Model"), model)
        eventually(is_chosen, WITHIN_S, model)


def has_value(page: Page, control: Control, value: str) -> bool:
    return page.controls.value_of(control) == value


@uses(a_button("Edit", "Place by click"))
def test_place_is_that_of_a_click(page: Page) -> None:
    field = a_field("Edit", PLACE)
    page.controls.write(field, "77")
    page.controls.click(a_button("Edit", "Place by click"))
    page.click_scene_until(lambda: page.controls.value_of(field) != "77", "a place")


@uses(a_checkbox("Edit", "Handles"))
def test_entity_is_moved_by_handles_in_the_scene(page: Page) -> None:
    page.select("r3")
    before = page.state_of("r3").pose.position
    page.controls.click(a_checkbox("Edit", "Handles"))
    page.until_node("/handles")

    def drag() -> bool:
        start, end = page.tab.evaluate(ALONG_HANDLES)
        page.controls.drag(start, end)
        page.tab.evaluate(PAUSE % 1000)
        now = page.state_of("r3").pose.position
        return abs(now.x - before.x) + abs(now.y - before.y) > 0.05

    eventually(drag, WITHIN_S, "another place")
    page.controls.click(a_checkbox("Edit", "Handles"))
    page.until_no_node("/handles")


@uses(*(a_field("Edit", TARGET, number) for number in range(3)), a_button("Edit", "Move"))
def test_entity_is_moved_to_numbers(page: Page) -> None:
    page.select("r3")
    for number, text in enumerate(("2.5", "-2", "90")):
        page.controls.write(a_field("Edit", TARGET, number), text)

    page.controls.click(a_button("Edit", "Move"))

    def is_there() -> bool:
        pose = page.state_of("r3").pose
        place = (pose.position.x, pose.position.y, pose.orientation.z)
        return place == pytest.approx((2.5, -2.0, 0.707), abs=0.1)

    eventually(is_there, WITHIN_S, "the place")


@uses(a_button("Edit", "Delete"))
def test_entity_is_deleted_by_a_button(page: Page) -> None:
    delete(page, lambda: page.controls.click(a_button("Edit", "Delete")))


@uses(a_button("Edit", "Undo"))
def test_deletion_is_undone_by_a_button(page: Page) -> None:
    undo(page, lambda: page.controls.click(a_button("Edit", "Undo")))


@uses(a_button("", "Close"))
def test_notification_is_closed(page: Page) -> None:
    page.controls.click(a_button("Edit", "Undo"))
    page.controls.until_text("nothing is being deleted")
    page.controls.click(a_button("", "Close"))
    page.controls.until_no_text("nothing is being deleted")


# The tab "Time".


@uses(*(a_button("Time", label) for label in ("1 step", "10 steps", "1 s")))
def test_world_is_stepped(page: Page) -> None:
    page.server.client.set_simulation_state(State.PAUSED)
    page.controls.until_text("paused")
    for label, steps in {"1 step": 1, "10 steps": 10, "1 s": 240}.items():
        goal = page.server.client.info().steps + steps
        page.controls.click(a_button("Time", label))
        page.until_info(functools.partial(has_steps, goal), label)


def has_steps(goal: int, info: Info) -> bool:
    return info.steps == goal


FACTOR, FACTOR_FIELD = Control("Time", "slider", "Speed"), a_field("Time", "Speed")


@uses(FACTOR, FACTOR_FIELD)
def test_real_time_factor_is_set(page: Page) -> None:
    page.controls.slide(FACTOR, 0.2)
    page.until_info(lambda info: 1.5 < info.target_real_time_factor < 2.5, "about 2")

    def write() -> bool:
        page.controls.write(FACTOR_FIELD, "1")
        page.tab.evaluate(PAUSE % 500)
        return page.server.client.info().target_real_time_factor == 1.0

    eventually(write, WITHIN_S, "1")  # the field follows the server, once a second


GOAL = a_field("Time", "Time [s]")


@uses(GOAL, a_button("Time", "Run to this time"), a_button("Time", "Cancel run"))
def test_world_runs_to_a_time_and_a_run_is_canceled(page: Page) -> None:
    page.server.client.set_simulation_state(State.PAUSED)
    goal = round(page.server.client.info().sim_time_s + 1.0, 1)
    page.controls.write(GOAL, f"{goal}")
    page.controls.click(a_button("Time", "Run to this time"))
    info = page.until_info(
        lambda info: info.state == "paused" and info.sim_time_s > goal - 0.01, "the goal"
    )
    assert info.sim_time_s == pytest.approx(goal, abs=0.01)

    page.controls.write(GOAL, "9999")
    page.controls.click(a_button("Time", "Run to this time"))
    page.controls.until_text("Running to 9999 s")
    page.controls.click(a_button("Time", "Cancel run"))
    page.controls.until_no_text("Running to 9999 s")
    page.until_info(lambda info: info.state == "paused", "its end")


@uses(a_choice("Time", "What to reset"), a_button("Time", "Reset", 1))
def test_time_alone_is_reset(page: Page) -> None:
    before = page.server.client.info()
    page.controls.choose(a_choice("Time", "What to reset"), "time")
    page.controls.click(a_button("Time", "Reset", 1))
    page.until_info(lambda info: info.epoch == before.epoch + 1, "a reset")
    page.controls.choose(a_choice("Time", "What to reset"), "time and poses")


# The page of a recording.


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageControls]:
    """Open the page of a recording of ten seconds."""
    folder = tmp_path_factory.mktemp("recording")
    path = write_world(folder / "run.mcap")
    with running("view", "--recording", str(path), "--port", "0", "--loop") as process:
        assert process.stdout is not None
        with Chromium() as browser:
            yield PageControls(open_small(browser, process.stdout.readline().split()[-1], folder))


POSITION = Control("Recording", "slider", "Position")
POSITION_FIELD, RATE = a_field("Recording", "Position"), a_choice("Recording", "Rate")
MOVES = ("Play", "Pause", "-5 s", "+5 s")
OF_RECORDING = {
    POSITION,
    POSITION_FIELD,
    RATE,
    *(a_button("Recording", label) for label in MOVES),
    Control("", "tab", "Recording"),
}


def test_controls_of_a_recording(recorded: PageControls) -> None:
    controls = recorded
    controls.click(Control("", "tab", "Recording"))
    controls.click(a_button("Recording", "Pause"))
    controls.until_text("of 0:10.00, paused")
    controls.write(POSITION_FIELD, "2")
    controls.until_text("0:02.00 of")
    controls.click(a_button("Recording", "+5 s"))
    controls.until_text("0:07.00 of")
    controls.click(a_button("Recording", "-5 s"))
    controls.until_text("0:02.00 of")
    controls.slide(POSITION, 0.5)
    controls.until(TIME_OF_RECORDING % "Math.abs(time - 5) < 0.6")
    controls.leave_field()
    controls.choose(RATE, "0.1")
    controls.click(a_button("Recording", "Play"))
    controls.until(TIME_OF_RECORDING % "time > 0")
    controls.until_text("of 0:10.00, playing")

    assert controls.used >= OF_RECORDING
    listed = controls.list_of_tabs("Recording", "Entities")
    of_tab = {normalize(one) for one in listed if one.tab == "Recording"}
    assert of_tab == {normalize(one) for one in OF_RECORDING if one.tab}


TIME_OF_RECORDING = """
(() => {
  const time = Number(/0:([0-9.]+) of 0:10/.exec(document.body.innerText)[1]);
  return %s;
})()
"""


# All of them.


def test_every_control_is_used_by_a_test(page: Page) -> None:
    controls = page.controls
    page.select("r3")
    listed = controls.list_of_tabs("Entities", "See")
    page.select("r2")
    controls.choose(SENSOR, "imu")
    with page.publishing(keys.robot("r2", "imu"), Imu) as publisher:
        for title in CHARTS:
            controls.click(a_checkbox("Plots", title))
        eventually(lambda: publisher.is_matched, WITHIN_S, "a subscription")
        publisher.send(encode(Imu(), Format.CDR))
        controls.until(f"{NUMBER_OF_CHARTS} === {len(CHARTS) + 1}")
    listed |= controls.list_of_tabs(*TABS)
    listed |= list_of_dialogs(page)

    found = {normalize(one) for one in listed}
    assert found - USED == set()
    assert USED - found == set()


def list_of_dialogs(page: Page) -> set[Control]:
    """List what notifications, the settings, a closed panel, the help and the palette have."""
    controls = page.controls
    listed = set[Control]()

    def list_with(act: Callable[[], None], shown: str) -> None:
        before = {one.element for one in controls.list_nodes()}
        act()
        controls.until(shown)
        page.tab.evaluate(PAUSE % 600)  # names are set each 0.25 s
        nodes = [one for one in controls.list_nodes() if one.element not in before]
        listed.update(Control("", one.role, one.name) for one in nodes)

    controls.turn_to("Edit")
    list_with(lambda: controls.click(a_button("Edit", "Undo")), HAS_NOTICE)
    list_with(lambda: controls.click(a_button("", HELP)), IS_HELP_OPEN)
    listed |= {a_key(entry) for entry in page.tab.evaluate(HELP_ENTRIES)}
    controls.press_key("Escape")
    controls.press_key("k", modifiers=2)
    commands = controls.until(f"({PALETTE_ENTRIES.strip()}).length && {PALETTE_ENTRIES.strip()}")
    listed |= {a_command(label) for label in commands}
    controls.press_key("Escape")
    return listed


HAS_NOTICE = "document.body.innerText.includes('nothing is being deleted')"
