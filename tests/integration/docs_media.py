"""`python -m tests.integration.docs_media` makes the pictures of the page in docs/images anew.

Ten robots drive circles. For the film the world is paused and stepped, so that it looks the same on
slow machines, and the camera moves along the robots and back, so that it has no cut; the panel is
folded away, as the robots are the subject. WebGL runs in software. The picture of a phone shows a
recording of the same run.
"""

import io
import math
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tests.contract.repository import ROOT
from tests.integration.chromium import Chromium, Tab
from tests.integration.page_user import PageUser
from tests.integration.processes import eventually, running, running_up
from zensim.deploy.demo_patterns import RADIUS, SPEED
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.simulation_messages import State, StepSimulationRequest
from zensim.proto.service_catalog import STEP_SIMULATION
from zensim.sim_server.server_config import STEP_HZ
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.page.motion_overlays import TRAIL_PERIOD_S
from zensim.spawner.page.side_panel import format_clock

IMAGES = ROOT / "docs" / "images"
WIDE, PHONE = (1280, 800), (390, 844)
FILM_WINDOW, FILM_SIZE = (960, 600), (720, 450)
FRAMES, FRAME_MS = 40, 100
STEPS_OF_FRAME = round(2.0 * math.pi * RADIUS / SPEED * STEP_HZ / FRAMES)
"""The film lasts a circle of the robots, which then do not jump at its end, at twice the speed."""
FILM_CAMERA = (-0.9, -1.3, 0.8), (1.2, 0.35, 0.0)
"""Position and target of the camera [m] at the first robot."""
FILM_WAY_M = 2.0
"""Along the row of robots."""
FILM_GREYS, FILM_COLOURS = 72, 88
SAMPLED = 50_000
"""Number of pixels that the palette is computed from."""
KMEANS = 2
"""Changes of colours until which they are moved towards their pixels."""
LEAST_CHROMA = 40
"""Difference of the channels of a colourful pixel."""
MOST_BYTES = 3_000_000
ROBOTS = 10
PATIENCE_S = 120.0
WARM_UP_S = 8.0
"""Length of trails, and simulation time before the first picture."""
HAS_ROBOTS = "Object.keys(window.__viserSceneTree.getState()).some(p => p.startsWith('/robots/'))"
HIDE_NOTE = """
const style = document.createElement("style");
style.textContent = ".mantine-Notifications-root { display: none }";
document.head.append(style);
"""
"""The notice of rendering in software."""
IS_STILL = """
(() => {
  const now = window.__viserMutable.camera.matrixWorld.elements.join();
  window.zensimStill = window.zensimCamera === now ? window.zensimStill + 1 : 0;
  window.zensimCamera = now;
  return window.zensimStill >= 20;
})()
"""
"""Whether the camera has not moved while this was asked 20 times."""
HAS_TRAILS = """
(() => {
  const {points} = window.__viserSceneTree.getState()["/trails"].message.props;
  const ends = points instanceof Float32Array ? points : new Float32Array(
    points.buffer.slice(points.byteOffset, points.byteOffset + points.byteLength));
  let drawn = 0;
  for (let i = 0; i < ends.length; i += 6) {
    drawn += Math.hypot(ends[i] - ends[i + 3], ends[i + 1] - ends[i + 4]) > 0.001;
  }
  return drawn >= %d;
})()
"""
"""Whether trails have so many segments."""
DRAWN = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
"""Two frames of the browser: what came before the first is visible."""
LOOK = "window.__viserMutable.cameraControl.setLookAt(%s, false), true"
"""Places the camera; axes of the browser are -y, z, -x of the world."""
FOLD_PANEL = "document.querySelector('[aria-label=\"Collapse panel area\"]').click()"
IS_FOLDED = "window.__viserMutable.canvas.getBoundingClientRect().width > 0.9 * innerWidth"
CLICK_LABEL = "[...document.querySelectorAll('label')].find(l => l.innerText === '%s').click()"


def show(browser: Chromium, url: str, size: tuple[int, int], scheme: str) -> Tab:
    """Open the page in a window of this size, for a system with this theme."""
    tab = browser.tab()
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    tab.call("Emulation.setEmulatedMedia", features=features)
    tab.open(url)
    tab.set_size(*size, is_mobile=size == PHONE)
    tab.until(HAS_ROBOTS, PATIENCE_S)
    tab.until(f"document.documentElement.dataset.mantineColorScheme === '{scheme}'", PATIENCE_S)
    tab.evaluate(HIDE_NOTE)
    tab.until(IS_STILL, PATIENCE_S)
    tab.evaluate(DRAWN)
    return tab


def draw_trails(tab: Tab) -> None:
    """Switch the trails of all robots on, and wait until they are there."""
    tab.turn_to("See")
    tab.until(f"!!({CLICK_LABEL.replace('.click()', '')})" % "Trails", PATIENCE_S)
    tab.evaluate(CLICK_LABEL % "Trails")
    tab.until(HAS_TRAILS % (ROBOTS * WARM_UP_S / TRAIL_PERIOD_S), PATIENCE_S)
    tab.turn_to("Entities")
    tab.until("document.body.innerText.includes('Show all')", PATIENCE_S)
    tab.evaluate(DRAWN)


