"""The page in a real browser with a real server, and its access control."""

import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus

from tests.integration.chromium import HEIGHT, WIDTH, Chromium, Tab, open_page
from tests.integration.page_client import connect_page, encode_camera
from tests.integration.processes import (
    END_S,
    Server,
    eventually,
    free_endpoint,
    running,
    serving,
    zensim,
)
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.network_protocols import Subscription
from zensim.proto.topic_catalog import CMD_VEL, SNAPSHOT

if TYPE_CHECKING:
    import subprocess

ROBOTS = 10
REACH_PX = 8
LEAST_CHROMA = 60
"""Difference of the channels of a pixel."""
LOOKS_AT = "window.__viserMutable.cameraControl.getTarget().toArray()"
"""In browser axes: -y, z, -x of the world."""
NODES = "Object.keys(window.__viserSceneTree.getState())"
BATCHES = """
Object.entries(window.__viserSceneTree.getState())
  .filter(([path, node]) => node.message.props.batched_positions)
  .map(([path, node]) => [path, node.message.props.batched_positions.length / 3])
"""
CAMERA = """
(() => {
  const {camera, cameraControl} = window.__viserMutable;
  return [...camera.position.toArray(), ...cameraControl.getTarget(camera.position.clone())];
})()
"""
SCALE = """
(() => {
  const {camera, cameraControl, canvas} = window.__viserMutable;
  const bar = document.getElementById("zensim-scale"), target = cameraControl.getTarget(
    camera.position.clone());
  const box = canvas.getBoundingClientRect();
  const right = camera.position.clone().setFromMatrixColumn(camera.matrixWorld, 0);
  const ends = [target.clone(), target.clone().add(right)].map((end) => end.project(camera).x);
  const [number, unit] = bar.textContent.split(" ");
  return [Number(number) * {cm: 0.01, m: 1, km: 1000}[unit],
    bar.getBoundingClientRect().width / ((ends[1] - ends[0]) / 2 * box.width)];
})()
"""
"""Length that the scale says, and that it has at the target of the camera [m]."""
COLOURS = """
Object.values(window.__viserSceneTree.getState())
  .map(node => [...(node.message.props.batched_colors || [])]).filter(one => one.length > 3)
"""
PLACE = """
(() => {
  const page = window.__viserMutable, box = page.canvas.getBoundingClientRect();
  const [path, node] = Object.entries(window.__viserSceneTree.getState())
    .find(([path, node]) => node.message.props.batched_positions);
  const seen = page.camera.position.clone()
    .fromArray(node.message.props.batched_positions, 3 * %d)
    .applyMatrix4(page.nodeRefFromName[path].matrixWorld).project(page.camera);
  return [box.left + (seen.x + 1) / 2 * box.width, box.top + (1 - seen.y) / 2 * box.height];
})()
"""
"""Screen position of the robot with this number."""

