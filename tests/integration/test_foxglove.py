"""`zensim foxglove` beside a running world, with a client of the protocol from npm."""

import base64
import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import zensim as api
from tests.integration.processes import eventually, read_json_line, running
from tests.integration.processes import zensim as run_zensim
from tests.node_peers.foxglove_peer import SUBPROTOCOL, FoxglovePeer, connect_peer
from tests.spawner.packages import make_package, robot_of
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.exit_codes import ExitCode
from zensim.proto.stl import stl_size
from zensim.spawner.client.sim_client import SimClient

WITHIN_S = 30.0
TWIST = (
    "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
)


@pytest.fixture(scope="module")
def sim() -> Iterator[api.Sim]:
    with api.launch(engine="mujoco", timeout_s=120.0) as sim:
        sim.spawn("box_bot", name="r1")
        sim.play()
        yield sim


@pytest.fixture(scope="module")
def watched(sim: api.Sim) -> Iterator[str]:
    """Address of a server without control."""
    with running("foxglove", "--port", "0", "--json", "--connect", sim.endpoint) as process:
        yield str(read_json_line(process)["foxglove"])


@pytest.fixture(scope="module")
def controlled(sim: api.Sim) -> Iterator[str]:
    """Address of a server with control."""
    options = ("--port", "0", "--json", "--allow-control", "--connect", sim.endpoint)
    with running("foxglove", *options) as process:
        yield str(read_json_line(process)["foxglove"])


@pytest.fixture
def peer(watched: str) -> Iterator[FoxglovePeer]:
    with connect_peer(watched) as peer:
        peer.wait_for_topics("/r1/odom")
        yield peer


@pytest.fixture
def driver(sim: api.Sim, controlled: str) -> Iterator[FoxglovePeer]:
    sim.play()
    with connect_peer(controlled) as peer:
        peer.wait_for_topics("/r1/odom")
        peer.wait("advertiseServices")
        yield peer


def read_factor(sim: api.Sim) -> float:
    """Ask the server for its target."""
    with open_bus(BusConfig(connect=(sim.endpoint,))) as bus:
        return SimClient(bus).info().target_real_time_factor


def frames_of(message: dict[str, Any]) -> set[tuple[str, str]]:
    """List parent and child of each transform of a message."""
    return {
        (one["header"]["frame_id"], one["child_frame_id"]) for one in message["value"]["transforms"]
    }


def call(peer: FoxglovePeer, name: str, value: object, *, encoding: str = "cdr") -> dict[str, Any]:
    """Call a service; return its response."""
    peer.do("call", name=name, callId=7, encoding=encoding, value=value)
    return dict(peer.wait("serviceCallResponse")["value"])


@pytest.mark.parametrize("subprotocol", ["foxglove.websocket.v1", "foxglove.sdk.v1"])
def test_client_gets_odometry_with_its_definition(watched: str, subprotocol: str) -> None:
    with connect_peer(watched, subprotocol=subprotocol) as peer:
        info = peer.wait("serverInfo")
        peer.wait_for_topics("/r1/odom", "/tf", "/clock", "/zensim/scene")
        message = peer.subscribe("/r1/odom")

    assert info["capabilities"] == ["time", "assets"]
    assert message["schemaName"] == "nav_msgs/msg/Odometry"
    stamp = message["value"]["header"]["stamp"]
    assert int(message["timestamp"]) == stamp["sec"] * 10**9 + stamp["nanosec"]


