"""How the page draws in Chromium with WebGL in software, without a server."""

from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any, Final

import pytest

from tests.integration.chromium import PANELS_WITHOUT_WEBGL, Chromium, Tab
from tests.integration.page_drawing import HAS_ROBOTS
from tests.integration.processes import eventually
from tests.spawner.page.builders import make_models_by_name, make_robot, make_snapshot
from zensim.spawner.page.render_state import SimulationStatus, make_fleet, make_frame
from zensim.spawner.page.viewer_page import ViewerPage

pytestmark = pytest.mark.browser

WITHIN_S: Final = 60.0
LOOK: Final = """
(() => {
  const {canvas} = window.__viserMutable;
  return {share: canvas.width / canvas.clientWidth,
    antialias: canvas.getContext("webgl2").getContextAttributes().antialias,
    notices: document.querySelectorAll(".mantine-Notification-root").length};
})()
"""
COUNT_DRAWN: Final = """
(() => {
  const drawn = {}, {nodeRefFromName} = window.__viserMutable;
  for (const [path, node] of Object.entries(nodeRefFromName)) {
    if (!path.startsWith("/robots/")) continue;
    node.traverse((mesh) => {
      if (mesh.getMatrixAt && !mesh._parentLOD) drawn[mesh.geometry.index.count / 3] =
        mesh.LODinfo ? [...mesh.LODinfo.render.count] : [mesh.count];
    });
  }
  return drawn;
})()
"""
"""Instances in view by number of triangles of their part: in detail, as a box, not drawn."""
BE_SLOW: Final = """
(() => {
  const {scene} = window.__viserMutable, before = scene.onBeforeRender;
  scene.onBeforeRender = (gl, ...more) => {
    before.call(scene, gl, ...more);
    for (const ends = performance.now() + 500; performance.now() < ends;);
  };
})()
"""
MANY: Final = 300


class Shown:
    """Robots in a row, 1 m apart, that move on a page in a browser."""

    def __init__(self, page: ViewerPage, tab: Tab, robots: int = 1) -> None:
        self.page, self.tab = page, tab
        self._names = tuple(f"r{number}" for number in range(robots))
        model = make_robot()
        models = make_models_by_name(dict.fromkeys(self._names, model))
        self._fleet = make_fleet(self._names, models)
        self._moved_m = 0.0

    def open(self, query: str) -> None:
        """Open the page and wait for the robot."""
        self.tab.open(f"http://127.0.0.1:{self.page.port}", query)
        self.until(lambda: self.tab.evaluate(f"!!window.__viserMutable && {HAS_ROBOTS}"), "a robot")

    def move(self) -> None:
        """Show the robots somewhat further."""
        self._moved_m += 0.01
        joints = self._fleet.joints
        snapshot = make_snapshot(*self._names, joints=joints, at_x=self._moved_m)
        status = SimulationStatus("playing", robots=len(self._names))
        self.page.show(self._fleet, make_frame(self._fleet, snapshot), status, {})

    def until(self, is_so: Callable[[], object], what: str, *, is_moving: bool = True) -> None:
        """Move the robots, or leave them alone, until something is so."""

        def look() -> bool:
            self.page.wait_for_input(0.02)
            if is_moving:
                self.move()
            return bool(is_so())

        eventually(look, WITHIN_S, what)

    def look(self) -> dict[str, Any]:
        """Return how the scene is drawn."""
        return dict(self.tab.evaluate(LOOK))


@pytest.fixture
def shown(request: pytest.FixtureRequest) -> Iterator[Shown]:
    with closing(ViewerPage("127.0.0.1", 0)) as page, Chromium(PANELS_WITHOUT_WEBGL) as browser:
        yield Shown(page, browser.tab(), getattr(request, "param", 1))


def test_software_draws_coarsely_while_something_moves_and_sharply_at_rest(shown: Shown) -> None:
    shown.open("")

    shown.until(lambda: shown.look()["share"] < 0.9, "a coarse picture")
    shown.until(lambda: shown.look()["share"] > 0.99, "a sharp one", is_moving=False)
    assert not shown.look()["antialias"]


def test_an_address_with_a_resolution_gets_the_whole_picture(shown: Shown) -> None:
    shown.open("?fixedDpr=1")

    shown.tab.evaluate("window.zensimEnd = performance.now() + 3000")
    shown.until(lambda: shown.tab.evaluate("performance.now() > window.zensimEnd"), "3 s of frames")
    assert shown.look()["share"] == pytest.approx(1.0, abs=0.01)
    assert shown.look()["antialias"]


def test_notice_of_software_rendering_closes_by_itself(shown: Shown) -> None:
    shown.open("")

    shown.until(lambda: shown.look()["notices"], "the notice")
    shown.until(lambda: not shown.look()["notices"], "no notice", is_moving=False)


def test_slow_frames_are_no_rest(shown: Shown) -> None:
    shown.open("")
    shown.until(lambda: shown.look()["share"] < 0.9, "a coarse picture")
    shown.until(lambda: shown.look()["share"] > 0.99, "a sharp one", is_moving=False)

    shown.tab.evaluate(BE_SLOW)
    shown.until(lambda: shown.look()["share"] < 0.9, "a coarse picture of slow frames")


@pytest.mark.parametrize("shown", [MANY], indirect=True)
@pytest.mark.parametrize("query", ["", "?fixedDpr=1"], ids=["software", "whole"])
def test_small_parts_of_far_robots_are_not_drawn(shown: Shown, query: str) -> None:
    shown.open(query)

    def count() -> tuple[list[int], list[int]]:
        drawn = shown.tab.evaluate(COUNT_DRAWN)
        return drawn["12"], drawn["128"]  # cubes and wheels

    shown.until(lambda: len(count()[1]) == 3 and count()[1][2] > 0, "wheels that are not drawn")
    (cubes,), (detailed, _, _) = count()
    assert cubes > detailed
