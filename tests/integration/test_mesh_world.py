"""Worlds and robots with meshes in a real server: concave shapes and resting contacts."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.integration.chromium import open_page
from tests.integration.processes import (
    START_S,
    Server,
    connected,
    eventually,
    read_json_line,
    running,
    serving,
)
from tests.integration.test_view import BATCHES, viewing
from tests.sim_server.description.meshes.test_textures import a_bomb, an_image
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.service_catalog import GET_ASSET
from zensim.spawner.client.sim_client import SimClient

STEPS = 400
LEAST_PX = 2000
PATIENCE_S = 50.0
"""Software rendering is slow."""
RING = trimesh.creation.annulus(r_min=0.4, r_max=0.6, height=0.3)
WEDGE = trimesh.convex.convex_hull(
    np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)] + [[0.0, 0.0, -0.5]])
)
WORLD = """<sdf version="1.6"><world name="w">
<include><uri>model://ground_plane</uri></include>
<include><uri>model://ring</uri><pose>0 0 0.15 0 0 0</pose></include>
<scene><background>0.1 0.8 0.1 1</background></scene>
<model name="tile"><pose>3 0 1 0 0 0</pose><link name="l"><inertial><mass>1</mass><inertia>
<ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial><collision name="c"><geometry>
<mesh><uri>tile.obj</uri><scale>0.5 0.5 0.5</scale></mesh></geometry></collision></link></model>
</world></sdf>"""
RING_SDF = """<sdf version="1.6"><model name="ring"><static>true</static><link name="l">
<collision name="c"><geometry><mesh><uri>meshes/ring.dae</uri></mesh></geometry></collision>
<visual name="v"><geometry><mesh><uri>meshes/ring.dae</uri></mesh></geometry>
<material><diffuse>0.9 0.1 0.1 1</diffuse></material></visual></link></model></sdf>"""
ROBOT = """<robot name="wedge"><link name="base"><inertial><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
<collision><geometry><mesh filename="wedge.stl"/></geometry></collision></link></robot>"""


BOARD_OBJ = """mtllib board.mtl
v -2 0 0\nv 2 0 0\nv 2 0 2\nv -2 0 2\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl paint\nf 1/1 2/2 3/3 4/4\n"""
BOARD_URDF = """<robot name="board"><link name="base"><inertial><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
<visual><geometry><mesh filename="board.obj"/></geometry></visual>
<collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>"""
BOARD_WORLD = """<sdf version="1.6"><world name="w"><include><uri>model://ground_plane</uri></include>
<model name="board"><static>true</static><link name="l"><visual name="v"><geometry><mesh>
<uri>board.obj</uri></mesh></geometry></visual></link></model></world></sdf>"""
BLUE = (0, 0, 255)


def make_board(folder: Path, image: bytes = b"") -> Path:
    """Make a folder with a robot and a world that are a board with an image."""
    folder.mkdir(exist_ok=True)
    (folder / "board.obj").write_text(BOARD_OBJ)
    (folder / "board.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    (folder / "paint.png").write_bytes(image or an_image(colour=BLUE))
    (folder / "board.urdf").write_text(BOARD_URDF)
    (folder / "board.world").write_text(BOARD_WORLD)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a world with a ring from the search path, a tile in its folder, and a robot."""
    made = tmp_path_factory.mktemp("world")
    (made / "models" / "ring" / "meshes").mkdir(parents=True)
    (made / "models" / "ring" / "model.sdf").write_text(RING_SDF)
    RING.export(str(made / "models" / "ring" / "meshes" / "ring.dae"))
    trimesh.creation.box((1.0, 1.0, 0.2)).export(str(made / "tile.obj"))
    WEDGE.export(str(made / "wedge.stl"))
    (made / "w.world").write_text(WORLD)
    (made / "wedge.urdf").write_text(ROBOT)
    return made


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[Server]:
    path = ("--model-path", str(folder / "models"), "--rtf", "0", "--strict", "--paused")
    with serving("--world", str(folder / "w.world"), *path) as found:
        yield found


def height(server: Server, name: str) -> float:
    return server.client.entity_state(name).pose.position.z


def test_robot_rests_in_the_hole_of_a_static_mesh(server: Server) -> None:
    assert server.zensim("spawn", "box_bot", "-n", "inside", "--strict").returncode == 0

    server.client.step(STEPS)

    assert height(server, "inside") == pytest.approx(0.06, abs=0.005)


def test_dynamic_mesh_of_a_world_falls_and_rests(server: Server) -> None:
    server.client.step(STEPS)

    assert height(server, "tile") == pytest.approx(0.05, abs=0.005)


