"""Mouse, keys, commands and the tab Drive drive robots and change the world."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from tests.integration.controls.opened_page import (
    PALETTE_ENTRIES,
    PAUSE,
    SCENE_BOX,
    SHIFT,
    USED,
    WITHIN_S,
    Page,
    a_button,
    a_command,
    a_field,
    a_key,
    is_moving,
    is_stopped,
    uses,
)
from tests.integration.page_controls import Control
from tests.integration.page_user import PageUser
from tests.integration.processes import eventually
from tests.integration.test_page_sensors import PLACE_OF
from tests.integration.test_view import CAMERA, read
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Twist
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.spawner.page.drive_control import REPEAT_S
from zensim.spawner.page.shortcuts import COMMANDS, PageCommand

pytestmark = pytest.mark.browser

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
@pytest.mark.smoke
def test_held_keys_drive_until_they_are_released(page: Page) -> None:
    page.select("r4")
    with page.commands("r4") as commands:
        for (code, key), (entry, is_so) in HELD.items():
            with page.controls.holding_key(code, key):
                eventually(is_moving(commands, is_so), WITHIN_S, code)
            eventually(is_stopped(commands), WITHIN_S, f"the release of {code}")
            page.controls.used.add(a_key(entry))


@uses(a_key("Space"))
@pytest.mark.smoke
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

        def is_sent() -> bool:
            # What the page publishes before it knows the new subscriber is not sent to it.
            act()
            page.tab.evaluate(PAUSE % 1000)
            return is_stopped(commands)()

        eventually(is_sent, WITHIN_S, "a stop")


def is_free(robot: str, texts: str) -> bool:
    """Whether no other visitor drives, or keeps, the selected robot."""
    text = f"{robot}: driven by"
    return text in texts and f"{text} another visitor" not in texts


def take_over(page: Page, act: Callable[[], None]) -> None:
    with PageUser(page.url) as other:
        other.wait_for_row("r1")
        other.send("ZensimSelect", entity="r1")
        # A visitor keeps its robot for seconds, and a key that is pressed then has no effect.
        eventually(lambda: is_free("r1", other.texts()), WITHIN_S, "a free robot")
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
    page.server.client.spawn(
        SpawnEntityOrder(
            name=name,
            entity_resource=Resource(resource_string=read_builtin_model("box_bot")),
            initial_pose=PoseStamped(pose=Pose(Point(-2.0))),
        )
    )


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
USED |= {a_key(one.keys) for one in COMMANDS if one.label in EFFECTS}


KEEP_COMMANDS = """
(() => {
  const page = window.__viserMutable, send = page.sendMessage;
  window.zensimKept = [];
  window.zensimSendAgain = () => { page.sendMessage = send; };
  page.sendMessage = (message) => message.type === "CommandTriggerMessage" ?
    window.zensimKept.push(message.uuid) : send(message);
})()
"""
"""Keeps which commands the page would send."""


@uses(*(a_command(one.label) for one in COMMANDS), a_key("Ctrl+K"))
def test_palette_sends_the_commands_that_keys_send(page: Page) -> None:
    page.tab.evaluate(KEEP_COMMANDS)
    try:
        for command in COMMANDS:
            page.run_command(command.label)
            page.controls.until("window.zensimKept.length === 1")
            press_keys_of(page, command)
            page.controls.until("window.zensimKept.length === 2")
            first, second = page.tab.evaluate("window.zensimKept.splice(0)")
            assert first == second
    finally:
        page.tab.evaluate("window.zensimSendAgain()")


@uses(a_command("Play or pause"))
def test_command_of_the_palette_has_its_effect(page: Page) -> None:
    play_or_pause(page, lambda: page.run_command("Play or pause"))


@pytest.mark.parametrize("command", COMMANDS, ids=lambda one: one.label)
def test_key_of_a_command_has_its_effect(page: Page, command: PageCommand) -> None:
    EFFECTS[command.label](page, lambda: press_keys_of(page, command))


def press_keys_of(page: Page, command: PageCommand) -> None:
    modifiers = SHIFT if command.modifier else 0
    key = command.key if command.modifier else command.key.lower()
    page.press(key, command.keys, modifiers=modifiers)


@uses(a_button("", "Command palette"))
def test_palette_opens_by_its_button(page: Page) -> None:
    page.controls.click(a_button("", "Command palette"))
    page.controls.until(f"({PALETTE_ENTRIES.strip()}).length === {len(EFFECTS)}")
    page.controls.until_there(a_field("", "Search commands..."))


# What buttons of the tab "Edit" do, too.


@uses(a_button("Edit", "Delete"))
def test_entity_is_deleted_by_a_button(page: Page) -> None:
    delete(page, lambda: page.controls.click(a_button("Edit", "Delete")))


@uses(a_button("Edit", "Undo"))
def test_deletion_is_undone_by_a_button(page: Page) -> None:
    undo(page, lambda: page.controls.click(a_button("Edit", "Undo")))
