"""What a browser draws of the page."""

from typing import Final

from tests.integration.chromium import Tab

HAS_ROBOTS: Final = """
Object.entries(window.__viserMutable.nodeRefFromName).some(([path, node]) => {
  let found = false;
  if (path.startsWith("/robots/")) node.traverse((one) => { found ||= one.instancesCount > 0; });
  return found;
}) && new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))
"""
"""Whether a frame with a robot was drawn; waits for it once there is one."""
COUNT_FRAMES: Final = """
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


def count_frames(tab: Tab, seconds: int) -> tuple[float, ...]:
    """Count the frames in each of some seconds; those of shadows do not count."""
    return tuple(map(float, tab.evaluate(COUNT_FRAMES % seconds)))