VIEW = """
(() => {
  const {camera, cameraControl, canvas, nodeRefFromName} = window.__viserMutable;
  const [path, node] = Object.entries(window.__viserSceneTree.getState())
    .find(([path, node]) => node.message.props.batched_positions);
  const at = camera.position.clone().fromArray(node.message.props.batched_positions, 3 * %(robot)d)
    .applyMatrix4(nodeRefFromName[path].matrixWorld);
  const ends = [-0.06, 0.05].flatMap((y) => [-0.06, 0.06].flatMap((x) => [-0.05, 0.05].map(
    (z) => at.clone().add({x, y, z}).project(camera).y)));
  const height = (Math.max(...ends) - Math.min(...ends)) / 2 * canvas.clientHeight;
  const far = cameraControl.getTarget(camera.position.clone()).distanceTo(at) > 0.01
    ? 5 : cameraControl.distance * height / %(px)d;
  const [side, up] = [far * Math.cos(0.6), far * Math.sin(0.6)];
  cameraControl.setLookAt(at.x + side * Math.cos(%(angle)f), at.y + up,
    at.z + side * Math.sin(%(angle)f), at.x, at.y, at.z, false);
  return height;
})()
"""
"""Looks at a robot from where it is so many pixels high; returns the height before."""
IS_LIGHT = """(() => {
  const ground = window.__viserSceneTree.getState()["/ground"];
  return document.documentElement.getAttribute("data-mantine-color-scheme") === "light" &&
    !!ground && ground.message.props.plane_color[0] > 128;
})()"""
CLICKED_PX = 15
SELECT = """
(window.zensimAskedAt > performance.now() - 3000 || (window.zensimAskedAt = performance.now(),
  window.__viserMutable.sendMessage({type: "ZensimSelect", entity: "%s"})),
  document.body.innerText.includes("%s"))
"""
"""Selects an entity, and says whether a text is there; asks again rarely, as it has an effect."""
SELECT_BOX_BOT1 = SELECT % ("box_bot1", "box_bot1: driven by")
VISIBLE = "[...document.querySelectorAll('%s')].find(one => one.checkVisibility())"
WITHIN = """
new Promise((resolve) => {
  const end = performance.now() + %d;
  const look = () => {
    const found = (%s);
    if (found || performance.now() > end) resolve(found); else setTimeout(look, 50);
  };
  look();
})
"""
"""Whether an expression becomes true within a time [ms]."""
CLICK_MS = 5000


@dataclass(frozen=True)
class Shown:
    """A page in a browser, and its server."""

    server: Server
    url: str
    tab: Tab


