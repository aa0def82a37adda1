"""What a browser draws of the page: the first robot, and frames; WebGL runs in software."""

import time
from collections.abc import Iterator

from benchmarks.figures import Figure
from benchmarks.fleet_server import PATIENCE_S
from tests.integration.chromium import Chromium, Tab

SETTLE_S = 5.0
"""The page chooses its resolution in the first seconds."""
HAS_ROBOT = """
Object.entries(window.__viserMutable.nodeRefFromName).some(([path, node]) => {
  let found = false;
  if (path.startsWith("/robots/")) node.traverse((one) => { found ||= one.instancesCount > 0; });
  return found;
}) && new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))
"""
COUNT_FRAMES = """
new Promise((resolve) => {
  const {scene} = window.__viserMutable, before = scene.onBeforeRender, counts = [];
  let frames = 0;
  scene.onBeforeRender = (gl, ...more) => { before.call(scene, gl, ...more); frames += !more[2]; };
  const timer = setInterval(() => {
    counts.push(frames);
    frames = 0;
    if (counts.length < %d) return;
    clearInterval(timer);
    scene.onBeforeRender = before;
    resolve(counts);
  }, 1000);
})
"""
"""Frames in each of some seconds; those of shadows do not count."""


def measure_drawing(url: str, robots: int, *, is_short: bool) -> Iterator[Figure]:
    """Open a page twice in a new browser, and count frames at 1280x800 while robots drive."""
    what = f"{robots} robots drive, in a browser"
    with Chromium() as browser:
        tab = browser.tab()
        for visit in ("first", "second"):
            opened_s = _time_first_robot(tab, url)
            yield Figure(what=f"{what}: first robot, {visit} visit", unit="s", samples=(opened_s,))
        time.sleep(0.0 if is_short else SETTLE_S)
        frames = tab.evaluate(COUNT_FRAMES % (1 if is_short else 20))
    yield Figure(what=f"{what}: frames a second", unit="", samples=tuple(map(float, frames)))


def _time_first_robot(tab: Tab, url: str) -> float:
    """Open a page by itself; return the time [s] until a frame with a robot was drawn."""
    tab.call("Page.navigate", url="about:blank")
    began = time.perf_counter()
    tab.open(url, "")
    tab.until(HAS_ROBOT, PATIENCE_S)
    return time.perf_counter() - began
