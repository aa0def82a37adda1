"""Sensors on the page in a real browser: switches, points, pictures, and hostile messages."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import msgspec
import numpy as np
import pytest

from tests.integration.chromium import Tab, open_page
from tests.integration.processes import START_S, Server, eventually, serving
from tests.integration.sensor_runs import running_sensors
from tests.integration.test_view import CLICK_MS, WITHIN, viewing
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.spawn_messages import Resource, SpawnEntitiesOrder, SpawnEntity
from zensim.proto.messages.standard_messages import Image, LaserScan, Point, Pose, PoseStamped
from zensim.proto.topic_catalog import SCAN
from zensim.sim_server.description.builtin_models import read_builtin_model

pytestmark = pytest.mark.browser

FRONT_M = 1.5
"""x of the side of the wall that the robots see."""
WALL = """<sdf version="1.9"><model name="wall"><static>true</static><link name="link">
<collision name="c"><geometry><box><size>0.2 8 1</size></box></geometry></collision>
<visual name="v"><geometry><box><size>0.2 8 1</size></box></geometry>
<material><diffuse>0.9 0.2 0.1 1</diffuse></material></visual></link></model></sdf>"""
LIDAR_3D = """
<gazebo reference="chassis"><sensor name="velodyne" type="ray">
  <pose>0 0 0.1 0 0 0</pose><update_rate>10</update_rate>
  <ray>
    <scan><horizontal><samples>120</samples><min_angle>-0.6</min_angle><max_angle>0.6</max_angle>
      </horizontal><vertical><samples>8</samples><min_angle>-0.05</min_angle>
      <max_angle>0.15</max_angle></vertical></scan>
    <range><min>0.2</min><max>20</max></range>
  </ray>
  <plugin name="velodyne" filename="libgazebo_ros_ray_sensor.so">
    <ros><remapping>~/out:=velodyne_points</remapping></ros>
    <output_type>sensor_msgs/PointCloud2</output_type><frame_name>chassis</frame_name>
  </plugin>