@contextmanager
def viewing(endpoint: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    with running("view", "--connect", endpoint, "--port", "0") as process:
        assert process.stdout is not None
        word, url = process.stdout.readline().split()
        assert word == "viewer"
        yield url, process


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as found:
        assert found.zensim("fleet", "box_bot", "--robots", str(ROBOTS)).returncode == 0
        yield found


@pytest.fixture(scope="module")
def shown(server: Server) -> Iterator[Shown]:
    with viewing(server.endpoint) as (url, _), open_page(url) as tab:
        tab.until(f"{BATCHES}.length > 0")
        yield Shown(server, url, tab)


def is_coloured(picture: np.ndarray, place: list[float]) -> bool:
    """Whether something colourful, as the ground is not, is drawn around a place."""
    x, y = (round(value) for value in place)
    around = picture[max(y - REACH_PX, 0) : y + REACH_PX, max(x - REACH_PX, 0) : x + REACH_PX]
    return bool(np.ptp(around.astype(int), axis=2).max(initial=0) > LEAST_CHROMA)


def text_of(tab: Tab) -> str:
    return str(tab.evaluate("document.body.innerText"))


@pytest.mark.browser
@pytest.mark.smoke
def test_page_shows_every_robot_in_its_colours(shown: Shown) -> None:
    def are_drawn() -> bool:
        picture = shown.tab.pixels()
        places = [shown.tab.evaluate(PLACE % number) for number in range(ROBOTS)]
        return all(is_coloured(picture, place) for place in places)

    eventually(are_drawn, 20.0, "ten coloured robots")
    colours = shown.tab.evaluate(COLOURS)
    assert [len(set(map(tuple, np.reshape(one, (-1, 3)).tolist()))) for one in colours] == [7]
    assert shown.tab.evaluate("document.title") == "zensim"


@pytest.mark.browser
def test_page_has_one_batch_for_each_kind_of_link_and_colour(shown: Shown) -> None:
    batches = shown.tab.evaluate(BATCHES)

    assert {count for _, count in batches} == {ROBOTS}
    assert len(batches) < ROBOTS


@pytest.mark.browser
def test_page_requests_only_from_its_server(shown: Shown) -> None:
    loaded = shown.tab.evaluate("performance.getEntriesByType('resource').map(r => r.name)")

    assert shown.tab.complaints == []
    assert [url for url in loaded if not url.startswith((shown.url, "blob:", "data:"))] == []


@pytest.mark.browser
def test_page_has_every_robot_in_view(shown: Shown) -> None:
    def are_in_view() -> bool:
        places = [shown.tab.evaluate(PLACE % number) for number in range(ROBOTS)]
        width = max(x for x, _ in places) - min(x for x, _ in places)
        return width > WIDTH / 4.0 and all(0.0 < x < WIDTH and 0.0 < y < HEIGHT for x, y in places)

    eventually(are_in_view, 20.0, "all robots in a wide view")


@pytest.mark.browser
def test_page_shows_state_and_number_of_robots(shown: Shown) -> None:
    shown.tab.until("document.body.innerText.includes('playing')")

    assert f"Robots\n{ROBOTS}" in text_of(shown.tab)


@pytest.mark.browser
def test_tabs_keep_their_places_when_another_is_shown(shown: Shown) -> None:
    places = "[...document.querySelectorAll('[role=tab]')].map((one) => one.offsetLeft)"
    before = shown.tab.evaluate(places)

    shown.tab.turn_to("Plots")
    shown.tab.until(
        "document.querySelector('[role=tab][title=Plots][aria-selected=true]') !== null"
    )

    assert shown.tab.evaluate(places) == before
    shown.tab.turn_to("Entities")


FOLD = "[...document.querySelectorAll('.zensim-fold')].find((one) => one.innerText === '%s')"
LINKS = FOLD % "Links and sensors"


@pytest.mark.browser
def test_an_opened_folder_stays_open_with_the_next_selection(shown: Shown) -> None:
    shown.tab.until(f"{SELECT % ('box_bot1', 'Stop following')} && !!{LINKS}")
    shown.tab.evaluate(f"(window.opened = {LINKS}).click()")

    shown.tab.until(f"{SELECT % ('box_bot2', 'Stop following')} && !!{FOLD % 'box_bot2'}")

    shown.tab.until(f"{LINKS} !== window.opened")
    shown.tab.until(f"{LINKS}.getAttribute('aria-expanded') === 'true'")
    shown.tab.evaluate(f"{LINKS}.click()")


@pytest.mark.browser
def test_name_appears_when_the_pointer_is_over_a_robot(shown: Shown) -> None:
    tip = "document.getElementById('zensim-name')"
    name = f"{tip}.style.display === 'block' && {tip}.textContent"

    def is_named() -> bool:
        """Point at a robot; the camera may still move."""
        shown.tab.point(*shown.tab.evaluate(PLACE % 2))
        return bool(shown.tab.evaluate(name) == "box_bot2")

    eventually(is_named, 20.0, "a name")
    shown.tab.point(WIDTH / 2.0, 30.0)
    shown.tab.until(f"{tip}.style.display === 'none'")


def click_robot(tab: Tab, number: int) -> None:
    """Click a robot until it is selected; the camera may still move."""
    is_selected = f"document.body.innerText.includes('Namespace\\nbox_bot{number}\\n')"

    def click() -> bool:
        tab.click(*tab.evaluate(PLACE % number))
        return bool(tab.evaluate(WITHIN % (CLICK_MS, is_selected)))

    eventually(click, 60.0, f"selecting box_bot{number}")


@pytest.mark.browser
@pytest.mark.smoke
def test_camera_follows_a_robot_when_it_is_clicked(shown: Shown) -> None:
    tab, bus = shown.tab, shown.server.bus
    cmd_vel = bus.advertise(CMD_VEL.key("box_bot1"), make_encoding(Twist, Format.CDR))

    click_robot(tab, 1)
    eventually(lambda: cmd_vel.is_matched, 5.0, "listening to its commands")
    cmd_vel.send(encode(Twist(Vector3(x=0.2), Vector3(z=-0.5)), Format.CDR))
    tab.until("document.body.innerText.includes('v 0.20 m/s  w -0.50 rad/s')")
    tab.until(f"{LOOKS_AT}.every((v, i) => Math.abs(v - [0, 0.06, -1][i]) < 0.05)")

    tab.press("Stop following")
    tab.until("!document.body.innerText.includes('Stop following')")
    eventually(lambda: not cmd_vel.is_matched, 5.0, "listening no more")


@pytest.mark.browser
def test_clicks_hit_robots_that_are_15_pixels_high(shown: Shown) -> None:
    tab = shown.tab
    for number in range(ROBOTS):
        wanted = {"robot": number, "px": CLICKED_PX, "angle": 0.3 * number}

        def is_small(wanted: dict[str, float] = wanted) -> bool:
            height = tab.evaluate(VIEW % wanted)
            tab.evaluate("new Promise(done => requestAnimationFrame(() => done(0)))")
            return abs(float(height) - CLICKED_PX) < 0.2

        eventually(is_small, 30.0, "a robot 15 pixels high")
        tab.click(*tab.evaluate(PLACE % number))
        tab.until(f"document.body.innerText.includes('Namespace\\nbox_bot{number}\\n')", 60.0)
        tab.press("Stop following")
        tab.until("!document.body.innerText.includes('Stop following')")
    tab.press("Show all")


@pytest.mark.browser
def test_space_stops_the_robot_also_while_a_tab_or_checkbox_has_the_focus(shown: Shown) -> None:
    tab = shown.tab
    key, space = {"code": "KeyW", "key": "w"}, {"code": "Space", "key": " "}
    tab.turn_to("Drive")
    tab.until(SELECT_BOX_BOT1)
    tab.turn_to("See")
    with closing(shown.server.bus.subscribe(CMD_VEL.key("box_bot1"), depth=1000)) as commands:
        for focused in ("[role=tab][aria-selected=true]", "input[type=checkbox]"):
            tab.evaluate(f"({VISIBLE % focused}).focus()")
            tab.call("Input.dispatchKeyEvent", type="rawKeyDown", **key)
            eventually(lambda: any(one.linear.x > 0.0 for one in read(commands)), 5.0, focused)

            tab.call("Input.dispatchKeyEvent", type="keyDown", text=" ", **space)
            eventually(lambda: Twist() in read(commands), 5.0, "a stop")
            tab.call("Input.dispatchKeyEvent", type="keyUp", **space)
            tab.call("Input.dispatchKeyEvent", type="keyUp", **key)
    assert tab.evaluate(f"({VISIBLE % 'input[type=checkbox]'}).checked")  # Names, as before
    tab.turn_to("Entities")
    tab.press("Stop following")


def read(commands: Subscription) -> list[Twist]:
    return [decode_twist(one.payload, one.encoding) for one in commands.take()]


@pytest.mark.browser
def test_scale_is_as_long_as_it_says(shown: Shown) -> None:
    shown.tab.until("document.getElementById('zensim-scale').textContent")

    def is_true() -> bool:
        shown_m, seen_m = shown.tab.evaluate(SCALE)
        return bool(seen_m == pytest.approx(shown_m, rel=0.03))

    # The scale follows a camera that moves with the next picture.
    eventually(is_true, 30.0, "a scale as long as it says")


@pytest.mark.browser
def test_link_gives_the_same_camera_robot_and_theme_in_another_browser(shown: Shown) -> None:
    tab, client = shown.tab, shown.server.client
    client.set_simulation_state(State.PAUSED)
    tab.until("document.getElementById('zensim-tools').innerText.includes('Dark')")
    tab.press("Dark")
    tab.until("document.getElementById('zensim-tools').innerText.includes('Light')")
    click_robot(tab, 1)
    eventually(lambda: is_still(tab), 30.0, "a camera that has followed")
    tab.press("Link")
    before, link = tab.evaluate(CAMERA), tab.evaluate("location.href")

    with Chromium() as browser:
        other = browser.tab()
        other.set_size(WIDTH, HEIGHT)
        other.call("Page.navigate", url=link)
        other.until("document.body.innerText.includes('Namespace\\nbox_bot1')", 120.0)
        eventually(lambda: is_still(other), 30.0, "a camera that has arrived")

        assert other.evaluate(CAMERA) == pytest.approx(before, abs=0.01)
        other.until("document.documentElement.dataset.mantineColorScheme === 'dark'")
    tab.press("Stop following")
    client.set_simulation_state(State.PLAYING)


def is_still(tab: Tab) -> bool:
    """Whether the camera does not move for a moment."""
    before = tab.evaluate(CAMERA)
    tab.evaluate("new Promise(done => setTimeout(done, 1000))")
    return bool(np.allclose(tab.evaluate(CAMERA), before, atol=1e-4))


@pytest.mark.browser
def test_page_recovers_when_the_server_is_replaced() -> None:
    with serving() as first:
        endpoint = first.endpoint
        first.zensim("spawn", "box_bot")
        with viewing(endpoint) as (url, _), open_page(url) as tab:
            tab.until("document.body.innerText.includes('playing')")
            first.process.send_signal(signal.SIGTERM)
            first.process.wait(END_S)
            tab.until("document.body.innerText.includes('no server')")

            with running("serve", "--listen", endpoint):
                fleet = ("fleet", "box_bot", "--robots", "3", "--wait", "20")
                assert zensim(*fleet, "--connect", endpoint).returncode == 0
                tab.until("document.body.innerText.includes('Robots\\n3')")
                tab.until(f"{BATCHES}.every(([path, count]) => count === 3)")


@pytest.mark.browser
def test_page_says_that_its_process_has_ended_and_is_as_before_with_the_next(
    server: Server,
) -> None:
    port = free_endpoint().rpartition(":")[2]
    options = ("view", "--connect", server.endpoint, "--port", port)
    with Chromium() as browser:
        tab = browser.tab()
        light = {"name": "prefers-color-scheme", "value": "light"}
        tab.call("Emulation.setEmulatedMedia", features=[light])
        with running(*options) as process:
            assert process.stdout is not None
            tab.open(process.stdout.readline().split()[1])
            tab.until(SELECT % ("box_bot1", "Stop following"))
            tab.until(IS_LIGHT)

        tab.until("document.body.innerText.includes('no connection')")
        assert "playing" not in text_of(tab)
        with running(*options):
            tab.until("document.body.innerText.includes('playing')")
            tab.evaluate("new Promise(done => setTimeout(done, 1000))")
            tab.until(IS_LIGHT)
            assert tab.evaluate("document.querySelectorAll('[aria-pressed=true]').length") == 0


def test_snapshots_are_requested_only_while_a_page_is_open() -> None:
    with serving() as server, viewing(server.endpoint) as (url, _):
        snapshot = server.bus.advertise(SNAPSHOT.key("default"), Format.MSGPACK.value)
        assert not snapshot.is_matched

        with connect_page(url) as page:
            page.send(encode_camera())
            eventually(lambda: snapshot.is_matched, 5.0, "asking")

        eventually(lambda: not snapshot.is_matched, 5.0, "asking no more")


def test_page_of_another_site_is_refused(server: Server) -> None:
    with viewing(server.endpoint) as (url, _):
        with pytest.raises(InvalidStatus, match="403"):
            connect_page(url, "http://evil.example")

        connect_page(url).close()


def test_view_fails_in_one_line_when_its_port_is_taken(server: Server) -> None:
    with viewing(server.endpoint) as (url, _):
        port = url.rsplit(":", 1)[1]

        done = server.zensim("view", "--port", port)

        assert done.returncode == 1
        assert done.stdout == ""
        assert done.stderr.count("\n") == 1
        assert f"port {port}" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_view_with_a_client_exits_when_terminated(server: Server, number: signal.Signals) -> None:
    with viewing(server.endpoint) as (url, process):
        with connect_page(url) as page:
            page.send(encode_camera())
            page.recv(timeout=5.0)
            process.send_signal(number)

            assert process.wait(END_S) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""
