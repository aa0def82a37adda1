"""ROS 2 topics of robots: an independent client, and rmw_zenoh's rules."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
import zenoh

from tests.integration.processes import Server, eventually, running_agents, serving
from tests.integration.ros_client_process import (
    CallObserver,
    make_service_call,
    result_of,
    run_observer,
    session_of,
)
from tests.integration.ros_interfaces import SPAWN_V2_HASH
from tests.integration.ros_rules import BrokenRule, ReceivedSample, check_bytes, check_topic
from tests.integration.ros_subscriptions import (
    DISCOVERY_S,
    LATCHED,
    ODOMETRY,
    TYPES,
    publishers_of,
    read_late_joining,
    receive_samples,
    tokens,
)
from zensim.proto.exit_codes import ExitCode
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
        with running_agents(found, "r1", "r2", options=("--ros-bridge",)):
            yield found


@pytest.fixture(scope="module")
def ask(server: Server) -> Iterator[CallObserver]:
    with run_observer(server, 0) as found:
        yield found


@pytest.fixture(scope="module")
def session(server: Server) -> Iterator[zenoh.Session]:
    with session_of(server) as found:
        yield found


def test_services_are_listed_with_their_types(ask: CallObserver) -> None:
    listed = ask("services")

    assert "simulation_interfaces/srv/SpawnEntity" in listed["/spawn_entity"]
    assert "gazebo_msgs/srv/SpawnEntity" in listed["/spawn_entity"]


def test_each_robot_is_a_node(ask: CallObserver, session: zenoh.Session) -> None:
    # An agent claims its robot before its node is known.
    (publisher,) = eventually(
        lambda: ask("publishers", topic="/r1/odom") or None, DISCOVERY_S, "a publisher"
    )

    assert (publisher["node_namespace"], publisher["node_name"]) == ("/r1", "agent")

    def list_nodes() -> set[str]:
        return {"/".join(key.split("/")[7:]) for key in tokens(session, "@ros2_lv/0/*/*/*/NN/**")}

    eventually(lambda: {"%/zensim", "%r1/agent", "%r2/agent"} <= list_nodes(), DISCOVERY_S, "nodes")


@pytest.mark.parametrize("topic", LATCHED)
def test_late_rmw_subscriber_receives_the_last_value_once(
    session: zenoh.Session, topic: str
) -> None:
    count = 2 if topic == "/tf_static" else 1

    samples = read_late_joining(session, topic, count)

    assert len(samples) == count
    assert all(
        publisher.is_latched for publisher in check_topic(publishers_of(session, topic), samples)
    )


@pytest.mark.parametrize(
    ("broken", "code"),
    [
        (lambda one: replace(one, attachment=b""), "attachment_size 0"),
        (lambda one: replace(one, attachment=one.attachment[:-1]), "attachment_size 32"),
        (lambda one: replace(one, key=one.key[:-1] + "x"), "unknown_key"),
        (lambda one: replace(one, key=one.key.removeprefix("0")), "unknown_key"),
    ],
)
def test_rules_find_a_broken_sample(
    session: zenoh.Session, broken: Callable[[ReceivedSample], ReceivedSample], code: str
) -> None:
    samples, tokens_found = receive_samples(session, "/r1/odom"), publishers_of(session, "/r1/odom")

    with pytest.raises(BrokenRule, match=code):
        check_topic(tokens_found, [broken(one) for one in samples])


@pytest.mark.parametrize(
    ("broken", "code"),
    [
        (lambda _: [], "unknown_key"),
        (lambda tokens_found: [tokens_found[0].replace("RIHS01_3", "RIHS01_4")], "hash"),
        (lambda tokens_found: [tokens_found[0].replace("::,10:,:,:,,", "::,10")], "qos"),
        (lambda tokens_found: [tokens_found[0].replace("/MP/", "/MS/")], "invalid_token"),
        (lambda tokens_found: [tokens_found[0].replace("%odom", "%odometry")], "unknown_key"),
    ],
)
def test_rules_find_a_broken_token(
    session: zenoh.Session, broken: Callable[[list[str]], list[str]], code: str
) -> None:
    samples, tokens_found = receive_samples(session, "/r1/odom"), publishers_of(session, "/r1/odom")

    with pytest.raises(BrokenRule, match=code):
        check_topic(broken(tokens_found), samples)


def test_rules_find_a_lost_message_and_foreign_bytes(session: zenoh.Session) -> None:
    samples, tokens_found = receive_samples(session, "/r1/odom"), publishers_of(session, "/r1/odom")

    with pytest.raises(BrokenRule, match="sequence"):
        check_topic(tokens_found, [samples[0], samples[2]])
    with pytest.raises(BrokenRule, match="rosbags"):
        check_bytes(ODOMETRY, samples[0].payload + b"\0")


def test_other_domain_lists_no_endpoints(server: Server) -> None:
    with run_observer(server, 7) as ask:
        assert (ask("topics"), ask("services")) == ({}, {})
        assert (
            ask("receive", topic="/clock", kind=TYPES["/clock"], count=1, within_s=1.0, qos="")
            == []
        )


def test_tokens_are_removed_with_the_agent_and_with_the_robot(
    server: Server, session: zenoh.Session
) -> None:
    server.zensim("spawn", "box_bot", "-n", "r3", "-y", "3")
    with running_agents(server, "r3") as agents:
        eventually(lambda: bool(publishers_of(session, "/r3/odom")), DISCOVERY_S, "coming")
        agents["r3"].kill()
        eventually(lambda: not publishers_of(session, "/r3/odom"), DISCOVERY_S, "withdrawal")
    with running_agents(server, "r3"):
        eventually(lambda: bool(publishers_of(session, "/r3/odom")), DISCOVERY_S, "return")
        server.zensim("delete", "r3")
        eventually(
            lambda: not tokens(session, "@ros2_lv/0/*/*/*/*/*/%r3/**"), DISCOVERY_S, "leaving"
        )


def test_bridge_discovers_routes(server: Server) -> None:
    routes = server.bus.list_tokens("@/*/@ros2_lv/**")

    found = {"/".join(route.split("/")[3:6]) for route in routes}
    assert "MP/clock/rosgraph_msgs§msg§Clock" in found
    assert "MP/r1§tf_static/tf2_msgs§msg§TFMessage" in found
    assert "MS/r2§cmd_vel/geometry_msgs§msg§Twist" in found
    assert "SS/spawn_entity/simulation_interfaces§srv§SpawnEntity" in found
    assert "SS/gazebo§spawn_entity/gazebo_msgs§srv§SpawnEntity" in found
    assert [route for route in routes if not ROUTE.fullmatch(route)] == []


@pytest.mark.parametrize("name", ["1robot", "my-robot", "r1 ", "_r1", "r" * 65, "a/b", "a//b", "é"])
def test_name_that_ros_refuses_is_refused_at_the_spawn(server: Server, name: str) -> None:
    response = server.zensim("spawn", "box_bot", "-n", name)

    assert response.returncode == ExitCode.USAGE
    assert repr(name) in response.stderr


@pytest.mark.parametrize("namespace", ["a//b", "a/1b", "a-b/c", "//a", "a/", "~a", "a b", "a/*"])
def test_namespace_that_ros_refuses_is_refused_at_the_spawn(server: Server, namespace: str) -> None:
    response = server.zensim("spawn", "box_bot", "-n", "fine", "--namespace", namespace)

    assert response.returncode == ExitCode.USAGE
    assert repr(namespace) in response.stderr


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
    ask: CallObserver, fields: dict[str, str], code: SpawnCode, slug: str
) -> None:
    resource = {"entity_resource": {"uri": "box_bot"}}
    kind = "simulation_interfaces/srv/SpawnEntity"

    response = make_service_call(ask)("/spawn_entity", kind, SPAWN_V2_HASH, **fields, **resource)

    assert result_of(response) == code
    assert response is not None
    assert slug in str(response["result"])
