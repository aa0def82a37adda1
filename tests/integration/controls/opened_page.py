"""The page of four robots and a wall in Chromium, whose controls tests use by pointer and keys.

Each test names the controls that it uses; one of the page that no test names fails a test.
"""

import functools
import re
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.integration.chromium import Chromium, Tab
from tests.integration.docs_media import HAS_ROBOTS, PHONE, WIDE
from tests.integration.page_controls import Control, PageControls
from tests.integration.processes import Server, eventually
from tests.integration.test_page_sensors import WALL
from tests.integration.test_view import read
from zensim.proto.bus.bus_session import BusPublisher
from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.spawn_messages import Resource, SpawnEntity
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Twist
from zensim.proto.messages.telemetry_messages import Info
from zensim.proto.network_protocols import Subscription
from zensim.proto.topic_catalog import CMD_VEL
from zensim.sim_server.description.builtin_models import read_builtin_model

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
FLOOR_SHARES = {WIDE: 0.85, PHONE: 0.45}
"""Shares of the height where the ground is, of a camera that follows a robot."""
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
  const now = performance.now(), marked = window.zensimMarked || [];
  if (!(window.zensimAskedAt > now - 3000)) {
    window.zensimAskedAt = now;
    window.__viserMutable.sendMessage({type: "ZensimSelect", entity: "%s"});
  }
  const isDone = marked.join() === "%s";
  if (isDone) window.zensimAskedAt = -Infinity;
  return isDone;
})()
"""
"""Selects an entity or none; whether it alone is marked in the list. Asks again rarely."""
DRAW_WHEN_ASKED = """
for (const kind of ["Arrays", "Elements", "ArraysInstanced", "ElementsInstanced"]) {
  const page = WebGL2RenderingContext.prototype, draw = page[`draw${kind}`];
  page[`draw${kind}`] = function (...all) { if (window.zensimDraws) draw.apply(this, all); };
}
"""
"""Draws nothing until a test asks for it: that took most of the time, and few tests look at it."""
NOTE_DRIVING = """
(() => {
  const marks = window.zensimMarks;
  window.zensimMarks = (names) => { window.zensimMarked = names; marks(names); };
  const drives = window.zensimDrives;
  window.zensimDrives = (value) => { window.zensimIsDriving = value; drives(value); };
})()
"""
"""Stores whether keys drive a robot, as the server last sent it to the script of the page."""
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
PAUSE = "new Promise((done) => setTimeout(() => done(true), %d))"
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


MORE = a_button("Edit", "Name, layout, heading")
"""A folder that is closed at first."""
CHARTS = ("Speed", "Turn rate", "Position", "Real-time factor")
NUMBER_OF_CHARTS = (
    "[...document.querySelectorAll('.uplot')].filter(o => o.checkVisibility()).length"
)
SENSOR = a_choice("Plots", "Sensor")


@dataclass(frozen=True)
class Page:
    """A page in a browser, and its server."""

    server: Server
    url: str
    tab: Tab
    controls: PageControls
    downloads: Path
    size: tuple[int, int] = WIDE
    """Of the window [px]."""

    def select(self, name: str) -> None:
        """Select a robot alone, as the address of the page could, until keys drive it."""
        self.controls.until(SELECT_ALONE % (name, name))
        self.controls.until("window.zensimIsDriving")

    def deselect(self) -> None:
        """Select nothing."""
        self.controls.until(SELECT_ALONE % ("", ""))
        self.controls.until("!window.zensimIsDriving")

    def click_scene(self, across: float = 0.5, *, by_finger: bool = False) -> None:
        """Click the floor at a share of the width."""
        left, top, width, height = self.tab.evaluate(SCENE_BOX)
        click = self.tab.touch if by_finger else self.tab.click
        click(left + across * width, top + FLOOR_SHARES[self.size] * height)

    def click_scene_until(
        self,
        is_done: Callable[[], bool],
        what: str,
        across: float = 0.5,
        *,
        by_finger: bool = False,
    ) -> None:
        """Click the floor until it has an effect: the page may not wait for a click yet."""

        def attempt() -> bool:
            self.click_scene(across, by_finger=by_finger)
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


def open_page(browser: Chromium, url: str, folder: Path, size: tuple[int, int]) -> Tab:
    """Open a page in a window or on a phone [px], with the focus; a folder has saved files."""
    tab = browser.tab()
    tab.call("Emulation.setFocusEmulationEnabled", enabled=True)
    tab.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    tab.set_size(*size, is_mobile=size == PHONE)
    tab.call("Page.enable")
    tab.call("Page.addScriptToEvaluateOnNewDocument", source=DRAW_WHEN_ASKED)
    tab.call("Page.navigate", url=f"{url}/?fixedDpr={COARSE}")
    tab.until(HAS_ROBOTS, 120.0)
    tab.evaluate(NOTE_DRIVING)
    tab.until("document.body.innerText.includes('Software WebGL')", 120.0)
    PageControls(tab).click(a_button("", "Close"))
    tab.until("!document.body.innerText.includes('Software WebGL')")
    PageControls(tab).click(a_checkbox("Plots", CHARTS[0]))  # on at first; tests count charts
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


def is_moving(commands: Subscription, is_so: Callable[[Twist], bool]) -> Callable[[], bool]:
    """Make a claim that a command has come."""
    return lambda: any(is_so(one) for one in read(commands))


def is_stopped(commands: Subscription) -> Callable[[], bool]:
    return lambda: Twist() in read(commands)
