"""The page in Chromium for everybody: contrast, names, targets, keyboard, sizes, and a phone."""

from collections.abc import Iterator
from contextlib import closing

import pytest

from tests.integration.chromium import Chromium, Tab
from tests.integration.docs_media import PHONE, WIDE, show
from tests.integration.processes import Server, eventually, serving
from tests.integration.test_view import SELECT, read, viewing
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.network_protocols import Subscription
from zensim.proto.topic_catalog import CMD_VEL

pytestmark = pytest.mark.browser

ROBOT = "box_bot1"
TABS = ("Entities", "See", "Plots", "Drive", "Edit", "Time")
CONTROL_ROLES = {
    *("button", "checkbox", "combobox", "img", "image", "link", "menuitem", "radio", "slider"),
    *("spinbutton", "switch", "tab", "textbox", "toolbar", "Canvas"),
}
LEAST_CONTRAST = 4.5
LEAST_TARGET_PX = 44
TAB_PRESSES = 120
PATIENCE_S = 120.0
FIND = """
const CONTROLS = "button, a[href], input:not([type=hidden]), textarea, select, summary," +
  "[role=button], [role=tab], [role=slider]";
// A number has arrow keys beside its two small buttons; a scroll area has its wheel.
const isLeftOut = (one) => one.closest("[aria-hidden=true], .mantine-ScrollArea-scrollbar") ||
  one.matches(":disabled, .mantine-NumberInput-control");
const isShown = (one) => {
  const box = one.getBoundingClientRect();
  return box.width > 1 && box.height > 1 &&
    one.checkVisibility({opacityProperty: true, visibilityProperty: true});
};
const list = () => [...document.querySelectorAll(CONTROLS)]
  .filter((one) => isShown(one) && !isLeftOut(one));
const nameOf = (one) => [one.tagName, one.getAttribute("role"), one.getAttribute("aria-label"),
  one.innerText, one.id].filter(Boolean).join(" ").slice(0, 80);
const isWithinView = (one, x, y) => {
  // Parts of the last pixel are rounded out of the window.
  if (x < 0 || y < 0 || x >= innerWidth - 1 || y >= innerHeight - 1) return false;
  for (let box = one.parentElement; box; box = box.parentElement) {
    const {left, right, top, bottom} = box.getBoundingClientRect();
    const clips = getComputedStyle(box).overflow !== "visible";
    if (clips && (x < left || x > right || y < top || y > bottom)) return false;
  }
  return true;
};
"""
"""Finds the visible controls of the page."""
CONTRASTS = """
(() => {
  const read = (text) => {
    const found = (text.match(/[\\d.]+(e-?\\d+)?/g) || []).map(Number);
    const scale = text.startsWith("color(") ? 255 : 1;
    return [found[0] * scale, found[1] * scale, found[2] * scale, found[3] ?? 1];
  };
  // Colours are multiplied by their opacity.
  const layer = ([r, g, b, a]) => [r * a, g * a, b * a, a];
  const over = (top, low) => top.map((one, i) => one + low[i] * (1 - top[3]));
  function render(chain, i, text) {
    const style = getComputedStyle(chain[i]);
    const inner = i + 1 < chain.length ? render(chain, i + 1, text) : text;
    const own = layer(read(style.backgroundColor));
    return over(inner, own).map((one) => one * Number(style.opacity));
  }
  const luminance = (colour) => {
    const [r, g, b] = colour.slice(0, 3).map((one) => one / 255)
      .map((one) => one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  function contrast(element) {
    const chain = [];
    for (let one = element; one; one = one.parentElement) {
      chain.unshift(one);
      if (getComputedStyle(one).position === "fixed") break;  // above the scene
    }
    const text = layer(read(getComputedStyle(element).color));
    return Math.min(...[0, 255].map((grey) => {
      const scene = [grey, grey, grey, 1];
      const [a, b] = [render(chain, 0, text), render(chain, 0, [0, 0, 0, 0])]
        .map((one) => luminance(over(one, scene))).sort((x, y) => y - x);
      return (a + 0.05) / (b + 0.05);
    }));
  }
  const found = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const add = (element, text) => {
    if (!text.trim() || element.closest("script, style, noscript, :disabled, [data-disabled]"))
      return;
    if (!isShown(element)) return;
    found.push([text.trim().slice(0, 40), contrast(element)]);
  };
  while (walker.nextNode()) add(walker.currentNode.parentElement, walker.currentNode.data);
  // The value of a checkbox is not shown.
  const fields = document.querySelectorAll("input:not([type=checkbox], [type=radio])");
  for (const one of fields) add(one, one.value);
  return found;
})()
"""
"""Each visible text, and its contrast by WCAG 2.2; above the scene it may be black or white."""
LOW_CONTRASTS = f"{CONTRASTS.strip()}.filter((one) => !(one[1] >= {LEAST_CONTRAST}))"
COVERED = """
list().flatMap((one) => {
  const {left, right, top, bottom} = one.getBoundingClientRect();
  const points = [[0.5, 0.5], [0.1, 0.5], [0.9, 0.5], [0.5, 0.15], [0.5, 0.85]].map(
    ([x, y]) => [left + x * (right - left), top + y * (bottom - top)]);
  return points.filter(([x, y]) => isWithinView(one, x, y)).flatMap(([x, y]) => {
    const hit = document.elementFromPoint(x, y);
    const isOwn = hit && (one.contains(hit) || hit.contains(one) ||
      (one.labels && [...one.labels].some((label) => label.contains(hit))) ||
      // The field of a select and the arrow in it, a slider and its track.
      hit.closest(".mantine-Input-wrapper, .mantine-Slider-root, .mantine-Checkbox-inner")
        ?.contains(one));
    return isOwn ? [] : [`${nameOf(one)} by ${hit ? nameOf(hit) : "nothing"}`];
  });
})
"""
"""Controls within the window of which another element covers a point."""
OUTSIDE = """
list().filter((one) => {
  const {left, right} = one.getBoundingClientRect();
  return left < -0.5 || right > innerWidth + 0.5;
}).map(nameOf)
"""
"""Controls that are not within the width of the window."""
SMALL = """
list().filter((one) => {
  const {width, height} = one.getBoundingClientRect();
  return width < %(px)s - 0.5 || height < %(px)s - 0.5;
}).map((one) => {
  const {width, height} = one.getBoundingClientRect();
  return `${nameOf(one)} ${Math.round(width)} x ${Math.round(height)}`;
})
"""
WIDE_SWITCHES = """
[...document.querySelectorAll(".mantine-Checkbox-input")].filter((one) => one.checkVisibility() &&
  getComputedStyle(one).backgroundClip !== "padding-box").map((one) => `checked: ${one.checked}`)
"""
"""Switches that are drawn over all of their target."""
UNREACHED = """
list().filter((one) => !window.zensimReached.has(one)).filter((one) => {
  const tabs = one.closest("[role=tablist]");  // of which the arrow keys choose one
  return !(one.matches("[role=tab]") && tabs &&
    [...tabs.querySelectorAll("[role=tab]")].some((tab) => window.zensimReached.has(tab)));
}).map(nameOf)
"""
HIDE_NOTICES = """
[...document.querySelectorAll("style")]
  .filter((one) => one.textContent.trim().startsWith(".mantine-Notifications-root {"))
  .map((one) => { one.disabled = !%s; }).length
"""
"""Applies the style by which `show` hides notifications, or not; counts such styles."""
SELECT_ROBOT = SELECT % (ROBOT, "Stop following")
PLACE_OF_TAB = """
(() => {
  const tab = [...document.querySelectorAll("[role=tab]")].find(
    (one) => [one.title, one.innerText.trim()].includes("%s") && one.checkVisibility());
  tab.scrollIntoView({block: "center"});
  const box = tab.getBoundingClientRect();
  return [box.left + box.width / 2, box.top + box.height / 2];
})()
"""
IS_SELECTED = """
[...document.querySelectorAll("[role=tab][aria-selected=true]")].some(
  (one) => [one.title, one.innerText.trim()].includes("%s") && one.checkVisibility())
"""
PLACE_OF_BUTTON = """
(() => {
  const button = [...document.querySelectorAll("button")].find(
    (one) => one.innerText.trim().startsWith("%s") && one.checkVisibility());
  button.scrollIntoView({block: "center"});
  const box = button.getBoundingClientRect();
  return [box.left + box.width / 2, box.top + box.height / 2];
})()
"""


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as found:
        assert found.zensim("fleet", "box_bot", "--robots", "3").returncode == 0
        yield found