</sensor></gazebo>"""
PLACE_OF = """
(async () => {
  const names = await (await fetch("/names")).json();
  const [group, list] = Object.entries(names).find(([, list]) => list.includes("%s"));
  const page = window.__viserMutable, box = page.canvas.getBoundingClientRect();
  const [path, node] = Object.entries(window.__viserSceneTree.getState()).find(
    ([path, node]) => path.startsWith(group + "/") && node.message.props.batched_positions);
  const seen = page.camera.position.clone()
    .fromArray(node.message.props.batched_positions, 3 * list.indexOf("%s"))
    .applyMatrix4(page.nodeRefFromName[path].matrixWorld).project(page.camera);
  return [box.left + (seen.x + 1) / 2 * box.width, box.top + (1 - seen.y) / 2 * box.height];
})()
"""
"""Screen position of a robot."""
POINTS_OF = """
(() => {
  const nodes = window.__viserSceneTree.getState(), robot = "%s";
  const node = nodes[`/scans/${robot}`] ?? nodes[`/clouds/${robot}`];
  if (!node) return null;
  const raw = node.message.props.points;
  return Array.from(raw instanceof Float32Array ? raw : new Float32Array(
    raw.buffer.slice(raw.byteOffset, raw.byteOffset + raw.byteLength)));
})()
"""
"""Coordinates of the points shown for a robot, in the world; null without any."""
PICTURES = """
[...document.querySelectorAll("img")].filter((one) => one.naturalWidth === 320).map((one) => {
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [one.naturalWidth, one.naturalHeight];
  copy.getContext("2d").drawImage(one, 0, 0);
  return Array.from(copy.getContext("2d").getImageData(0, 0, copy.width, copy.height).data);
})
"""
"""Pixels of the pictures of cameras in the panel."""
BESIDE_SWITCHES = """
(() => {
  const {top, bottom} = document.querySelector("img[alt='Picture of %s']").getBoundingClientRect();
  const places = [...document.querySelectorAll("label, .zensim-fold")].filter((one) =>
    /^(Show|Links)/.test(one.innerText)).map((one) => one.getBoundingClientRect().top);
  return bottom <= innerHeight && places.filter((one) => one > top).length === 1;
})()
"""
"""Whether a picture is in view, after all switches and before the next folder."""
LABEL = "[...document.querySelectorAll('label')].find((one) => one.innerText === '%s')"
HOSTILE_SCANS = (
    b"",
    b"\x00\x01\x00\x00",
    b"\x00\x01\x00\x00" + b"\xff" * 400,
    b"{" * 1000,
    encode(LaserScan(angle_min=float("nan"), ranges=(1.0,) * 9, range_max=9.0), Format.CDR),
    encode(LaserScan(angle_increment=float("inf"), ranges=(1.0,) * 9, range_max=9.0), Format.CDR),
    encode(LaserScan(angle_min=1e308, ranges=(1.0,) * 9, range_max=1e308), Format.MSGPACK),
)
HOSTILE_IMAGES = (
    b"\x00\x01\x00\x00" + b"\xff" * 400,
    encode(Image(height=2**32 - 1, width=2**32 - 1, encoding="rgb8", step=2**32 - 1), Format.CDR),
    encode(Image(height=1, width=1, encoding="\U0001f600" * 99, step=3, data=b"123"), Format.CDR),
    encode(Image(height=2, width=3, encoding="32FC1", step=12, data=b"\xff" * 24), Format.CDR),
)
"""The last one is read: its depths are not numbers."""


@dataclass(frozen=True)
class Shown:
    """A page in a browser, and its server."""

    server: Server
    tab: Tab

    def follow(self, robot: str) -> None:
        """Show all, click a robot, and wait for its panel."""
        self.tab.press("Show all")
        self.tab.until("!document.body.innerText.includes('Stop following')")
        eventually(lambda: self._click(robot), START_S, f"following {robot}")

    def _click(self, robot: str) -> bool:
        """Click a robot; the camera may still move, or another robot be in between."""
        self.tab.click(*self.tab.evaluate(PLACE_OF % (robot, robot)))
        panel = f"document.body.innerText.includes('Namespace\\n{robot}')"
        return bool(self.tab.evaluate(WITHIN % (CLICK_MS, panel)))

    def switch(self, label: str) -> None:
        """Click a switch of the panel."""
        self.tab.until(f"!!{LABEL % label}")
        self.tab.evaluate(f"{LABEL % label}.click()")

    def points_of(self, robot: str) -> np.ndarray:
        """Return the points (n, 3) shown for a robot."""
        return np.array(self.tab.evaluate(POINTS_OF % robot) or []).reshape(-1, 3)

    def has_points_on_the_wall(self, robot: str, least: int) -> bool:
        found = self.points_of(robot)
        return int((np.abs(found[:, 0] - FRONT_M) < 0.02).sum()) >= least

    def wait_until_unsubscribed(self) -> None:
        """Wait until the sensor process has nothing to do."""
        pattern = keys.active_sensors("default", "*")
        eventually(lambda: not self.server.bus.list_tokens(pattern), START_S, "no demand")


@pytest.fixture(scope="module")
def shown() -> Iterator[Shown]:
    with serving() as server, running_sensors(server, "s1"):
        server.client.spawn_all(SpawnEntitiesOrder((*list_spawns(),)))
        with viewing(server.endpoint) as (url, _), open_page(url) as tab:
            tab.until("document.body.innerText.includes('playing')", 120.0)
            tab.until("Object.keys(window.__viserSceneTree.getState()).length > 3", 120.0)
            yield Shown(server, tab)


def list_spawns() -> Iterator[SpawnEntity]:
    """List a wall, and three robots that face it."""
    cloud = re.sub(r"</robot>\s*$", LIDAR_3D + "</robot>", read_builtin_model("box_bot"))
    robots = {
        "flat": read_builtin_model("box_bot_lidar"),
        "cloud": cloud,
        "eye": read_builtin_model("box_bot_camera"),
    }
    for number, (name, text) in enumerate(robots.items()):
        yield SpawnEntity(
            name=name,
            entity_namespace=name,
            entity_resource=Resource(resource_string=text),
            initial_pose=PoseStamped(pose=Pose(Point(0.0, float(number - 1)))),
        )
    yield SpawnEntity(
        name="wall",
        entity_resource=Resource(resource_string=WALL),
        initial_pose=PoseStamped(pose=Pose(Point(FRONT_M + 0.1, 0.0, 0.5))),
    )


@pytest.mark.parametrize(
    ("robot", "label", "least"),
    [
        ("flat", "Show scan", 50),
        ("cloud", "Show scan", 100),
        ("eye", "Show scan camera/points", 200),
    ],
)
def test_switch_shows_points_on_the_wall_until_switched_off(
    shown: Shown, robot: str, label: str, least: int
) -> None:
    shown.wait_until_unsubscribed()
    shown.follow(robot)
    assert not len(shown.points_of(robot))

    shown.switch(label)
    eventually(lambda: shown.has_points_on_the_wall(robot, least), START_S, "points on the wall")

    shown.switch(label)
    shown.wait_until_unsubscribed()
    eventually(lambda: not len(shown.points_of(robot)), START_S, "points removed")


@pytest.mark.parametrize(
    "label", ["Show picture camera/image_raw", "Show picture camera/depth/image_raw"]
)
def test_switch_shows_a_picture_until_switched_off(shown: Shown, label: str) -> None:
    shown.wait_until_unsubscribed()
    shown.follow("eye")
    assert shown.tab.evaluate(PICTURES) == []

    shown.switch(label)
    shown.tab.until(f"{PICTURES}.length === 1", 120.0)
    (pixels,) = shown.tab.evaluate(PICTURES)
    assert np.array(pixels).reshape(-1, 4)[:, :3].std(axis=0).min() > 5.0
    topic = label.removeprefix("Show picture ")
    shown.tab.until(BESIDE_SWITCHES % topic)

    shown.switch(label)
    shown.wait_until_unsubscribed()
    shown.tab.until(f"{PICTURES}.length === 0", 120.0)


def test_page_goes_on_when_others_publish_hostile_scans(shown: Shown) -> None:
    shown.follow("flat")
    shown.switch("Show scan")
    eventually(lambda: shown.has_points_on_the_wall("flat", 50), START_S, "points on the wall")

    publish_until(shown, SCAN.key("flat"), LaserScan, HOSTILE_SCANS, lambda: has_refused(shown.tab))

    eventually(lambda: shown.has_points_on_the_wall("flat", 50), START_S, "points on the wall")
    shown.switch("Show scan")
    shown.wait_until_unsubscribed()
    assert shown.tab.complaints == []


def test_page_goes_on_when_others_publish_hostile_pictures(shown: Shown) -> None:
    label = "Show picture camera/image_raw"
    key = keys.robot("eye", "camera/image_raw")
    shown.follow("eye")
    shown.switch(label)
    shown.tab.until(f"{PICTURES}.length === 1", 120.0)

    publish_until(shown, key, Image, HOSTILE_IMAGES, lambda: has_refused(shown.tab))

    shown.tab.until(f"{PICTURES}.length === 1", 120.0)
    shown.switch(label)
    shown.wait_until_unsubscribed()
    assert shown.tab.complaints == []


def publish_until(
    shown: Shown,
    key: str,
    kind: type[msgspec.Struct],
    payloads: tuple[bytes, ...],
    is_done: Callable[[], bool],
) -> None:
    """Publish payloads beside those of the sensor, each many times, until they are refused."""
    publisher = shown.server.bus.advertise(key, make_encoding(kind, Format.CDR))

    def publish() -> bool:
        for payload in payloads:
            publisher.send(payload)
        return is_done()

    eventually(publish, START_S, "refusals")
    publisher.close()


def has_refused(tab: Tab) -> bool:
    return "Malformed sensor messages" in str(tab.evaluate("document.body.innerText"))