def save(tab: Tab, name: str) -> None:
    """Save the page as PNG."""
    picture = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    picture.save(IMAGES / f"{name}.png", optimize=True)


def film(tab: Tab, url: str, step: Callable[[], float]) -> None:
    """Save a film, one picture after each step, which returns the simulation time [s].

    Another visitor reads when the page has sent the step, as the panel is folded away.
    """
    tab.set_size(*FILM_WINDOW)
    tab.evaluate(FOLD_PANEL)
    tab.until(IS_FOLDED, PATIENCE_S)
    tab.until(IS_STILL, PATIENCE_S)
    tab.evaluate(LOOK % find_film_camera(0.0))  # from now on the page leaves the camera
    tab.until(IS_STILL, PATIENCE_S)
    pictures = []
    with PageUser(url) as user:
        for number in range(FRAMES):
            shown = format_clock(step())
            tab.evaluate(LOOK % find_film_camera(number / FRAMES))
            eventually(partial(has_text, user, shown), PATIENCE_S, shown)
            tab.evaluate(DRAWN)
            picture = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
            pictures.append(picture.resize(FILM_SIZE, Image.Resampling.LANCZOS))
    palette = make_palette(pictures)
    first, *rest = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures)
    first.save(IMAGES / "page.gif", save_all=True, append_images=rest, duration=FRAME_MS, loop=0)
    size = (IMAGES / "page.gif").stat().st_size
    if size > MOST_BYTES:
        raise RuntimeError(f"page.gif has {size} bytes, more than {MOST_BYTES}")


def has_text(user: PageUser, text: str) -> bool:
    """Whether the page has sent a visitor a text."""
    return text in user.texts()


def find_film_camera(share: float) -> str:
    """Find position and target of the camera at a share of the film, in axes of the browser."""
    moved_m = FILM_WAY_M * (1.0 - math.cos(2.0 * math.pi * share)) / 2.0
    return ", ".join(f"{-y}, {z}, {-(x + moved_m)}" for x, y, z in FILM_CAMERA)


def make_palette(pictures: Sequence[Image.Image]) -> Image.Image:
    """Choose the colours of a film: some for what is colourful, which is small, some for greys."""
    pixels = np.concatenate([np.asarray(one).reshape(-1, 3) for one in pictures[:: FRAMES // 5]])
    is_colourful = np.ptp(pixels.astype(int), axis=1) > LEAST_CHROMA
    chosen = bytearray()
    for count, part in ((FILM_GREYS, ~is_colourful), (FILM_COLOURS, is_colourful)):
        chosen += choose_colours(pixels[part], count)
    palette = Image.new("P", (1, 1))
    palette.putpalette(chosen)
    return palette


def choose_colours(pixels: NDArray[np.uint8], count: int) -> bytes:
    """Choose colours near all pixels (n, 3); a rare colour counts as much as a frequent one."""
    frequent = pixels[:: max(1, len(pixels) // SAMPLED)]
    colours = np.unique(pixels, axis=0)
    rare = np.resize(colours[:: max(1, len(colours) // SAMPLED)], frequent.shape)
    both = Image.fromarray(np.concatenate((frequent, rare))[None])
    found = both.quantize(count, kmeans=KMEANS).getpalette() or []
    return bytes(found[: 3 * count])


def make_media() -> None:
    """Make all pictures: of a world, and on a phone of its recording."""
    with TemporaryDirectory() as folder:
        recording = Path(folder) / "run.mcap"
        options = ("--robots", str(ROBOTS), "--agents", "pooled", "--record", str(recording))
        with running_up(*options, "--port", "0") as (_, announced, bus):
            make_pictures(str(announced["viewer"]), bus)
        with running("view", "--recording", str(recording), "--port", "0") as process:
            assert process.stdout is not None
            url = process.stdout.readline().split()[-1]
            with Chromium() as browser:
                save(show(browser, url, PHONE, "light"), "page_phone")
    for path in sorted(Path(IMAGES).glob("page*")):
        sys.stdout.write(f"{path.name} {path.stat().st_size}\n")


def make_pictures(url: str, bus: Bus) -> None:
    """Make the pictures and the film of a world whose robots drive circles."""
    client = SimClient(bus)
    eventually(lambda: client.info().sim_time_s >= WARM_UP_S, PATIENCE_S, "driving")
    with Chromium() as browser:
        tab = show(browser, url, WIDE, "dark")
        draw_trails(tab)
        save(tab, "page_dark")
        client.set_simulation_state(State.PAUSED)

        def step() -> float:
            order = StepSimulationRequest(steps=STEPS_OF_FRAME)
            bus.call(STEP_SIMULATION, order, world="default", timeout_s=30.0)
            return client.info().sim_time_s

        film(tab, url, step)
        client.set_simulation_state(State.PLAYING)
    with Chromium() as browser:
        tab = show(browser, url, WIDE, "light")
        draw_trails(tab)
        save(tab, "page_light")


if __name__ == "__main__":
    make_media()
