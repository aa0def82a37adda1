"""Tokens of nodes and endpoints: sessions, content, removal."""

import re
from collections import Counter

import pytest

from tests.fakes import MemoryBus
from tests.integration.processes import eventually
from tests.proto.ros2.token_parser import parse_token
from zensim.proto.messages.standard_messages import Odometry, String
from zensim.proto.ros2 import ros_graph
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint, GraphNode
from zensim.proto.ros2.qos_profiles import LATCHED
from zensim.proto.ros2.rmw_keys import NO_HASH
from zensim.proto.ros2.ros_graph import MAX_NODES_PER_ID, RosGraph, RosNode, RosTopic
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings

ODOM = RosTopic("r1/odom", Odometry)


def a_node(bus: MemoryBus, settings: RosSettings = RosSettings()) -> RosNode:  # noqa: B008
    node = RosGraph(bus, settings).add_node("r1", "agent")
    assert node is not None
    return node


def parsed(bus: MemoryBus) -> list[GraphNode | GraphEndpoint | None]:
    return [parse_token(key) for key in bus.list_tokens("@ros2_lv/**")]


def test_node_has_a_token_and_one_for_each_endpoint() -> None:
    bus = MemoryBus()
    node = a_node(bus, RosSettings(domain=7))

    node.add_topic_endpoint("MP", ODOM)
    node.add_topic_endpoint("MS", RosTopic("r1/cmd_vel", String))

    first, odom, cmd_vel = parsed(bus)
    assert first == GraphNode(domain=7, zid=bus.zid, number=0, namespace="/r1", name="agent")
    assert isinstance(odom, GraphEndpoint)
    assert (odom.node, odom.number, odom.kind, odom.name) == (first, 1, "MP", "/r1/odom")
    assert odom.type_hash.startswith("RIHS01_3cc97dc7")
    assert isinstance(cmd_vel, GraphEndpoint)
    assert (cmd_vel.number, cmd_vel.kind, cmd_vel.name) == (2, "MS", "/r1/cmd_vel")


def test_latched_topic_is_transient_local() -> None:
    node = a_node(MemoryBus())

    endpoint = node.add_topic_endpoint("MP", RosTopic("tf_static", String, LATCHED))

    assert (endpoint.qos.durability, endpoint.qos.depth) == ("transient_local", 1)


def test_types_have_no_hash_in_humble() -> None:
    node = a_node(MemoryBus(), RosSettings(has_hashes=False))

    assert node.add_topic_endpoint("MP", ODOM).type_hash == NO_HASH
    assert node.data_key(ODOM) == f"0/r1/odom/nav_msgs::msg::dds_::Odometry_/{NO_HASH}"


def test_closed_node_leaves_no_token() -> None:
    bus = MemoryBus()
    node = a_node(bus, RosSettings(is_bridged=True))
    node.add_topic_endpoint("MP", ODOM)

    node.close()

    assert bus.list_tokens("@ros2_lv/**") == []
    assert bus.list_tokens("@/*/@ros2_lv/MP/**") == []


def test_bridge_tokens_are_declared_if_bridged() -> None:
    bus = MemoryBus()
    node = a_node(bus, RosSettings(is_bridged=True))

    node.add_topic_endpoint("MP", ODOM)

    (route,) = bus.list_tokens("@/*/@ros2_lv/MP/**")
    assert route.startswith(f"@/{bus.zid}/@ros2_lv/MP/r1§odom/nav_msgs§msg§Odometry/:1:0:0,10:")
    assert bus.list_tokens("@/*/@ros2_lv") == [f"@/{bus.zid}/@ros2_lv"]


def test_action_has_one_bridge_token() -> None:
    bus = MemoryBus()
    node = a_node(bus, RosSettings(is_bridged=True))

    node.announce_action("simulate_steps", "simulation_interfaces/action/SimulateSteps")
    node.add_topic_endpoint("MP", RosTopic("simulate_steps/_action/status", String, LATCHED))

    assert bus.list_tokens("@/*/@ros2_lv/*/**") == [
        f"@/{bus.zid}/@ros2_lv/AS/simulate_steps/simulation_interfaces§action§SimulateSteps"
    ]
    assert bus.list_tokens("@ros2_lv/0/*/*/*/MP/**") != []


def test_bridge_tokens_are_absent_by_default() -> None:
    bus = MemoryBus()

    a_node(bus).add_topic_endpoint("MP", ODOM)

    assert bus.list_tokens("@/**") == []


def test_no_tokens_are_declared_without_a_domain() -> None:
    bus = MemoryBus()

    assert RosGraph(bus, NO_ROS).add_node("r1", "agent") is None
    assert bus.list_tokens("**") == []


