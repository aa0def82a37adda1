"""Tools beside the tabs, the page of a recording, and the list of all controls."""

import importlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.deploy.recorded_worlds import write_world
from tests.integration.chromium import PANELS_WITHOUT_WEBGL, Chromium
from tests.integration.controls.opened_page import (
    CHARTS,
    MORE,
    NUMBER_OF_CHARTS,
    PALETTE_ENTRIES,
    PAUSE,
    SENSOR,
    TABS,
    USED,
    WITHIN_S,
    Page,
    a_button,
    a_checkbox,
    a_choice,
    a_command,
    a_field,
    a_key,
    normalize,
    open_page,
    uses,
)
from tests.integration.docs_media import WIDE
from tests.integration.page_controls import Control, PageControls
from tests.integration.processes import eventually, running
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Imu

pytestmark = pytest.mark.browser

# Beside the tabs: the simulation, and tools.


RESETS = ("Time and poses", "Poses", "Time", "All, delete what was spawned")


@uses(a_button("", "Pause"), a_button("", "Step"), a_button("", "Reset"), a_button("", "Play"))
@uses(Control("", "menuitem", RESETS[0]))
@pytest.mark.smoke
def test_buttons_of_the_simulation(page: Page) -> None:
    page.controls.click(a_button("", "Pause"))
    before = page.until_info(lambda info: info.state == "paused", "a pause")
    page.controls.click(a_button("", "Step"))
    page.until_info(lambda info: info.steps == before.steps + 1, "a step")
    page.controls.click(a_button("", "Reset"))
    page.controls.click(Control("", "menuitem", RESETS[0]))
    page.until_info(lambda info: info.epoch == before.epoch + 1, "a reset")
    page.controls.click(a_button("", "Play"))
    page.until_info(lambda info: info.state == "playing", "playing")


@uses(*(Control("", "menuitem", name) for name in RESETS[1:3]))
def test_poses_or_time_alone_are_reset(page: Page) -> None:
    for name in RESETS[1:3]:
        before = page.server.client.info().epoch
        page.controls.click(a_button("", "Reset"))
        page.controls.click(Control("", "menuitem", name))
        page.until_info(lambda info, before=before: info.epoch == before + 1, name)  # type: ignore[misc]


@uses(Control("", "menuitem", RESETS[3]))
def test_menu_of_resets_is_left_by_its_keys(page: Page) -> None:
    page.controls.click(a_button("", "Reset"))
    for _ in range(3):
        page.controls.press_key("ArrowDown")
    page.controls.until(f"document.activeElement.innerText === '{RESETS[3]}'")
    page.controls.used.add(Control("", "menuitem", RESETS[3]))  # it would delete the robots
    page.controls.press_key("Escape")
    page.controls.until("document.querySelector('.zensim-menu > [role=menu]').hidden")


@uses(*(Control("", "tab", title) for title in TABS))
@pytest.mark.smoke
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
    page.controls.until_text("turn the camera")
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
    page.tab.evaluate("window.zensimDraws = true")
    page.controls.click(a_button("", PICTURE))
    assert page.until_file("*.png").read_bytes().startswith(b"\x89PNG")

    page.controls.click(a_button("", FILM))
    page.controls.until("document.getElementById('zensim-tools').innerText.includes('Stop')")
    page.controls.click(a_button("", FILM))
    assert page.until_file("*.webm").read_bytes().startswith(b"\x1a\x45\xdf\xa3")
    page.tab.evaluate("window.zensimDraws = false")


SCHEME = "document.documentElement.dataset.mantineColorScheme"
IS_GROUND_OF_THEME = (
    "(window.__viserSceneTree.getState()['/ground'].message.props.plane_color[0] > 128)"
    f" === ({SCHEME} === 'light')"
)


@uses(a_button("", "Switch between light and dark"))
def test_theme_of_page_and_ground_is_switched(page: Page) -> None:
    page.controls.until(IS_GROUND_OF_THEME)
    for _ in range(2):
        before = page.tab.evaluate(SCHEME)
        page.controls.click(a_button("", "Switch between light and dark"))
        page.controls.until(f"{SCHEME} !== '{before}'")
        page.controls.until(IS_GROUND_OF_THEME)