def test_transforms_of_all_robots_reach_every_drawn_frame(sim: api.Sim, peer: FoxglovePeer) -> None:
    robot = sim.spawn("box_bot", name="r3")
    peer.wait_for_topics("/r3/odom")
    edges = frames_of(peer.subscribe("/tf")) | frames_of(peer.subscribe("/tf_static"))

    def has_both() -> bool:
        for one in peer.drain():
            if one.get("topic") in ("/tf", "/tf_static"):
                edges.update(frames_of(one))
        children = {child for _, child in edges}
        return {"r1/base_footprint", "r3/base_footprint", "r1/chassis", "r3/odom"} <= children

    eventually(has_both, WITHIN_S, "transforms of both robots")
    scene = peer.subscribe("/zensim/scene")["value"]
    robot.delete()

    parent_of = {child: parent for parent, child in edges}
    for entity in scene["entities"]:
        frame = entity["frame_id"]
        while frame != "world":
            frame = parent_of[frame]
    assert {"r1", "r3"} <= {one["metadata"][0]["value"] for one in scene["entities"]}
    assert any(one["cubes"] or one["cylinders"] for one in scene["entities"])


def test_time_and_statistics_are_sent_while_something_is_subscribed(peer: FoxglovePeer) -> None:
    statistics = peer.subscribe("/sim/default/stats")
    clock = peer.subscribe("/clock")["value"]["clock"]
    time_ns = int(peer.wait("time")["timestamp"])

    assert statistics["value"]["entities"] >= 1
    assert abs(time_ns - clock["sec"] * 10**9 - clock["nanosec"]) < 60 * 10**9


def test_later_subscriber_gets_latched_messages(watched: str, peer: FoxglovePeer) -> None:
    first = peer.subscribe("/r1/robot_description")["value"]
    with connect_peer(watched) as other:
        other.wait_for_topics("/r1/robot_description")
        second = other.subscribe("/r1/robot_description")["value"]

    assert first == second
    assert first["data"].startswith("<")


def test_robot_that_comes_and_goes_is_advertised(sim: api.Sim, peer: FoxglovePeer) -> None:
    robot = sim.spawn("box_bot", name="r2")
    peer.wait_for_topics("/r2/odom", "/r2/cmd_vel")
    peer.subscribe("/r2/odom")
    robot.delete()
    gone = peer.wait("unadvertise", lambda one: "/r2/odom" in one["topics"])

    assert "/r1/odom" not in gone["topics"]
    assert peer.subscribe("/r1/odom")["topic"] == "/r1/odom"


def test_control_is_refused_unless_allowed(sim: api.Sim, peer: FoxglovePeer) -> None:
    peer.do("advertise", topic="/r1/cmd_vel", encoding="json", schemaName="geometry_msgs/Twist")
    peer.wait("status", lambda one: "--allow-control" in one["message"])
    peer.do("publish", topic="/r1/cmd_vel", value={"linear": {"x": 1.0}})
    peer.wait("status", lambda one: "--allow-control" in one["message"])
    peer.do("callUnknown", serviceId=1, callId=9)
    failure = peer.wait("serviceCallFailure")
    peer.do("setParameters", parameters=[{"name": "real_time_factor", "value": 3.0}], id="a")
    peer.wait("status", lambda one: "--allow-control" in one["message"])

    assert failure["callId"] == 9
    assert read_factor(sim) == 1.0


