"""Tokens and QoS profiles against documented examples and another implementation."""

import pytest
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr

from tests.proto.ros2.token_parser import parse_token
from zensim.proto.ros2.liveliness_tokens import (
    EndpointKind,
    GraphEndpoint,
    GraphNode,
    gid_from_token,
    make_endpoint_token,
    make_node_token,
)
from zensim.proto.ros2.qos_profiles import RELIABLE_10, Qos, write_qos

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
