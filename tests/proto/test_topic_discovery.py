"""Topics by what programs announce."""

from zensim.proto.ros2.liveliness_tokens import AnnouncedEndpoint
from zensim.proto.ros2.qos_profiles import Qos
from zensim.proto.topic_discovery import TopicEndpoint, TopicFacts, merge_endpoints

SERVICE = "SS"


def an_endpoint(kind: str, key: str, node: str = "/r1/agent") -> AnnouncedEndpoint:
    return AnnouncedEndpoint(kind, key, node, "nav_msgs/msg/Odometry", Qos(depth=5))


def test_endpoints_of_a_topic_are_one_entry() -> None:
    found = merge_endpoints(
        [
            an_endpoint("MP", "r1/odom"),
            None,
            an_endpoint("MS", "r1/odom", "/rviz"),
            an_endpoint("MP", "r2/odom", "/r2/agent"),
        ]
    )

    ends = [
        TopicEndpoint(node, "nav_msgs/msg/Odometry", "reliable", "volatile", 5)
        for node in ("/r1/agent", "/rviz", "/r2/agent")
    ]
    assert found == [
        TopicFacts("r1/odom", "nav_msgs/msg/Odometry", (ends[0],), (ends[1],)),
        TopicFacts("r2/odom", "nav_msgs/msg/Odometry", (ends[2],)),
    ]


def test_services_and_topics_of_the_root_are_left_out() -> None:
    endpoints = [an_endpoint(SERVICE, "r1/get_parameters"), an_endpoint("MP", "clock"), None]

    assert merge_endpoints(endpoints) == []