@pytest.fixture(scope="module")
def url(server: Server) -> Iterator[str]:
    with viewing(server.endpoint) as (found, _):
        yield found


WINDOWS = {
    "wide-dark": (WIDE, "dark"),
    "phone-light": (PHONE, "light"),
    "wide-light": (WIDE, "light"),
    "phone-dark": (PHONE, "dark"),
}
IS_ABOVE_SHEET = """
(() => {
  const {camera, canvas, nodeRefFromName} = window.__viserMutable;
  const outline = nodeRefFromName["/selected/0"]?.matrixWorld;
  if (!outline || !document.body.innerText.includes("Namespace\\nbox_bot2")) return false;
  const seen = camera.position.clone().setFromMatrixPosition(outline).project(camera);
  const sheet = document.querySelector(".mantine-Paper-root[style*='position: fixed']");
  const y = (1 - seen.y) / 2 * canvas.getBoundingClientRect().height;
  return Math.abs(seen.x) < 0.5 && y > 0 && y < 0.8 * sheet.getBoundingClientRect().top;
})()
"""
"""Whether the outline of the robot is in the middle of the picture, above the sheet."""
ONE_THEME = ("wide-dark", "phone-light")
"""A theme changes colours only; the first windows, so that a page stays open for all its tests."""
at_each_size = pytest.mark.parametrize("tab", ONE_THEME, indirect=True)


