"""Tokens and QoS profiles against documented examples and another implementation."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

from tests.proto.ros2.token_parser import parse_token, read_qos
from zensim.proto.ros2.liveliness_tokens import (
    DEFAULT_QOS,
    INFINITE_NS,
    LATCHED,
    RELIABLE_10,
    RMW_DURABILITY,
    RMW_HISTORY,
    RMW_LIVELINESS,
    RMW_RELIABILITY,
    BridgeRoute,
    EndpointKind,
    GraphEndpoint,
    GraphNode,
    Qos,
    gid_from_token,
    make_bridge_token,
    make_endpoint_token,
    make_node_token,
    make_route_token,
    write_qos,
)


def test_bridge_token_names_the_session() -> None:
    assert make_bridge_token("1a2b") == "@/1a2b/@ros2_lv"


def test_route_of_a_topic_has_its_qos_in_the_numbers_of_dds() -> None:
    route = BridgeRoute(
        zid="1a2b",
        kind="MP",
        key="box_bot0/odom",
        ros_type="nav_msgs/msg/Odometry",
        type_hash="RIHS01_3cc9",
    )

    assert make_route_token(route) == (
        "@/1a2b/@ros2_lv/MP/box_bot0§odom/nav_msgs§msg§Odometry/:1:0:0,10:typehash=RIHS01_3cc9;"
    )


def test_route_of_a_latched_topic_equals_that_of_a_bridge() -> None:
    route = BridgeRoute(
        zid="1",
        kind="MP",
        key="rosout",
        ros_type="rcl_interfaces/msg/Log",
        durability="transient_local",
        depth=1000,
    )

    assert make_route_token(route) == "@/1/@ros2_lv/MP/rosout/rcl_interfaces§msg§Log/:1:1:0,1000"


def test_route_of_a_service_has_no_qos() -> None:
    route = BridgeRoute(
        zid="1a2b", kind="SS", key="spawn_entity", ros_type="simulation_interfaces/srv/SpawnEntity"
    )

    assert make_route_token(route) == (
        "@/1a2b/@ros2_lv/SS/spawn_entity/simulation_interfaces§srv§SpawnEntity"
    )


PROFILES = {
    "::,10:,:,:,,": RELIABLE_10,
    "2::,5:,:,:,,": Qos(reliability="best_effort", depth=5),
    ":1:,1:,:,:,,": LATCHED,
    "::,:,:,:,,": DEFAULT_QOS,
    "2:1:2,:,:,:,,": Qos(
        reliability="best_effort", durability="transient_local", history="keep_all"
    ),
    "::,1:1,500000000:,:2,0,3": Qos(
        depth=1, deadline_ns=1_500_000_000, liveliness="manual_by_node", lease_ns=3
    ),
}
SPANS = st.one_of(st.just(INFINITE_NS), st.integers(0, 9_000_000_000_000_000_000))
ANY_QOS = st.builds(
    Qos,
    reliability=st.sampled_from(sorted(RMW_RELIABILITY)),
    durability=st.sampled_from(sorted(RMW_DURABILITY)),
    history=st.sampled_from(sorted(RMW_HISTORY)),
    depth=st.integers(0, 1 << 63),
    deadline_ns=SPANS,
    lifespan_ns=SPANS,
    liveliness=st.sampled_from(sorted(RMW_LIVELINESS)),
    lease_ns=SPANS,
)


@pytest.mark.parametrize("text", PROFILES)
def test_qos_is_written_with_its_defaults_empty(text: str) -> None:
    assert write_qos(PROFILES[text]) == text
    assert read_qos(text) == PROFILES[text]


@given(ANY_QOS)
def test_qos_is_read_as_written(qos: Qos) -> None:
    assert read_qos(write_qos(qos)) == qos


def test_qos_is_read_by_another_implementation() -> None:
    theirs = QosProfile.decode(write_qos(Qos(reliability="best_effort", depth=5)))
    latched = QosProfile.decode(write_qos(LATCHED))

    assert (theirs.reliability, theirs.history_depth) == (QosReliability.BEST_EFFORT, 5)
    assert (latched.durability, latched.history_depth) == (QosDurability.TRANSIENT_LOCAL, 1)


STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ADD_HASH = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
TALKER = GraphNode(domain=0, zid="8b20917502ee955ac4476e0266340d5c", number=0, name="talker")
SERVER = GraphNode(
    domain=0, zid="f9980ee0495eaafb3e38f0d19e2eae12", number=0, name="add_two_ints_server"
)
ROBOT = GraphNode(domain=7, zid="ab12", number=3, namespace="/box_bot0", name="agent")
CHATTER = GraphEndpoint(
    node=TALKER,
    number=10,
    kind="MP",
    name="/chatter",
    ros_type="std_msgs/msg/String",
    type_hash=STRING_HASH,
    qos=Qos(depth=7),
)
ADD = GraphEndpoint(
    node=SERVER,
    number=10,
    kind="SS",
    name="/add_two_ints",
    ros_type="example_interfaces/srv/AddTwoInts",
    type_hash=ADD_HASH,
    qos=RELIABLE_10,
)
CHATTER_TOKEN = (
    "@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
    f"std_msgs::msg::dds_::String_/{STRING_HASH}/::,7:,:,:,,"
)
ADD_TOKEN = (
    "@ros2_lv/0/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
    f"example_interfaces::srv::dds_::AddTwoInts_/{ADD_HASH}/::,10:,:,:,,"
)
ROBOT_TOKEN = "@ros2_lv/7/ab12/3/3/NN/%/%box_bot0/agent"


def a_topic_of(kind: EndpointKind) -> GraphEndpoint:
    return GraphEndpoint(
        node=ROBOT,
        number=4,
        kind=kind,
        name="/box_bot0/odom",
        ros_type="nav_msgs/msg/Odometry",
        type_hash="RIHS01_3cc9",
    )


@pytest.mark.parametrize(("endpoint", "token"), [(CHATTER, CHATTER_TOKEN), (ADD, ADD_TOKEN)])
def test_endpoint_token_is_that_of_the_design_document(endpoint: GraphEndpoint, token: str) -> None:
    assert make_endpoint_token(endpoint) == token
    assert parse_token(token) == endpoint


def test_node_token_names_the_node_twice_by_its_number() -> None:
    assert make_node_token(ROBOT) == ROBOT_TOKEN
    assert parse_token(ROBOT_TOKEN) == ROBOT


@pytest.mark.parametrize("kind", ["MP", "MS", "SS", "SC"])
def test_tokens_are_what_another_implementation_writes(kind: EndpointKind) -> None:
    endpoint = a_topic_of(kind)
    node = NodeEntity(7, "ab12", 3, "agent", "/box_bot0")
    theirs = EndpointEntity(
        node,
        4,
        EntityKind(kind),
        "/box_bot0/odom",
        "nav_msgs::msg::dds_::Odometry_",
        "RIHS01_3cc9",
        write_qos(endpoint.qos),
    )

    assert make_node_token(ROBOT) == node_liveliness_keyexpr(node)
    assert make_endpoint_token(endpoint) == endpoint_liveliness_keyexpr(theirs)
    assert parse_token(make_endpoint_token(endpoint)) == endpoint


def test_node_token_keeps_levels_of_namespace_and_enclave() -> None:
    node = GraphNode(domain=0, zid="1", number=0, namespace="/a/b", name="n", enclave="/c/d")

    token = make_node_token(node)

    assert token == "@ros2_lv/0/1/0/0/NN/%c%d/%a%b/n"
    assert parse_token(token) == GraphNode(
        domain=0, zid="1", number=0, namespace="/a/b", name="n", enclave="c/d"
    )


def test_gid_is_the_hash_of_the_token() -> None:
    assert gid_from_token(CHATTER_TOKEN).hex() == "eb85fa883b7846dc448a4501890ad062"