def test_nodes_of_a_large_fleet_have_other_session_ids_and_a_session_of_their_own() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings())
    for number in range(2 * MAX_NODES_PER_ID + 1):
        graph.add_node(f"r{number}", "agent")

    eventually(lambda: len(tokens_of(bus)) == 2 * MAX_NODES_PER_ID + 1, 5.0, "all tokens")

    nodes = [parse_token(token) for token in tokens_of(bus)]
    counts = Counter(node.zid for node in nodes if isinstance(node, GraphNode))
    assert counts.pop(bus.zid) == MAX_NODES_PER_ID
    assert sorted(counts.values()) == [1, MAX_NODES_PER_ID]
    assert all(re.fullmatch("[1-9a-f][0-9a-f]{31}", zid) for zid in counts)
    assert len(bus.opened_sessions) == 1
    graph.close()
    assert tokens_of(bus) == []
    assert bus.opened_sessions[0].is_closed


def tokens_of(bus: MemoryBus) -> list[str]:
    return [
        token
        for session in (bus, *bus.opened_sessions)
        for token in session.list_tokens("@ros2_lv/**")
    ]


def test_closed_graph_leaves_no_token() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings(is_bridged=True))
    for name in ("r1", "r2"):
        node = graph.add_node(name, "agent")
        assert node is not None
        node.add_topic_endpoint("MP", ODOM)

    graph.close()

    assert bus.list_tokens("@ros2_lv/**") == bus.list_tokens("@/**") == []


def test_session_of_a_closed_node_is_used_again() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings())
    for number in range(MAX_NODES_PER_ID + 1):
        node = graph.add_node(f"r{number}", "agent")
        assert node is not None
        node.close()

    assert bus.opened_sessions == []


def add_robots(graph: RosGraph, count: int) -> list[RosNode]:
    nodes = [graph.add_robot(f"r{number}", "agent") for number in range(count)]
    for node in nodes:
        assert node is not None
        node.add_topic_endpoint("MS", RosTopic("cmd_vel", String))
    return [node for node in nodes if node is not None]


@pytest.fixture
def room_for_two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_graph, "MAX_ROBOTS_ANNOUNCED", 2)
    monkeypatch.setattr(ros_graph, "MAX_ROBOTS_ANNOUNCED_LATE", 1)


@pytest.mark.usefixtures("room_for_two")
def test_robots_beyond_a_number_have_no_tokens() -> None:
    bus = MemoryBus()

    nodes = add_robots(RosGraph(bus, RosSettings()), 4)

    assert [node.is_announced for node in nodes] == [True, True, False, False]
    assert len(tokens_of(bus)) == 4


@pytest.mark.usefixtures("room_for_two")
def test_robot_announced_late_has_the_tokens_of_its_endpoints_after_that_of_its_node() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings())
    nodes = add_robots(graph, 5)

    for node in nodes:
        graph.announce_late(node)

    assert [node.is_announced for node in nodes] == [True, True, True, False, False]
    first, second = [parse_token(token) for token in tokens_of(bus)[-2:]]
    assert isinstance(first, GraphNode)
    assert isinstance(second, GraphEndpoint)
    assert (first.namespace, second.node) == ("/r2", first)


@pytest.mark.usefixtures("room_for_two")
def test_closed_robot_makes_room_for_another() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings())
    first, *_, silent = add_robots(graph, 3)

    silent.close()
    before = graph.announced_robots
    first.close()
    first.close()

    assert (before, graph.announced_robots) == (2, 1)
    assert [node.is_announced for node in add_robots(graph, 2)] == [True, False]


def test_robots_beyond_the_first_hundred_nodes_share_nodes() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings())
    robots = add_robots(graph, MAX_NODES_PER_ID + 3)
    eventually(lambda: len(tokens_of(bus)) == 2 * MAX_NODES_PER_ID + 4, 5.0, "all tokens")

    parsed = [parse_token(token) for token in tokens_of(bus)]
    nodes = {one for one in parsed if isinstance(one, GraphNode)}
    endpoints = [one for one in parsed if isinstance(one, GraphEndpoint)]

    assert len(nodes) == MAX_NODES_PER_ID + 1
    assert {one.node for one in endpoints} == nodes
    assert len(endpoints) == len(robots)
    assert robots[-1].full_name == f"/r{MAX_NODES_PER_ID + 2}/agent"


def test_shared_node_leaves_with_its_last_robot() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings())
    *_, first, second = add_robots(graph, MAX_NODES_PER_ID + 2)
    shared = first.shared
    assert shared is not None

    first.close()
    first.close()
    is_closed_early = shared.is_closed
    second.close()

    assert (is_closed_early, shared.is_closed) == (False, True)
    eventually(lambda: len(tokens_of(bus)) == 2 * MAX_NODES_PER_ID, 5.0, "tokens of the others")
    (third,) = add_robots(graph, 1)
    assert third.shared not in {None, shared}