@pytest.fixture(scope="module", params=WINDOWS)
def tab(request: pytest.FixtureRequest, url: str) -> Iterator[Tab]:
    """Open the page in a window of a size and theme, and select a robot."""
    size, scheme = WINDOWS[request.param]
    with Chromium() as browser:
        found = show(browser, url, size, scheme)
        found.until(SELECT_ROBOT, PATIENCE_S)
        yield found


@pytest.fixture(scope="module")
def phone(url: str) -> Iterator[Tab]:
    """Open the page on a phone with a touch screen."""
    with Chromium() as browser:
        found = show(browser, url, PHONE, "light")
        found.call("Emulation.setTouchEmulationEnabled", enabled=True)
        found.until(SELECT_ROBOT, PATIENCE_S)
        yield found


def find(tab: Tab, script: str) -> list[str]:
    return list(tab.evaluate(f"(() => {{ {FIND} return {script.strip()}; }})()"))


def turn_to(tab: Tab, title: str) -> None:
    tab.click(*tab.until(PLACE_OF_TAB % title, PATIENCE_S))
    tab.until(IS_SELECTED.strip() % title, PATIENCE_S)
    tab.evaluate("new Promise((done) => setTimeout(done, 600))")  # a name is set each 0.25 s


def find_none(tab: Tab, script: str) -> None:
    """Wait until a script finds nothing: transitions and notifications are half transparent."""
    found: list[object] = []

    def is_empty() -> bool:
        found[:] = find(tab, script)
        return not found

    try:
        eventually(is_empty, 20.0, "nothing")
    except AssertionError as failure:
        raise AssertionError(found) from failure


def list_unnamed(tab: Tab) -> list[str]:
    """List the roles of controls without a name, as assistive programs see them."""
    nodes = tab.call("Accessibility.getFullAXTree")["nodes"]
    return [
        node["role"]["value"]
        for node in nodes
        if not node["ignored"]
        and node.get("role", {}).get("value") in CONTROL_ROLES
        and not node.get("name", {}).get("value")
    ]


def touch(tab: Tab, x: float, y: float) -> None:
    tab.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])


def lift(tab: Tab) -> None:
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])