def test_visual_mesh_of_a_world_can_be_fetched(server: Server) -> None:
    (model,) = server.client.models(("ring",)).models
    mesh = model.links[0].visuals[0].mesh

    response = server.bus.call(GET_ASSET, GetAssetRequest(mesh), world="default")

    assert len(response.data) == response.total == 84 + 50 * len(RING.faces)


def test_robot_of_a_mesh_is_placed_on_its_lowest_corner(server: Server, folder: Path) -> None:
    wish = ("spawn", str(folder / "wedge.urdf"), "-n", "wedge", "-x", "-3")

    done = server.zensim(*wish, "--strict")

    assert done.returncode == 0, done.stderr
    assert height(server, "wedge") == pytest.approx(0.5)


def test_image_of_a_robot_can_be_fetched(server: Server, tmp_path: Path) -> None:
    wish = ("spawn", str(make_board(tmp_path / "a") / "board.urdf"), "-n", "painted", "-y", "5")

    done = server.zensim(*wish, "--strict")

    assert done.returncode == 0, done.stderr
    (model,) = server.client.models(("painted",)).models
    (shape,) = model.links[0].visuals
    assert shape.texture is not None
    image = server.bus.call(GET_ASSET, GetAssetRequest(shape.texture.image), world="default")
    points = server.bus.call(GET_ASSET, GetAssetRequest(shape.texture.coordinates), world="default")
    assert image.data.startswith(b"\xff\xd8\xff")
    assert points.total == 2 * 3 * 2 * 4


@pytest.mark.parametrize("image", [a_bomb(), b"\x89PNG\r\n\x1a\n" * 50], ids=["bomb", "broken"])
def test_robot_with_a_hostile_image_is_spawned_without_it(
    server: Server, tmp_path: Path, image: bytes
) -> None:
    file = make_board(tmp_path / "a", image) / "board.urdf"

    done = server.zensim("spawn", str(file), "-n", f"plain{len(image)}", "-y", "-5", "--dry-run")

    assert done.returncode == 0, done.stderr
    assert "texture 'in the mesh'" in done.stdout + done.stderr


def test_light_of_a_world_is_returned_with_its_models(server: Server) -> None:
    assert server.client.models().scene.background == (0.1, 0.8, 0.1, 1.0)


@pytest.mark.browser
def test_page_draws_the_meshes_and_the_sky_of_a_world(server: Server) -> None:
    low = "?initialCameraPosition=-2,-2,0.6&initialCameraLookAt=0,0,0.3"
    with viewing(server.endpoint) as (url, _), open_page(f"{url}/{low}") as tab:
        tab.until(f"{BATCHES}.length > 0", PATIENCE_S)

        def are_seen() -> bool:
            red, green, blue = np.moveaxis(tab.pixels().astype(int), -1, 0)
            reds = (red > green + 60) & (red > blue + 60)
            greens = (green > red + 60) & (green > blue + 60)
            return min(int(reds.sum()), int(greens.sum())) > LEAST_PX

        eventually(are_seen, PATIENCE_S, "a red ring and a green sky")
        assert tab.complaints == []


def test_up_finds_the_models_of_its_world_and_runs_in_real_time(folder: Path) -> None:
    pace = "<physics type='ode'><real_time_factor>0.5</real_time_factor></physics></world>"
    (folder / "slow.world").write_text(WORLD.replace("</world>", pace))
    wish = ("up", "--robots", "0", "--no-viewer", "--listen", "tcp/127.0.0.1:0", "--strict")

    with running(*wish, "--world", str(folder / "slow.world"), "--json") as lost:
        assert lost.wait(START_S) == ExitCode.FAILED
    path = ("--model-path", str(folder / "models"))
    with running(*wish, "--world", str(folder / "slow.world"), "--json", *path) as up:
        endpoint = str(read_json_line(up)["endpoint"])
        with connected(endpoint) as bus:
            info = SimClient(bus).info()

    assert (info.target_real_time_factor, info.entities) == (0.5, 2)


@pytest.mark.browser
def test_page_draws_the_image_of_a_mesh(tmp_path: Path) -> None:
    board = make_board(tmp_path / "worlds")
    with (
        serving("--paused", "--model-path", str(board)) as server,
        viewing(server.endpoint) as (url, _),
    ):
        server.client.load_world("board.world")
        with open_page(url) as tab:
            tab.until(f"{BATCHES}.length > 0", PATIENCE_S)

            def is_seen() -> bool:
                red, green, blue = np.moveaxis(tab.pixels().astype(int), -1, 0)
                return int(((blue > red + 60) & (blue > green + 60)).sum()) > LEAST_PX

            eventually(is_seen, PATIENCE_S, "a blue board")
            assert tab.complaints == []
