"""The page's own controls in Chromium, without a server: head, list and pad."""

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.integration.chromium import Chromium, Tab
from zensim.spawner.page.page_files import read_page_file

pytestmark = pytest.mark.browser

SIZES = {"wide": (1280, 800), "phone": (390, 844)}
SET_UP = """
document.body.innerHTML = `<dl class="zensim-status" data-state="playing"></dl>
  <div data-zensim-part="head"></div><div data-zensim-part="list" data-empty="Nothing."></div>
  <div data-zensim-part="pad"></div><canvas></canvas>`;
document.head.append(Object.assign(document.createElement("meta"),
  {name: "viewport", content: "width=device-width, initial-scale=1"}));
document.head.append(Object.assign(document.createElement("style"), {textContent: STYLE}));
window.sent = [];
window.__viserMutable = {sendMessage: (message) => window.sent.push(message)};
window.zensimHold = (code, isDown) => window.sent.push([code, isDown]);
window.zensimStop = () => window.sent.push("stop");
window.robots = [...Array(1000).keys()].map((i) => [`r${i}`, 0, "box_bot", "#0072b2"]);
true
"""
BUTTON = "[...document.querySelectorAll('button')].find((one) => one.innerText.trim() === '%s')"
IS_GREY = "getComputedStyle(document.querySelector('canvas')).filter.includes('grayscale')"
PLACE = """
(() => {
  const box = %s.getBoundingClientRect();
  return [box.left + box.width / 2, box.top + box.height / 2];
})()
"""


@pytest.fixture(scope="module", params=SIZES.values(), ids=[*SIZES])
def tab(request: pytest.FixtureRequest) -> Iterator[Tab]:
    with Chromium() as browser:
        found = browser.tab()
        found.set_size(*request.param, is_mobile=request.param == SIZES["phone"])
        found.evaluate(SET_UP.replace("STYLE", json.dumps(read_page_file("page_tools.css"))))
        found.evaluate(
            f"{read_page_file('front_end.js')}; dispatchEvent(new Event('DOMContentLoaded'))"
        )
        found.until("document.querySelectorAll('.zensim-pad button').length === 5")
        yield found


@pytest.fixture
def page(tab: Tab) -> Tab:
    """Return the page with a thousand robots, the first of which moves."""
    tab.evaluate("window.sent = [], zensimMarks([]), zensimEntities(robots), 0")
    tab.evaluate("zensimStatuses('m' + 's'.repeat(999), [30, ...Array(999).fill(0)]), 0")
    search(tab, "")
    return tab


def search(tab: Tab, text: str) -> None:
    tab.evaluate(
        f"(() => {{ const field = document.querySelector('.zensim-search input');"
        f" field.value = {text!r}; field.dispatchEvent(new Event('input')); }})()"
    )


def rows(tab: Tab) -> list[str]:
    """List the names of the rows that exist."""
    names: list[str] = tab.evaluate(
        "[...document.querySelectorAll('.zensim-room button')].map("
        "(one) => one.getAttribute('aria-label'))"
    )
    return names


def press(tab: Tab, text: str) -> None:
    tab.click(*tab.evaluate(PLACE % (BUTTON % text)))


def take_sent(tab: Tab) -> list[Any]:
    return list(tab.evaluate("window.sent.splice(0)"))


def test_only_the_rows_of_a_thousand_that_are_in_view_exist(page: Tab) -> None:
    assert rows(page)[:2] == ["r0 · moving", "r1 · standing"]
    assert len(rows(page)) < 50

    page.evaluate("document.querySelector('.zensim-rows').scrollTop = 1e6, 0")

    page.until("document.querySelector('.zensim-room').innerText.includes('r999')")
    assert len(rows(page)) < 50
    page.evaluate("document.querySelector('.zensim-rows').scrollTop = 0")


def test_row_shows_status_and_speed(page: Tab) -> None:
    shown = page.evaluate("document.querySelectorAll('.zensim-room button')[0].innerText")

    assert shown.split() == ["r0", "0.30", "m/s"]


@pytest.mark.parametrize(
    ("text", "count"), [("", 1000), ("R99", 11), ("box r5", 111), ("moving", 1), ("none such", 0)]
)
def test_search_finds_words_of_name_model_and_status(page: Tab, text: str, count: int) -> None:
    search(page, text)

    assert page.evaluate("document.querySelector('.zensim-count').innerText") == f"{count} of 1000"


def test_search_follows_statuses(page: Tab) -> None:
    search(page, "moving")
    page.evaluate("zensimStatuses('ss' + 'm'.repeat(998), Array(1000).fill(10)), 0")

    assert page.evaluate("document.querySelector('.zensim-count').innerText") == "998 of 1000"


def test_row_selects_and_the_selection_is_marked(page: Tab) -> None:
    page.evaluate("document.querySelectorAll('.zensim-room button')[1].click()")
    assert take_sent(page) == [{"type": "ZensimSelect", "entity": "r1", "is_added": False}]

    page.evaluate("zensimMarks(['r1']), 0")

    pressed = "[...document.querySelectorAll('[aria-pressed=true]')].map((one) => one.innerText)"
    assert [one.split()[0] for one in page.evaluate(pressed)] == ["r1"]