@pytest.mark.parametrize("encoding", ["json", "cdr"])
def test_published_commands_drive_a_robot_until_its_driver_is_gone(
    controlled: str, driver: FoxglovePeer, encoding: str
) -> None:
    command = {"linear": {"x": 0.4, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
    with connect_peer(controlled) as teleop:
        teleop.wait_for_topics("/r1/cmd_vel")
        teleop.do(
            "advertise",
            topic="/r1/cmd_vel",
            encoding=encoding,
            schemaName="geometry_msgs/msg/Twist",
            schema=TWIST,
        )
        driver.do("subscribe", topic="/r1/odom")

        def is_driving() -> bool:
            teleop.do("publish", topic="/r1/cmd_vel", value=command)
            return newest_speed(driver) > 0.3

        eventually(is_driving, WITHIN_S, "driving")

    eventually(lambda: abs(newest_speed(driver)) < 0.01, WITHIN_S, "the stop")


def newest_speed(peer: FoxglovePeer) -> float:
    message = peer.wait("message", lambda one: one["topic"] == "/r1/odom")
    speeds = [one for one in peer.drain() if one.get("topic") == "/r1/odom"]
    return float((speeds or [message])[-1]["value"]["twist"]["twist"]["linear"]["x"])


def test_services_are_called_with_their_definitions(driver: FoxglovePeer) -> None:
    assert call(driver, "/pause_physics", {}) == {}
    state = call(driver, "/get_simulation_state", {}, encoding="json")
    stepped = call(driver, "/step_simulation", {"steps": 3})
    played = call(driver, "/set_simulation_state", {"state": {"state": 1}}, encoding="json")

    assert state["state"]["state"] == 2
    assert stepped["result"]["result"] == played["result"]["result"] == 1


def test_entities_are_spawned_and_deleted(driver: FoxglovePeer) -> None:
    order = {"name": "r4", "entity_resource": {"uri": "box_bot"}, "entity_namespace": "r4"}
    spawned = call(driver, "/spawn_entity", order, encoding="json")
    driver.wait_for_topics("/r4/robot_description")
    call(driver, "/delete_entity", {"entity": "r4"})
    driver.do("call", name="/delete_entity", callId=8, encoding="json", value={"entity": "r4"})
    failure = driver.wait("serviceCallFailure")

    assert spawned["entity_name"] == "r4"
    assert failure["callId"] == 8
    assert "r4" in failure["message"]


def test_real_time_factor_is_a_parameter(sim: api.Sim, driver: FoxglovePeer) -> None:
    driver.do("subscribeParameters", names=["real_time_factor"])
    driver.do("setParameters", parameters=[{"name": "real_time_factor", "value": 0.5}], id="a")
    answer = driver.wait("parameterValues", lambda one: one.get("id") == "a")
    update = driver.wait("parameterValues")
    changed = read_factor(sim)
    driver.do("setParameters", parameters=[{"name": "real_time_factor", "value": "fast"}])
    driver.wait("status", lambda one: "real_time_factor" in one["message"])
    driver.do("setParameters", parameters=[{"name": "real_time_factor", "value": 1.0}], id="b")
    driver.wait("parameterValues", lambda one: one.get("id") == "b")

    assert answer["parameters"] == update["parameters"]
    assert changed == answer["parameters"][0]["value"] == 0.5


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("/r1/odom", "nav_msgs/msg/Odometry"),
        ("/sim/default/twists", "geometry_msgs/msg/Twist"),
        ("/*/cmd_vel", "geometry_msgs/msg/Twist"),
        ("/r1/cmd_vel", "nav_msgs/msg/Odometry"),
    ],
)
def test_only_commands_of_robots_are_published(driver: FoxglovePeer, topic: str, kind: str) -> None:
    driver.do("advertise", topic=topic, encoding="json", schemaName=kind)

    assert driver.wait("status")["level"] == 2


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "http://127.0.0.1:8080"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "evil.example:8765"}, 403),
    ],
)
def test_page_of_another_site_is_refused(
    watched: str, headers: dict[str, str], status: int
) -> None:
    port = int(watched.rpartition(":")[2])
    lines = {"Host": f"127.0.0.1:{port}", **headers}
    request = (
        "GET / HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n"
        + "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        + "\r\n"
    )
    with socket.create_connection(("127.0.0.1", port), WITHIN_S) as raw:
        raw.sendall(request.encode())
        answer = raw.recv(4096).decode()

    assert answer.startswith(f"HTTP/1.1 {status} ")


@pytest.mark.parametrize("origin", ["https://app.example", "vscode-webview://a1b2"])
def test_admitted_origin_and_token_are_accepted(sim: api.Sim, origin: str) -> None:
    options = ("--port", "0", "--json", "--secure", "--allow-origin", origin)
    with running("foxglove", *options, "--connect", sim.endpoint) as process:
        url = str(read_json_line(process)["foxglove"])
        with connect_peer(url, origin=origin) as peer:
            peer.wait("serverInfo")
        with pytest.raises(InvalidStatus) as refused:
            connect(url.partition("/?")[0], subprotocols=["foxglove.sdk.v1"])  # type: ignore[list-item]

    assert refused.value.response.status_code == 401


