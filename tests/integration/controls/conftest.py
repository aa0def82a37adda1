"""The page that the tests of a file share."""

from collections.abc import Iterator

import pytest

from tests.integration.chromium import PANELS_WITHOUT_WEBGL, Chromium
from tests.integration.controls.opened_page import ROBOTS, Page, list_spawns, open_page
from tests.integration.docs_media import PHONE, WIDE
from tests.integration.page_controls import PageControls
from tests.integration.processes import serving
from tests.integration.test_view import viewing
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import SpawnEntitiesOrder

SIZES = {"wide": WIDE, "phone": PHONE}


def pytest_itemcollected(item: pytest.Item) -> None:
    """Leave the phone out of what CI runs for each push."""
    if "phone" in item.name:
        item.own_markers = [mark for mark in item.own_markers if mark.name != "smoke"]


@pytest.fixture(scope="module", params=[*SIZES.values()], ids=[*SIZES])
def opened(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Page]:
    """Open the page of four robots and a wall once for all tests."""
    folder = tmp_path_factory.mktemp("downloads")
    with serving() as server:
        server.client.spawn_all(SpawnEntitiesOrder((*list_spawns(),)))
        with viewing(server.endpoint) as (url, _), Chromium(PANELS_WITHOUT_WEBGL) as browser:
            tab = open_page(browser, url, folder, request.param)
            tab.until("document.body.innerText.includes('playing')", 120.0)
            yield Page(server, url, tab, PageControls(tab), folder, request.param)


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
