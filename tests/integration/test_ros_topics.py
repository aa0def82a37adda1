"""ROS 2 topics of robots: an independent client, and rmw_zenoh's rules."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
import zenoh

from tests.integration.processes import Server, driven, eventually, serving
from tests.integration.ros_client_process import Do, asking, observing, result_of, session_of
from tests.integration.ros_interfaces import SPAWN_V2_HASH
from tests.integration.ros_rules import BrokenRule, Heard, check_bytes, check_topic
from tests.integration.ros_subscriptions import (
    LATCHED,
    ODOMETRY,
    SIGHT_S,
    TYPES,
    captured,
    publishers_of,
    read_late_joining,
    tokens,
)
from zensim.proto.messages.result_messages import SpawnCode

NAME = "[A-Za-z_][A-Za-z0-9_]*(?:§[A-Za-z_][A-Za-z0-9_]*)*"
TYPE = "[a-z0-9_]+§(?:msg|srv|action)§[A-Z][A-Za-z0-9]*"
QOS = "K?:[01]:[01]:[01],[0-9]+(?::typehash=RIHS01_[0-9a-f]{64};)?"
ROUTE = re.compile(
    f"@/[0-9a-f]+/@ros2_lv(?:/(?:M[PS]/{NAME}/{TYPE}/{QOS}|[SA][SC]/{NAME}/{TYPE}))?"
)
"""Tokens of zenoh-bridge-ros2dds, from its source: § for slashes, QoS as DDS numbers."""


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving("--ros-domain", "0", "--ros-bridge") as found:
        for name in ("r1", "r2"):
            found.zensim("spawn", "box_bot", "-n", name, "-y", name[1:])
        with driven(found, "r1", "r2", options=("--ros-bridge",)):
            yield found


@pytest.fixture(scope="module")
def ask(server: Server) -> Iterator[Do]:
    with observing(server, 0) as found:
        yield found


@pytest.fixture(scope="module")
def session(server: Server) -> Iterator[zenoh.Session]:
    with session_of(server) as found:
        yield found


def test_services_are_listed_with_their_types(ask: Do) -> None:
    listed = ask("services")

    assert "simulation_interfaces/srv/SpawnEntity" in listed["/spawn_entity"]
    assert "gazebo_msgs/srv/SpawnEntity" in listed["/spawn_entity"]


def test_each_robot_is_a_node(ask: Do, session: zenoh.Session) -> None:
    (publisher,) = ask("publishers", topic="/r1/odom")

    assert (publisher["node_namespace"], publisher["node_name"]) == ("/r1", "agent")
    nodes = {"/".join(key.split("/")[7:]) for key in tokens(session, "@ros2_lv/0/*/*/*/NN/**")}
    assert {"%/zensim", "%r1/agent", "%r2/agent"} <= nodes


@pytest.mark.parametrize("topic", LATCHED)
def test_late_rmw_subscriber_receives_the_last_value_once(
    session: zenoh.Session, topic: str
) -> None:
    count = 2 if topic == "/tf_static" else 1

    came = read_late_joining(session, topic, count)

    assert len(came) == count
    assert all(
        publisher.is_latched for publisher in check_topic(publishers_of(session, topic), came)
    )


@pytest.mark.parametrize(
    ("broken", "complaint"),
    [
        (lambda one: replace(one, attachment=b""), "0 bytes are attached"),
        (lambda one: replace(one, attachment=one.attachment[:-1]), "32 bytes"),
        (lambda one: replace(one, key=one.key[:-1] + "x"), "nobody announced"),
        (lambda one: replace(one, key=one.key.removeprefix("0")), "nobody announced"),
    ],
)
def test_rules_find_a_broken_sample(
    session: zenoh.Session, broken: Callable[[Heard], Heard], complaint: str
) -> None:
    came, told = captured(session, "/r1/odom"), publishers_of(session, "/r1/odom")

    with pytest.raises(BrokenRule, match=complaint):
        check_topic(told, [broken(one) for one in came])


@pytest.mark.parametrize(
    ("broken", "complaint"),
    [
        (lambda _: [], "nobody announced"),
        (lambda told: [told[0].replace("RIHS01_3", "RIHS01_4")], "hash"),
        (lambda told: [told[0].replace("::,10:,:,:,,", "::,10")], "qos"),
        (lambda told: [told[0].replace("/MP/", "/MS/")], "no token"),
        (lambda told: [told[0].replace("%odom", "%odometry")], "nobody announced"),
    ],
)
def test_rules_find_a_broken_token(
    session: zenoh.Session, broken: Callable[[list[str]], list[str]], complaint: str
) -> None:
    came, told = captured(session, "/r1/odom"), publishers_of(session, "/r1/odom")

    with pytest.raises(BrokenRule, match=complaint):
        check_topic(broken(told), came)


def test_rules_find_a_lost_message_and_foreign_bytes(session: zenoh.Session) -> None:
    came, told = captured(session, "/r1/odom"), publishers_of(session, "/r1/odom")

    with pytest.raises(BrokenRule, match="came after"):
        check_topic(told, [came[0], came[2]])
    with pytest.raises(BrokenRule, match="rosbags"):
        check_bytes(ODOMETRY, came[0].payload + b"\0")


def test_other_domain_lists_no_endpoints(server: Server) -> None:
    with observing(server, 7) as ask:
        assert (ask("topics"), ask("services")) == ({}, {})
        assert (
            ask("hear", topic="/clock", kind=TYPES["/clock"], count=1, within_s=1.0, qos="") == []
        )


def test_tokens_are_removed_with_the_agent_and_with_the_robot(
    server: Server, session: zenoh.Session
) -> None:
    server.zensim("spawn", "box_bot", "-n", "r3", "-y", "3")
    with driven(server, "r3") as agents:
        eventually(lambda: bool(publishers_of(session, "/r3/odom")), SIGHT_S, "coming")
        agents["r3"].kill()
        eventually(lambda: not publishers_of(session, "/r3/odom"), SIGHT_S, "withdrawal")
    with driven(server, "r3"):
        eventually(lambda: bool(publishers_of(session, "/r3/odom")), SIGHT_S, "return")
        server.zensim("delete", "r3")
        eventually(lambda: not tokens(session, "@ros2_lv/0/*/*/*/*/*/%r3/**"), SIGHT_S, "leaving")


def test_bridge_discovers_routes(server: Server) -> None:
    routes = server.bus.list_tokens("@/*/@ros2_lv/**")

    told = {"/".join(route.split("/")[3:6]) for route in routes}
    assert "MP/clock/rosgraph_msgs§msg§Clock" in told
    assert "MP/r1§tf_static/tf2_msgs§msg§TFMessage" in told
    assert "MS/r2§cmd_vel/geometry_msgs§msg§Twist" in told
    assert "SS/spawn_entity/simulation_interfaces§srv§SpawnEntity" in told
    assert "SS/gazebo§spawn_entity/gazebo_msgs§srv§SpawnEntity" in told
    assert [route for route in routes if not ROUTE.fullmatch(route)] == []


@pytest.mark.parametrize("name", ["1robot", "my-robot", "r1 ", "_r1", "r" * 65, "a/b", "a//b", "é"])
def test_name_that_ros_refuses_is_refused_at_the_spawn(server: Server, name: str) -> None:
    answer = server.zensim("spawn", "box_bot", "-n", name)

    assert answer.returncode != 0
    assert "is not valid" in answer.stderr


@pytest.mark.parametrize("namespace", ["a//b", "a/1b", "a-b/c", "//a", "a/", "~a", "a b", "a/*"])
def test_namespace_that_ros_refuses_is_refused_at_the_spawn(server: Server, namespace: str) -> None:
    answer = server.zensim("spawn", "box_bot", "-n", "fine", "--namespace", namespace)

    assert answer.returncode != 0
    assert "is not valid" in answer.stderr


@pytest.mark.parametrize(
    ("fields", "code", "slug"),
    [
        ({"name": "my-robot"}, SpawnCode.NAME_INVALID, "name.invalid"),
        ({"name": "2nd"}, SpawnCode.NAME_INVALID, "name.invalid"),
        ({"name": "ok", "entity_namespace": "a//b"}, SpawnCode.NAMESPACE_INVALID, "name.namespace"),
        ({"name": "ok", "entity_namespace": "a-b"}, SpawnCode.NAMESPACE_INVALID, "name.namespace"),
    ],
)
def test_ros_client_receives_code_and_slug_for_refused_names(
    ask: Do, fields: dict[str, str], code: SpawnCode, slug: str
) -> None:
    resource = {"entity_resource": {"uri": "box_bot"}}
    kind = "simulation_interfaces/srv/SpawnEntity"

    answer = asking(ask)("/spawn_entity", kind, SPAWN_V2_HASH, **fields, **resource)

    assert result_of(answer) == code
    assert answer is not None
    assert slug in str(answer["result"])
