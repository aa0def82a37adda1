"""Names under the pointer: the page's script in node, with a scene of boxes and a camera above."""

import json
import shutil
import subprocess

import pytest

from zensim.spawner.page.page_files import read_page_file

NODE = shutil.which("node") or "node"
pytestmark = pytest.mark.browser

# The camera is 10 m above the origin, looks down, and has a view of 90 degrees: at the ground a
# square of 20 m is 200 px wide, so 1 m is 10 px. North is up.
SCENE = """
const listeners = {}, element = () => ({style: {}, set textContent(t) { this.text = t; }});
const tip = element(), canvas = {getBoundingClientRect: () => (
  {left: 0, top: 0, width: 200, height: 200})};
const identity = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1];
const near = 0.1, far = 100, depth = far - near;
const projection = [1,0,0,0, 0,1,0,0, 0,0,-(far+near)/depth,-1, 0,0,-2*far*near/depth,0];
const camera = {
  projectionMatrix: {elements: projection},
  matrixWorld: {elements: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,10,1]},
  matrixWorldInverse: {elements: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,-10,1]},
};
const corners = (x, y, z) => [-1, 1].flatMap(
  (i) => [-1, 1].flatMap((j) => [-1, 1].flatMap((k) => [i*x, j*y, k*z])));
const batch = (size, places, turns) => ({message: {props: {
  vertices: corners(...size), batched_positions: places, batched_wxyzs: turns}}});
const nodes = BATCHES;
const tree = {getState: () => nodes};
const nodeRefFromName = Object.fromEntries(
  Object.keys(nodes).map((path) => [path, {matrixWorld: {elements: identity}}]));
globalThis.window = {__viserMutable: {camera, canvas, nodeRefFromName}, __viserSceneTree: tree};
globalThis.document = {createElement: () => tip, body: {append: () => {}}};
globalThis.addEventListener = (kind, call) => { listeners[kind] = call; };
globalThis.fetch = async () => ({ok: true, json: async () => (NAMES)});
"""
POINT = """
(async () => {
  const found = [];
  for (const [x, y] of POINTS) {
    listeners.pointermove(
      {clientX: 100 + 10 * x, clientY: 100 - 10 * y, target: canvas, buttons: 0});
    await new Promise((done) => setTimeout(done, 5));
    found.push(tip.style.display === "block" ? tip.text : "");
  }
  console.log(JSON.stringify(found));
})();
"""
HALF = 0.70710678
UPRIGHT, QUARTER = "1,0,0,0", f"{HALF},0,0,{HALF}"
BATCHES = f"""{{
  "/robots/0/0/0": batch([5, 0.1, 1], [0, 4, 1, 8, 0, 1], [{UPRIGHT}, {QUARTER}]),
  "/robots/1/0/0": batch([0.1, 0.1, 0.1], [-2, 0, 0.1], [{UPRIGHT}]),
}}"""
NAMES = '{"/robots/0": ["north wall", "east wall"], "/robots/1": ["r1"]}'


def find_names(*points: tuple[float, float]) -> list[str]:
    """Find the names at places on the ground [m]."""
    scene = SCENE.replace("BATCHES", BATCHES).replace("NAMES", NAMES)
    code = scene + read_page_file("hover_names.js") + POINT.replace("POINTS", json.dumps(points))
    done = subprocess.run(
        [NODE, "-e", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == ""
    found: list[str] = json.loads(done.stdout)
    return found


def test_wall_has_its_name_along_its_whole_length() -> None:
    assert find_names((0, 4), (-4.8, 4.2), (4.8, 4.2)) == ["north wall"] * 3


def test_turned_wall_has_its_name_where_it_stands() -> None:
    assert find_names((8.2, 4), (8.2, -4.5)) == ["east wall"] * 2


def test_floor_beside_a_wall_has_no_name() -> None:
    """As far from the wall's centre as its ends are: a sphere around it covers all of this."""
    assert find_names((0, 0), (2, 1), (4, -4), (-7, 7), (0, -8)) == [""] * 5


def test_small_robot_has_its_name_nearby() -> None:
    assert find_names((-2, 0), (-1.4, 0.4), (-2, -3)) == ["r1", "r1", ""]