@pytest.mark.parametrize("origin", ["app.example", "https://app.example/", "*"])
def test_origin_that_can_be_none_is_refused(origin: str) -> None:
    assert run_zensim("foxglove", "--allow-origin", origin).returncode == ExitCode.USAGE


@pytest.mark.parametrize(
    "message", ["{", '{"op":"fly"}', '{"op":"subscribe"}', b"", b"\x09", b"\x02\x01", "[" * 9999]
)
def test_malformed_message_is_answered_and_the_link_stays(
    watched: str, message: str | bytes
) -> None:
    with connect(watched, subprotocols=["foxglove.sdk.v1"]) as client:  # type: ignore[list-item]
        client.send(message)
        answers = [json.loads(client.recv(WITHIN_S)) for _ in range(3)]
        client.send('{"op":"unsubscribe","subscriptionIds":[1]}')
        last = json.loads(client.recv(WITHIN_S))

    assert [one["op"] for one in answers if one["op"] == "status"] == ["status"]
    assert last["op"] == "status"


def test_client_without_the_protocol_is_refused(watched: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        connect(watched, subprotocols=["chat"])  # type: ignore[list-item]

    assert refused.value.response.status_code == 400


def test_only_files_of_the_server_are_read(peer: FoxglovePeer) -> None:
    peer.do("fetchAsset", uri="package://zensim/meshes/" + "0" * 64 + ".stl", requestId=1)
    unknown = peer.wait("fetchAssetResponse")
    peer.do("fetchAsset", uri="file:///etc/passwd", requestId=2)
    local = peer.wait("fetchAssetResponse")

    assert (unknown["requestId"], unknown["status"]) == (1, 1)
    assert (local["requestId"], local["status"]) == (2, 1)
    assert base64.b64decode(local["content"]) == b""


def test_meshes_of_a_robot_are_drawn_and_read(
    sim: api.Sim, peer: FoxglovePeer, tmp_path: Path
) -> None:
    package = make_package(tmp_path)
    file = package / "urdf" / "meshed.urdf"
    drawn = "package://my_robot/meshes/drawn.stl"
    file.write_text(robot_of("package://my_robot/meshes/base.stl", drawn))
    sim.spawn(file, name="m1")

    def find_url() -> str | None:
        for one in peer.drain():
            for entity in one["value"]["entities"] if one.get("topic") == "/zensim/scene" else ():
                if entity["id"].startswith("m1") and entity["models"]:
                    return str(entity["models"][0]["url"])
        return None

    peer.do("subscribe", topic="/zensim/scene")
    url = eventually(find_url, WITHIN_S, "the mesh in the scene")
    contents = []
    for number, uri in enumerate((url, drawn)):
        peer.do("fetchAsset", uri=uri, requestId=number)
        response = peer.wait("fetchAssetResponse")
        contents.append(base64.b64decode(response["content"]))

    assert len(contents[0]) == stl_size(4)
    assert contents[1] == (package / "meshes" / "drawn.stl").read_bytes()


def test_scans_and_images_reach_a_client(sim: api.Sim, peer: FoxglovePeer) -> None:
    robots = [
        sim.spawn("box_bot_lidar", name="l1", x=3.0, y=3.0),
        sim.spawn("box_bot_camera", name="c1", x=-3.0, y=3.0),
    ]
    peer.wait_for_topics("/l1/scan", "/c1/camera/image_raw/compressed")
    scan = peer.subscribe("/l1/scan")
    image = peer.subscribe("/c1/camera/image_raw/compressed")
    for robot in robots:
        robot.delete()

    assert scan["schemaName"] == "sensor_msgs/msg/LaserScan"
    assert len(scan["value"]["ranges"]) == 360
    assert image["schemaName"] == "sensor_msgs/msg/CompressedImage"
    assert bytes(image["value"]["data"][:3]) == b"\xff\xd8\xff"
