"""Messages of the page's own script; the script of keys and gamepads in node."""

import json
import shutil
import subprocess

import msgspec
import pytest

from zensim.spawner.page.page_files import read_page_file
from zensim.spawner.page.script_messages import (
    ScriptMessage,
    ZensimAct,
    ZensimDrive,
    ZensimLeave,
    ZensimSelect,
    read_script_message,
)

NODE = shutil.which("node") or "node"
# A page without rendering: listeners, one timer, and what the script sends.
PAGE = """
const listeners = {}, sent = [], pads = [];
let tick = () => {}, hasFocus = true;
class HTMLElement {
  closest(list) { return list.replace(/:not[(].*?[)]/, "").includes(this.kind) ? this : null; }
  blur() { stopped.push("focus"); }
}
globalThis.HTMLElement = HTMLElement;
globalThis.window = globalThis;
window.__viserMutable = {sendMessage: (message) => sent.push(message)};
Object.defineProperty(globalThis, "navigator", {value: {getGamepads: () => pads}});
globalThis.document = {hidden: false, hasFocus: () => hasFocus,
  addEventListener: (kind, call) => { listeners[kind] = call; }};
globalThis.addEventListener = (kind, call) => { listeners[kind] = call; };
globalThis.setInterval = (call) => { tick = call; };
const stopped = [];
function key(kind, code, more) {
  listeners[kind]({code, target: null, preventDefault: () => {},
    stopImmediatePropagation: () => stopped.push(code), ...more});
}
const down = (code, more) => key("keydown", code, more), up = (code) => key("keyup", code);
"""
END = """
console.log(JSON.stringify({stopped, sent: sent.map(
  ({type, forward, left, turn}) => type === "ZensimDrive" ? [forward, left, turn] : type)}));
"""
STOP = [0, 0, 0]


