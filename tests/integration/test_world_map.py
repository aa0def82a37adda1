"""The topic `map` of a real server: commands, peers of ROS 2, and late subscribers."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.integration.processes import Server, eventually, serving, zensim
from tests.integration.ros_client_process import run_observer, session_of
from tests.integration.ros_subscriptions import read_late_joining
from zensim.proto.codec.message_codec import Format, decode
from zensim.proto.messages.standard_messages import OccupancyGrid

WORLD = """<sdf version="1.10"><world name="yard">
<include><uri>model://ground_plane</uri></include>
<model name="wall"><static>true</static><pose>2 0 0.1 0 0 0</pose><link name="link">
<collision name="brick"><geometry><box><size>0.2 4 0.2</size></box></geometry></collision>
</link></model></world></sdf>"""
PILLAR = """<robot name="pillar"><link name="world"/><link name="post"><collision>
<origin xyz="0 0 0.5"/><geometry><box size="0.4 0.4 1"/></geometry></collision></link>
<joint name="fix" type="fixed"><parent link="world"/><child link="post"/></joint></robot>"""
RESOLUTION_M = 0.05
ON_WALL, BESIDE_WALL, AT_PILLAR = (2.0, 1.5), (1.0, 1.5), (0.0, 5.0)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    world = tmp_path_factory.mktemp("world") / "yard.sdf"
    world.write_text(WORLD)
    with serving("--world", str(world), "--ros-domain", "0") as found:
        yield found


def occupancy(grid: OccupancyGrid, place: tuple[float, float]) -> int | None:
    """Find the value at a place; None beyond the map."""
    corner, info = grid.info.origin.position, grid.info
    column, row = (
        int((at - low) / info.resolution)
        for at, low in zip(place, (corner.x, corner.y), strict=True)
    )
    if not (0 <= column < info.width and 0 <= row < info.height):
        return None
    return int(np.frombuffer(grid.data, np.int8)[row * info.width + column])


def test_echo_prints_the_map_to_several_subscribers(server: Server) -> None:
    for key in ("map", "sim/default/map"):
        for _ in range(2):
            done = zensim(
                "echo", key, "--once", "--json", "--timeout", "20", "--connect", server.endpoint
            )
            assert done.returncode == 0, done.stderr
            message = json.loads(done.stdout)["message"]
            assert message["info"]["resolution"] == pytest.approx(RESOLUTION_M)
            assert set(message["data"]) == {0, 100}


def test_subscriber_gets_a_new_map_when_a_static_model_is_spawned(
    server: Server, tmp_path: Path
) -> None:
    listener = server.bus.subscribe("map", 100)
    first = eventually(listener.newest, 20.0, "the map")
    model = tmp_path / "pillar.urdf"
    model.write_text(PILLAR)
    spawned = server.zensim("spawn", str(model), "--name", "pillar", "-y", "5")
    assert spawned.returncode == 0, spawned.stderr

    second = eventually(listener.newest, 20.0, "another map")

    grids = [decode(OccupancyGrid, one.payload, one.encoding) for one in (first, second)]
    places = (ON_WALL, BESIDE_WALL, AT_PILLAR)
    found = [[occupancy(grid, place) for place in places] for grid in grids]
    assert found == [[100, 0, None], [100, 0, 100]]


def test_ros_peer_that_joins_late_gets_the_map(server: Server) -> None:
    with run_observer(server, 0) as observe:
        received = observe(
            "receive",
            topic="/map",
            kind="nav_msgs/msg/OccupancyGrid",
            count=1,
            within_s=20.0,
            qos=":1:,1:,:,:,,",
        )
    assert received[0]["header"]["frame_id"] == "map"
    with session_of(server) as session:
        (sample,) = read_late_joining(session, "/map", 1)

    grid = decode(OccupancyGrid, bytes(sample.payload), Format.CDR.value)
    assert [occupancy(grid, place) for place in (ON_WALL, BESIDE_WALL)] == [100, 0]