def is_quiet(tab: Tab, commands: Subscription) -> bool:
    """Whether no command comes within a second."""
    commands.take()
    tab.evaluate("new Promise((done) => setTimeout(done, 1000))")
    return commands.take() == []


def tap(tab: Tab, place: str) -> None:
    touch(tab, *tab.until(place, PATIENCE_S))
    lift(tab)


@pytest.mark.parametrize("title", TABS)
def test_every_text_has_contrast(tab: Tab, title: str) -> None:
    turn_to(tab, title)

    find_none(tab, LOW_CONTRASTS)

    assert len(find(tab, CONTRASTS)) > 10


def test_notifications_have_contrast(tab: Tab) -> None:
    """That of rendering in software stays, so that it is seen also on a slow machine."""
    is_readable = f"one[0].startsWith('WebGL is') && one[1] >= {LEAST_CONTRAST}"
    seen = f"{CONTRASTS.strip()}.some((one) => {is_readable})"
    assert tab.evaluate(HIDE_NOTICES.strip() % "false") == 1

    try:
        assert tab.until(f"(() => {{ {FIND} return {seen}; }})()", PATIENCE_S)
    finally:
        tab.evaluate(HIDE_NOTICES.strip() % "true")


@at_each_size
@pytest.mark.parametrize("title", TABS)
def test_no_control_is_covered_or_outside(tab: Tab, title: str) -> None:
    turn_to(tab, title)

    find_none(tab, COVERED)
    find_none(tab, OUTSIDE)


@at_each_size
@pytest.mark.parametrize("title", TABS)
def test_every_control_has_a_name_at_each_size(tab: Tab, title: str) -> None:
    turn_to(tab, title)

    eventually(lambda: not list_unnamed(tab), 20.0, f"names of the controls of {title}")


@at_each_size
@pytest.mark.parametrize("title", TABS)
def test_tab_reaches_every_control(tab: Tab, title: str) -> None:
    turn_to(tab, title)
    tab.evaluate("window.zensimReached = new Set(), document.activeElement.blur()")

    for _ in range(TAB_PRESSES):
        key = {"key": "Tab", "code": "Tab", "windowsVirtualKeyCode": 9}
        tab.call("Input.dispatchKeyEvent", type="rawKeyDown", **key)
        tab.call("Input.dispatchKeyEvent", type="keyUp", **key)
        tab.evaluate("window.zensimReached.add(document.activeElement), 0")

    assert find(tab, UNREACHED) == []


@pytest.mark.parametrize("title", TABS)
def test_targets_are_large_on_a_phone(phone: Tab, title: str) -> None:
    turn_to(phone, title)

    find_none(phone, SMALL % {"px": LEAST_TARGET_PX})


def test_switches_are_smaller_than_their_targets_on_a_phone(phone: Tab) -> None:
    turn_to(phone, "See")

    find_none(phone, WIDE_SWITCHES)


def test_selected_robot_is_in_sight_above_the_sheet(phone: Tab) -> None:
    turn_to(phone, "Entities")
    tap(phone, PLACE_OF_BUTTON % "box_bot2")

    phone.until(IS_ABOVE_SHEET, PATIENCE_S)


def test_a_robot_is_selected_driven_and_stopped_on_a_phone(phone: Tab, server: Server) -> None:
    turn_to(phone, "Entities")
    tap(phone, PLACE_OF_BUTTON % "box_bot2")
    phone.until("document.body.innerText.includes('Namespace\\nbox_bot2')", PATIENCE_S)
    turn_to(phone, "Drive")
    with closing(server.bus.subscribe(CMD_VEL.key("box_bot2"), depth=1000)) as commands:
        touch(phone, *phone.until(PLACE_OF_BUTTON % "Forward", PATIENCE_S))
        eventually(lambda: any(one.linear.x > 0.0 for one in read(commands)), 20.0, "driving")
        lift(phone)
        eventually(lambda: Twist() in read(commands), 20.0, "its release")
        eventually(lambda: is_quiet(phone, commands), 20.0, "the last stop of it")

        tap(phone, PLACE_OF_BUTTON % "Stop all")
        eventually(lambda: Twist() in read(commands), 20.0, "a stop")
