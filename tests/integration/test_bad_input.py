"""Invalid input to the server or an agent: a code in one line, and the world keeps running."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from tests.integration.processes import (
    START_S,
    Server,
    eventually,
    free_endpoint,
    running,
    running_agents,
    serving,
    zensim,
)
from tests.integration.robots import Robot, robot
from zensim.proto.codec.message_codec import decode
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.spawn_messages import DeleteEntityResponse
from zensim.proto.service_catalog import SERVICES
from zensim.spawner.client.sim_client import SimClient

GARBAGE = (
    b"\x00",
    b"\xff" * 64,
    b"{",
    b"[" * 10_000,
    b"\x00\x01\x00\x00" + b"\xff" * 13,
    b"\xdf\xff\xff\xff\xff",
    b"\x81\xa4name",
    "ungültig".encode("utf-16"),
)
NOT_A_ROBOT = "<robot name='r'><link name='a'/><link name='a'/></robot>"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as found:
        found.zensim("spawn", "box_bot", "--name", "taken")
        yield found


@pytest.fixture(autouse=True)
def advancing(server: Server) -> Iterator[None]:
    yield
    before = server.steps()
    eventually(lambda: server.steps() > before + 24, 5.0, "stepping")
    assert server.process.poll() is None


@pytest.fixture(scope="module")
def session(server: Server) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([server.endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as found:
        yield found


SPEECHLESS = {
    "pause_physics",
    "unpause_physics",
    "reset_world",
    "gazebo_reset_simulation",
    "clear_link_wrenches",
    "clear_joint_efforts",
}
"""Services whose ROS types have no result field."""


def ask(session: zenoh.Session, service: str, payload: bytes, encoding: str = "") -> dict[str, Any]:
    replies = session.get(
        f"sim/default/{service}", payload=payload, encoding=encoding or None, timeout=60.0
    )
    samples = [reply.ok for reply in replies if reply.ok]
    assert len(samples) == 1
    body = samples[0].payload.to_bytes()
    sent = str(samples[0].encoding)
    if sent.startswith("application/cdr") and service in SPEECHLESS:
        return {}
    if sent.startswith("application/cdr"):
        answer = msgspec.to_builtins(decode(_refusal_type(service), body))
    else:
        answer = json.loads(body) if "json" in sent else msgspec.msgpack.decode(body)
    assert isinstance(answer, dict)
    return answer


def _refusal_type(service: str) -> type[msgspec.Struct]:
    known = SERVICES[service].response
    return known if "result" in known.__struct_fields__ else DeleteEntityResponse


def is_refused(answer: dict[str, Any]) -> bool:
    """Whether a response is a refusal, by its result or by the fields of gazebo_msgs."""
    if "success" in answer:
        return answer["success"] is False
    return not answer or answer["result"]["result"] != ResultCode.OK


def spawn(session: zenoh.Session, **fields: object) -> tuple[int, str]:
    request = {"name": "r", "entity_resource": {"uri": "box_bot"}, **fields}
    answer = ask(session, "spawn_entity", json.dumps(request).encode(), "application/json")
    return answer["result"]["result"], answer["result"]["error_message"]


def at(**numbers: float) -> dict[str, object]:
    place = {axis: numbers.pop(axis, 0.0) for axis in "xyz"}
    return {"pose": {"position": place, "orientation": numbers or {"w": 1.0}}}


@pytest.mark.parametrize("service", sorted(SERVICES))
def test_service_refuses_malformed_payloads(session: zenoh.Session, service: str) -> None:
    for payload in GARBAGE:
        for encoding in ("", "application/json", "application/cdr", "application/msgpack"):
            answer = ask(session, service, payload, encoding)

            assert is_refused(answer), (payload, encoding)


def test_service_names_the_error_when_json_is_malformed(session: zenoh.Session) -> None:
    answer = ask(session, "spawn_entity", b'{"name": 3}', "application/json")

    assert answer["result"]["result"] == 4
    assert "name" in answer["result"]["error_message"]


def test_unknown_service_is_refused_with_the_list_of_services(session: zenoh.Session) -> None:
    answer = ask(session, "make_coffee", b"{}", "application/json")

    assert answer["result"]["result"] == 0
    assert "spawn_entity" in answer["result"]["error_message"]


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"name": "taken"}, 101),
        ({"name": "no-dash"}, 102),
        ({"name": "9lives"}, 102),
        ({"name": "x" * 65}, 102),
        ({"name": "a/../b"}, 102),
        ({"name": "*"}, 102),
        ({"entity_namespace": "sim"}, 105),
        ({"entity_namespace": "a//b"}, 105),
        ({"entity_namespace": "taken"}, 105),
        ({"entity_resource": {}}, 104),
        ({"entity_resource": {"uri": "no_such_model"}}, 2),
        ({"entity_resource": {"uri": "file:///etc/passwd"}}, 2),
        ({"entity_resource": {"uri": "../../etc/passwd"}}, 2),
        ({"entity_resource": {"resource_string": "not xml"}}, 106),
        ({"entity_resource": {"resource_string": NOT_A_ROBOT}}, 106),
        ({"initial_pose": at(x=1e9)}, 109),
        ({"initial_pose": at(w=1e-9)}, 109),
        ({"initial_pose": {**at(), "header": {"frame_id": "nowhere"}}}, 2),
    ],
)
def test_spawn_is_refused_with_its_code(
    session: zenoh.Session, fields: dict[str, object], code: int
) -> None:
    found, message = spawn(session, **fields)

    assert found == code, message
    assert message
    assert "\n" not in message


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_spawn_is_refused_when_a_number_is_not_finite(server: Server, number: float) -> None:
    done = server.zensim("spawn", "box_bot", "-n", "r", "-x", str(number))

    assert done.returncode == 2
    assert done.stderr.startswith("zensim spawn: ")


def test_zero_quaternion_is_identity_with_a_warning(session: zenoh.Session) -> None:
    request = {
        "name": "zero",
        "entity_resource": {"uri": "box_bot"},
        "initial_pose": at(x=50.0, z=0.06, w=0.0),
    }

    answer = ask(session, "spawn_entity", json.dumps(request).encode(), "application/json")

    assert answer["result"]["result"] == 1
    assert any("all-zero quaternion" in entry["reason"] for entry in answer["report"])


@pytest.mark.parametrize("size", [9_000_000, 17_000_000])
def test_description_is_refused_when_it_is_too_large(
    server: Server, tmp_path: Path, size: int
) -> None:
    path = tmp_path / "large.urdf"
    path.write_text(f"<robot name='r'><!--{'x' * size}--><link name='a'/></robot>")

    done = server.zensim("spawn", str(path), "--name", "large")

    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "xml.size: " in done.stderr


def test_server_keeps_running_when_a_message_exceeds_the_limit(session: zenoh.Session) -> None:
    replies = session.get("sim/default/spawn_entity", payload=b"{" * (65 << 20), timeout=1.0)

    assert not [reply for reply in replies if reply.ok]


def test_agent_keeps_running_when_cmd_vel_is_malformed(
    server: Server, session: zenoh.Session
) -> None:
    server.zensim("spawn", "box_bot", "--name", "r7", "-x", "20")
    with running_agents(server, "r7"):
        driver = robot(server.bus, "r7")
        for payload in (*GARBAGE, b'{"linear": {"x": 1e999}}', b'{"linear": {"x": NaN}}'):
            session.put("r7/cmd_vel", payload)

        start = driver.now().pose.pose.position.x
        eventually(lambda: _has_moved(driver, start), 10.0, "moving")


def _has_moved(driver: Robot, start: float) -> bool:
    driver.command(0.3)
    return driver.now().pose.pose.position.x > start + 0.1


def test_malformed_drive_batches_are_dropped_and_counted(session: zenoh.Session) -> None:
    for payload in GARBAGE:
        session.put("sim/default/drive/nobody/command", payload)

    def dropped() -> bool:
        answer = ask(session, "stats", b"{}", "application/json")
        return bool(answer["dropped"] >= len(GARBAGE))

    eventually(dropped, 5.0, "counting")


def test_command_fails_when_no_server_is_running() -> None:
    endpoint = free_endpoint()

    for command in (
        ("spawn", "box_bot", "--wait", "0.3"),
        ("list",),
        ("delete", "r1"),
        ("echo", "r1/odom"),
        ("drive", "r1", "0.1", "0"),
        ("agent", "r1", "--wait", "0.3"),
    ):
        done = zensim(*command, "--connect", endpoint)

        assert done.returncode == 4, command
        assert done.stderr.startswith(f"zensim {command[0]}: ")
        assert done.stderr.count("\n") == 1


def test_second_server_is_refused_when_the_port_is_taken(server: Server) -> None:
    done = zensim("serve", "--listen", server.endpoint)

    assert done.returncode == 1
    assert server.endpoint in done.stderr
    assert done.stderr.count("\n") == 1


def test_second_server_of_a_world_is_refused(server: Server) -> None:
    done = zensim("serve", "--connect", server.endpoint)

    assert done.returncode == 1
    assert "zensim serve: " in done.stderr
    assert done.stderr.count("\n") == 1


def test_other_world_joins_the_same_router(server: Server) -> None:
    with running("serve", "--connect", server.endpoint, "--world-name", "other"):
        SimClient(server.bus, "other", timeout_s=START_S).wait_for_server(START_S)
        done = server.zensim("spawn", "box_bot", "-n", "o1", "--world-name", "other")

        assert done.returncode == 0, done.stderr
        assert "o1" not in server.client.entities()


def test_default_endpoint_is_loopback() -> None:
    assert DEFAULT_ENDPOINT == "tcp/127.0.0.1:7447"