def test_an_empty_world_says_so(page: Tab) -> None:
    page.evaluate("zensimEntities([]), 0")

    assert page.evaluate("document.querySelector('.zensim-count').innerText") == "Nothing."


def test_names_are_text(page: Tab) -> None:
    page.evaluate("zensimEntities([['<img src=x>', 0, '', '']]), zensimStatuses('s', [0]), 0")

    assert page.evaluate("document.querySelectorAll('.zensim-room img').length") == 0
    assert rows(page) == ["<img src=x> · standing"]


def test_head_pauses_what_plays_and_plays_what_is_paused(page: Tab) -> None:
    press(page, "Pause")
    page.evaluate("document.querySelector('.zensim-status').dataset.state = 'paused'")
    page.until(f"!!{BUTTON % 'Play'}")
    press(page, "Play")
    press(page, "Step")
    page.evaluate("document.querySelector('.zensim-status').dataset.state = 'playing'")
    page.until(f"!!{BUTTON % 'Pause'}")

    assert [one["act"] for one in take_sent(page)] == ["Pause", "Play", "Step"]


def test_reset_asks_what_to_reset(page: Tab) -> None:
    press(page, "Reset")
    assert take_sent(page) == []

    press(page, "Poses")

    assert take_sent(page) == [{"type": "ZensimAct", "act": "Reset poses"}]
    assert page.evaluate("document.querySelector('.zensim-menu > [role=menu]').hidden")


def test_a_reset_that_deletes_is_asked_for_twice(page: Tab) -> None:
    press(page, "Reset")
    press(page, "All, delete what was spawned")
    assert take_sent(page) == []

    press(page, "Press again to delete all")

    assert take_sent(page) == [{"type": "ZensimAct", "act": "Reset all"}]


@pytest.mark.parametrize(
    ("name", "code"),
    [("Forward", "KeyW"), ("Turn left", "KeyA"), ("Turn right", "KeyD"), ("Backward", "KeyS")],
)
def test_button_of_the_pad_is_held_as_its_key(page: Tab, name: str, code: str) -> None:
    press(page, name)

    sent = take_sent(page)
    assert sent[0] == [code, True]
    assert sent[-1] == [code, False]


def test_targets_of_fingers_are_large_in_a_phone_of_either_way(page: Tab) -> None:
    before = page.evaluate("[innerWidth, innerHeight]")
    page.set_touch(is_on=True)
    page.set_size(844, 390, is_mobile=True)
    heights = page.until("""(() => {
        const buttons = document.querySelectorAll("[data-zensim-part] button");
        const found = [...buttons].map((one) => one.getBoundingClientRect().height);
        return Math.min(...found.filter((one) => one)) >= 44 && found;
    })()""")
    page.set_touch(is_on=False)
    page.set_size(*before, is_mobile=before[0] < 500)

    assert len(heights) > 8


def test_stop_of_the_pad_stops(page: Tab) -> None:
    press(page, "Stop")

    assert take_sent(page) == ["stop"]


def test_escape_ends_the_wait_for_a_click_on_the_floor(page: Tab) -> None:
    escape = "dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))"
    page.evaluate(escape)
    assert take_sent(page) == []

    page.evaluate(f"zensimPicks('place'), {escape}, zensimPicks('')")

    assert take_sent(page) == [{"type": "ZensimAct", "act": "Give up"}]


def refresh(page: Tab) -> None:
    """Wait until the script has looked at the page."""
    parts = "document.querySelector('[data-zensim-part=list]')"
    page.evaluate(f"{parts}.innerHTML = ''")
    page.until(f"{parts}.firstChild")


def test_a_panel_that_is_made_anew_shows_the_tab_of_before(page: Tab) -> None:
    page.evaluate("""window.makeTabs = (kind, chosen) => {
        document.querySelector(".tabs")?.remove();
        const bar = document.createElement("div");
        bar.className = "tabs";
        for (const name of ["Entities", "See", "Drive"]) {
          const one = Object.assign(document.createElement("button"), {textContent: name});
          if (kind) one.className = kind; else one.dataset.dockTab = "";
          one.ariaSelected = String(name === chosen);
          one.addEventListener("click", () => { window.chosen = name; });
          bar.append(one);
        }
        document.body.append(bar);
    }; makeTabs("", "See")""")
    refresh(page)
    refresh(page)
    page.evaluate("window.chosen = '', makeTabs('mantine-Tabs-tab', 'Entities')")

    page.until("window.chosen === 'See'")
    page.evaluate("document.querySelector('.tabs').remove()")


MUTE = "(message) => console.log(`Tried to send ${message.type} but websocket is not connected!`)"


def test_a_page_without_its_process_says_so_in_grey(page: Tab) -> None:
    page.evaluate(
        f"window.send = __viserMutable.sendMessage, __viserMutable.sendMessage = {MUTE}, 0"
    )

    page.until("document.querySelector('.zensim-status').innerText.includes('no connection')")

    assert page.evaluate("document.querySelector('.zensim-status [role=alert]').innerText")
    assert page.evaluate(IS_GREY)
    page.evaluate("__viserMutable.sendMessage = window.send, 0")
    page.until(f"!{IS_GREY}")