def run(actions: str, *, is_on: bool = True) -> tuple[list[object], list[str]]:
    """Run the script and actions; return what it sent, and keys that viser did not get."""
    script = f"{PAGE}{read_page_file('drive_keys.js')}"
    code = f"{script};window.zensimDrives({str(is_on).lower()});{actions};{END}"
    done = subprocess.run(
        [NODE, "-e", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == ""
    found = json.loads(done.stdout)
    # A negative zero is a zero.
    sent = [[axis + 0 for axis in one] if isinstance(one, list) else one for one in found["sent"]]
    return sent, found["stopped"]


@pytest.mark.browser
@pytest.mark.parametrize(
    ("codes", "deflection"),
    [
        (["KeyW"], [1, 0, 0]),
        (["ArrowDown"], [-1, 0, 0]),
        (["KeyA"], [0, 0, 1]),
        (["ArrowRight"], [0, 0, -1]),
        (["KeyQ"], [0, 1, 0]),
        (["KeyW", "ArrowUp", "KeyD"], [1, 0, -1]),
        (["KeyW", "KeyS"], [0, 0, 0]),
    ],
)
def test_held_keys_are_sent_until_they_are_released(
    codes: list[str], deflection: list[int]
) -> None:
    presses = ";".join(f"down('{code}')" for code in codes)
    releases = ";".join(f"up('{code}')" for code in codes)

    sent, stopped = run(f"{presses};tick();{releases};tick();tick();tick();tick();tick()")

    assert deflection in sent
    assert sent[-2:] == [STOP, STOP]
    assert set(stopped) == set(codes)


@pytest.mark.browser
def test_a_key_that_repeats_itself_is_sent_once_per_period() -> None:
    assert run("down('KeyW');down('KeyW');down('KeyW');tick()")[0] == [[1, 0, 0]] * 2


@pytest.mark.browser
def test_keys_are_left_to_viser_while_no_robot_is_selected() -> None:
    assert run("down('KeyW');tick();up('KeyW')", is_on=False) == ([], [])


@pytest.mark.browser
@pytest.mark.parametrize(
    "more",
    [
        "{ctrlKey: true}",
        "{shiftKey: true}",
        "{target: Object.assign(new HTMLElement(), {kind: 'textarea'})}",
        "{target: Object.assign(new HTMLElement(), {kind: '[role=menu]'})}",
    ],
)
def test_keys_with_control_or_shift_and_those_of_fields_and_menus_do_not_drive(more: str) -> None:
    assert run(f"down('KeyW', {more});tick()") == ([], [])


@pytest.mark.browser
@pytest.mark.parametrize("more", ["{}", "{shiftKey: true}"])
def test_space_stops_with_and_without_shift(more: str) -> None:
    sent, stopped = run(f"down('KeyW');down('Space', {more});tick()")

    assert sent == [[1, 0, 0], STOP, STOP]
    assert stopped == ["KeyW", "Space"]


@pytest.mark.browser
@pytest.mark.parametrize("kind", ["[role=tab]", "[role=slider]"])
def test_letters_drive_though_a_control_has_the_focus_and_arrows_move_in_it(kind: str) -> None:
    control = f"{{target: Object.assign(new HTMLElement(), {{kind: '{kind}'}})}}"

    assert run(f"down('ArrowUp', {control});tick()") == ([], [])
    assert run(f"down('KeyW', {control})") == ([[1, 0, 0]], ["KeyW"])


@pytest.mark.browser
@pytest.mark.parametrize(
    "event",
    [
        "listeners.blur()",
        "listeners.pagehide()",
        "document.hidden = true;listeners.visibilitychange()",
    ],
)
def test_a_hidden_page_says_so_at_once_and_forgets_its_keys(event: str) -> None:
    sent, _ = run(f"down('KeyW');{event};tick();tick()")

    assert sent == [[1, 0, 0], "ZensimLeave"]


@pytest.mark.browser
def test_a_hidden_page_that_drives_nothing_sends_nothing() -> None:
    assert run("listeners.blur()")[0] == []


@pytest.mark.browser
def test_space_stops_though_a_key_is_held() -> None:
    assert run("down('KeyW');down('Space');tick()")[0] == [[1, 0, 0], STOP, STOP]


@pytest.mark.browser
@pytest.mark.parametrize("kind", ["[role=tab]", "[role=slider]", "input[type=checkbox]"])
def test_space_stops_though_a_control_has_the_focus_which_it_then_loses(kind: str) -> None:
    focused = f"{{target: Object.assign(new HTMLElement(), {{kind: '{kind}'}})}}"

    sent, stopped = run(f"down('KeyW', {focused});down('Space', {focused})")

    assert sent == [[1, 0, 0], STOP]
    assert stopped == ["KeyW", "Space", "focus"]


@pytest.mark.browser
def test_a_held_button_of_the_pad_drives_and_its_stop_ends_what_is_held() -> None:
    sent, _ = run("zensimHold('KeyA', true);tick();zensimHold('KeyA', false);tick()")
    assert sent == [[0, 0, 1], [0, 0, 1], STOP, STOP]

    sent, _ = run("down('KeyW');zensimStop();tick()")
    assert sent == [[1, 0, 0], STOP, STOP]


@pytest.mark.browser
def test_pad_is_without_effect_while_no_robot_is_selected() -> None:
    assert run("zensimHold('KeyW', true);tick()", is_on=False) == ([], [])


@pytest.mark.browser
def test_deselecting_the_robot_sends_zeros() -> None:
    sent, _ = run("down('KeyW');window.zensimDrives(false);tick();tick();tick();tick()")

    assert sent == [[1, 0, 0], STOP, STOP, STOP]


@pytest.mark.browser
def test_a_gamepad_drives_beyond_its_dead_zone_while_the_page_has_the_focus() -> None:
    sent, _ = run(
        "pads.push({connected: true, axes: [0.1, -0.5, -1]});tick();"
        "hasFocus = false;tick();pads.pop();pads.push(null);tick()"
    )

    assert sent == [[0.5, 0, 1], STOP, STOP]


@pytest.mark.parametrize(
    "message",
    [
        ZensimAct("Reset all"),
        ZensimAct("Show all"),
        ZensimAct("Give up"),
        ZensimDrive(1.0, 0.0, -0.5),
        ZensimLeave(),
        ZensimSelect("r1"),
        ZensimSelect("r1", is_added=True),
    ],
)
def test_messages_of_the_script_are_read(message: ScriptMessage) -> None:
    assert read_script_message(msgspec.msgpack.encode(message)) == message


@pytest.mark.parametrize(
    "fields",
    [
        {"type": "ZensimDrive", "forward": 1.1, "left": 0.0, "turn": 0.0},
        {"type": "ZensimDrive", "forward": float("nan"), "left": 0.0, "turn": 0.0},
        {"type": "ZensimDrive", "forward": 1.0},
        {"type": "ZensimSelect", "entity": "r" * 257},
        {"type": "ZensimAct", "act": "Explode"},
        {"type": "ViewerCameraMessage"},
        {},
    ],
)
def test_other_messages_are_not(fields: dict[str, object]) -> None:
    assert read_script_message(msgspec.msgpack.encode(fields)) is None


def test_bytes_that_are_no_message_are_not_read() -> None:
    assert read_script_message(b"\xff" * 9) is None