@uses(a_button("", "Settings"), a_button("", "Collapse panel area"))
def test_panel_shows_settings_and_is_collapsed(page: Page) -> None:
    shows_all = a_button("Entities", "Show all")
    page.controls.turn_to("Entities")
    page.controls.click(a_button("", "Settings"))
    page.controls.click(a_button("", "Back to the controls"))
    page.controls.until_there(shows_all)

    page.controls.click(a_button("", "Collapse panel area"))
    eventually(lambda: page.controls.find(shows_all) is None, WITHIN_S, "a panel out of the way")
    area = "column" if page.size == WIDE else "panel area"
    page.controls.click(a_button("", f"Expand {area}"))
    page.controls.until_there(shows_all)


# The page of a recording.


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageControls]:
    """Open the page of a recording of ten seconds."""
    folder = tmp_path_factory.mktemp("recording")
    path = write_world(folder / "run.mcap")
    with running("view", "--recording", str(path), "--port", "0", "--loop") as process:
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1]
        with Chromium(PANELS_WITHOUT_WEBGL) as browser:
            yield PageControls(open_page(browser, url, folder, WIDE))


POSITION = Control("Recording", "slider", "Position [s]")
POSITION_FIELD, RATE = a_field("Recording", "Position [s]"), a_choice("Recording", "Rate")
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

HELP_ENTRIES = """
[...document.querySelectorAll("#zensim-help h3")].filter((one) => one.innerText !== "What is drawn")
  .flatMap((one) => [...one.nextElementSibling.querySelectorAll("dt")].map((two) => two.innerText))
"""


def test_every_control_is_used_by_a_test(page: Page) -> None:
    controls = page.controls
    page.select("r3")
    listed = controls.list_of_tabs("Entities", "See")
    page.select("r2")
    controls.choose(SENSOR, "imu")
    with page.publishing(keys.robot("r2", "imu"), Imu) as publisher:
        for title in CHARTS:
            controls.click(a_checkbox("Plots", title))

        def are_drawn() -> bool:
            publisher.send(encode(Imu(), Format.CDR))
            return bool(page.tab.evaluate(f"{NUMBER_OF_CHARTS} === {len(CHARTS) + 1}"))

        eventually(are_drawn, WITHIN_S, "all charts")
    controls.click(MORE)
    controls.until_there(a_field("Edit", "Name"))
    listed |= controls.list_of_tabs(*TABS)
    controls.click(MORE)
    listed |= list_of_dialogs(page)
    controls.click(a_button("", "Pause"))
    controls.until_there(a_button("", "Play"))  # in its place
    listed.add(a_button("", "Play"))
    controls.click(a_button("", "Play"))

    found = {normalize(one) for one in listed}
    used = list_used()
    assert found - used == set()
    assert used - found == set()


def list_used() -> set[Control]:
    """List the controls that the tests of this folder name, also those of other workers."""
    for path in Path(__file__).parent.glob("test_*.py"):
        importlib.import_module(f"{__package__}.{path.stem}")
    return USED


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
    is_open = "!document.querySelector('.zensim-menu > [role=menu]').hidden"
    list_with(lambda: controls.click(a_button("", "Reset")), is_open)
    controls.press_key("Escape")
    list_with(lambda: controls.click(a_button("", HELP)), IS_HELP_OPEN)
    listed |= {a_key(entry) for entry in page.tab.evaluate(HELP_ENTRIES)}
    controls.press_key("Escape")
    controls.press_key("k", modifiers=2)
    commands = controls.until(f"({PALETTE_ENTRIES.strip()}).length && {PALETTE_ENTRIES.strip()}")
    listed |= {a_command(label) for label in commands}
    controls.press_key("Escape")
    return listed


HAS_NOTICE = "document.body.innerText.includes('nothing is being deleted')"
