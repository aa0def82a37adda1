"""The page in a real browser with a real server, and its access control."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus

from tests.integration.chromium import HEIGHT, WIDTH, Tab, open_page
from tests.integration.page_client import connect_page, encode_camera
from tests.integration.processes import END_S, Server, eventually, running, serving, zensim
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.topic_catalog import CMD_VEL, SNAPSHOT

if TYPE_CHECKING:
    import subprocess

ROBOTS = 10
LEAST_AREA_PX = 20
LOOKS_AT = "window.__viserMutable.cameraControl.getTarget().toArray()"
"""In browser axes: -y, z, -x of the world."""
NODES = "Object.keys(window.__viserSceneTree.getState())"
BATCHES = """
Object.entries(window.__viserSceneTree.getState())
  .filter(([path, node]) => node.message.props.batched_positions)
  .map(([path, node]) => [path, node.message.props.batched_positions.length / 3])
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


def blue_robots(picture: np.ndarray) -> int:
    """Count connected blue areas; ignores slivers behind wheels."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    rest = set(map(tuple, np.argwhere((blue > red + 45) & (blue > green + 25)).tolist()))
    sizes = []
    while rest:
        edge, area = [rest.pop()], 0
        while edge:
            y, x = edge.pop()
            near = {(y + i, x + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} & rest
            rest -= near
            edge += near
            area += 1
        sizes.append(area)
    return sum(area >= LEAST_AREA_PX for area in sizes)


def text_of(tab: Tab) -> str:
    return str(tab.evaluate("document.body.innerText"))


@pytest.mark.browser
def test_page_shows_every_robot_in_its_colours(shown: Shown) -> None:
    eventually(lambda: blue_robots(shown.tab.pixels()) == ROBOTS, 20.0, "ten blue robots")

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
    places = [shown.tab.evaluate(PLACE % number) for number in range(ROBOTS)]

    assert all(0.0 < x < WIDTH and 0.0 < y < HEIGHT for x, y in places)
    assert max(x for x, _ in places) - min(x for x, _ in places) > WIDTH / 4.0


@pytest.mark.browser
def test_page_shows_state_and_number_of_robots(shown: Shown) -> None:
    shown.tab.until("document.body.innerText.includes('playing')")

    assert f"Robots\n{ROBOTS}" in text_of(shown.tab)


@pytest.mark.browser
def test_name_appears_when_the_pointer_is_over_a_robot(shown: Shown) -> None:
    name = "document.getElementById('zensim-name')"
    x, y = shown.tab.evaluate(PLACE % 2)

    shown.tab.point(x, y)
    shown.tab.until(f"{name}.style.display === 'block'")

    assert shown.tab.evaluate(f"{name}.textContent") == "box_bot2"
    shown.tab.point(x, 30.0)
    shown.tab.until(f"{name}.style.display === 'none'")


@pytest.mark.browser
def test_camera_follows_a_robot_when_it_is_clicked(shown: Shown) -> None:
    tab, bus = shown.tab, shown.server.bus
    cmd_vel = bus.advertise(CMD_VEL.key("box_bot1"), make_encoding(Twist, Format.CDR))

    tab.click(*tab.evaluate(PLACE % 1))
    tab.until("document.body.innerText.includes('Stop following')")
    eventually(lambda: cmd_vel.is_matched, 5.0, "listening to its commands")
    cmd_vel.send(encode(Twist(Vector3(x=0.2), Vector3(z=-0.5)), Format.CDR))
    tab.until("document.body.innerText.includes('v 0.20 m/s  w -0.50 rad/s')")
    tab.until(f"{LOOKS_AT}.every((v, i) => Math.abs(v - [0, 0.06, -1][i]) < 0.05)")

    tab.press("Stop following")
    tab.until("!document.body.innerText.includes('Stop following')")
    eventually(lambda: not cmd_vel.is_matched, 5.0, "listening no more")


@pytest.mark.browser
def test_names_appear_above_all_robots_when_enabled(shown: Shown) -> None:
    label = "[...document.querySelectorAll('label')].find(l => l.innerText === 'Names')"
    labels = f"{NODES}.filter(path => path.startsWith('/names/')).length"

    shown.tab.evaluate(f"{label}.click()")
    shown.tab.until(f"{labels} === {ROBOTS}")

    shown.tab.evaluate(f"{label}.click()")
    shown.tab.until(f"{labels} === 0")


@pytest.mark.browser
def test_buttons_pause_step_reset_and_play(shown: Shown) -> None:
    tab, client = shown.tab, shown.server.client

    tab.press("Pause")
    eventually(lambda: client.info().state == "paused", 5.0, "pausing")
    before = client.info().steps
    tab.press("Step")
    eventually(lambda: client.info().steps == before + 1, 5.0, "stepping")
    tab.press("Reset")
    eventually(lambda: client.info().steps == 0, 5.0, "resetting")
    tab.press("Play")
    eventually(lambda: client.info().state == "playing", 5.0, "playing")

    assert client.info().entities == ROBOTS


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
