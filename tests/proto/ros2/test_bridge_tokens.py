"""Tokens of a bridge are those of zenoh-bridge-ros2dds."""

from zensim.proto.ros2.bridge_tokens import BridgeRoute, make_bridge_token, make_route_token


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
