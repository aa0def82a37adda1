"""The tabs Entities and See in Chromium."""

import pytest

from tests.integration.controls.opened_page import (
    USED,
    WITHIN_S,
    Page,
    a_button,
    a_checkbox,
    a_choice,
    a_field,
    normalize,
    uses,
)
from tests.integration.page_controls import Control
from tests.integration.processes import eventually
from tests.integration.test_page_sensors import POINTS_OF
from tests.integration.test_view import CAMERA, CLICK_MS, WITHIN
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.standard_messages import Image, LaserScan, Twist, Vector3
from zensim.proto.topic_catalog import CMD_VEL, CONTACTS, SCAN

pytestmark = pytest.mark.browser

# The tab "Entities".

SEARCH = a_field("Entities", "Search")


@uses(SEARCH)
@pytest.mark.smoke
def test_search_narrows_the_list(page: Page) -> None:
    page.controls.write(SEARCH, "r2")
    page.controls.until_text("1 of 5")
    page.controls.write(SEARCH, "no agent")
    page.controls.until_text("4 of 5")
    page.controls.write(SEARCH, "")
    page.controls.until_text("5 of 5")


@uses(
    a_button("Entities", "r1 · no agent"),
    a_button("Entities", "Stop following"),
    a_button("Entities", "Show all"),
)
@pytest.mark.smoke
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
    ("Entities", "r2", a_button("Entities", "Stop following")),
    ("Edit", "Spawn", a_button("Edit", "Place by click")),
    ("Edit", "Selected entity", a_button("Edit", "Undo")),
)


@pytest.mark.parametrize(("tab", "name", "inner"), FOLDERS)
def test_folder_is_closed_and_opened(page: Page, tab: str, name: str, inner: Control) -> None:
    page.select("r2")
    page.controls.turn_to(tab)
    page.controls.click(a_button(tab, name))
    eventually(lambda: page.controls.find(inner) is None, WITHIN_S, "a fold")
    page.controls.click(a_button(tab, name))
    page.controls.until_there(inner)


@uses(a_button("Entities", "Links and sensors"))
def test_links_and_sensors_are_listed(page: Page) -> None:
    page.select("r2")

    def opens() -> bool:
        """Click the folder; it is made anew, closed, when more of the robot is known."""
        page.controls.click(a_button("Entities", "Links and sensors"))
        is_open = "document.body.innerText.includes('lidar: scan')"
        return bool(page.tab.evaluate(WITHIN % (CLICK_MS, is_open)))

    eventually(opens, WITHIN_S, "a list")


USED |= {normalize(a_button(tab, name)) for tab, name, _ in FOLDERS}


# The tab "See".

OVERLAYS = {
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


@uses(a_checkbox("See", "Names"))
def test_names_are_there_until_they_are_switched_off(page: Page) -> None:
    page.until_node("/names/r1")
    page.controls.click(a_checkbox("See", "Names"))
    page.until_no_node("/names/r1")
    page.controls.click(a_checkbox("See", "Names"))
    page.until_node("/names/r1")


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
    page.click_scene_until(lambda: page.has_node("/measure/distance"), "a distance", 0.3)
    page.controls.click(a_checkbox("See", "Measure"))
    page.until_no_node("/measure/")
