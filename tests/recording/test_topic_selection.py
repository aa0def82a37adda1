"""Selected topics: names, wildcards, expressions, and the keys that are subscribed."""

import pytest

from zensim.proto import keys
from zensim.proto.ros2.liveliness_tokens import AnnouncedEndpoint
from zensim.proto.ros2.qos_profiles import Qos
from zensim.proto.topic_catalog import ROBOT_TOPICS, find_robot_topic
from zensim.recording.topic_selection import TopicFilter, TopicSelection, list_keys, list_ros_keys

ALL = TopicSelection(wants_all=True)


@pytest.mark.parametrize(
    ("selection", "accepted", "refused"),
    [
        (TopicSelection(topics=("r1/odom",)), "/r1/odom", "/r2/odom"),
        (TopicSelection(topics=("/*/odom",)), "/r2/odom", "/lab/r2/odom"),
        (TopicSelection(topics=("**/odom",)), "/lab/r2/odom", "/r2/tf"),
        (TopicSelection(regex="^/r[0-9]+/scan"), "/r12/scan", "/cart/scan"),
        (TopicSelection(wants_all=True, exclude_regex="/tf$"), "/r1/odom", "/r1/tf"),
        (TopicSelection(wants_all=True, exclude_topics=("/r1/*",)), "/r2/tf", "/r1/tf"),
    ],
)
def test_filter_decides_by_name(selection: TopicSelection, accepted: str, refused: str) -> None:
    chosen = TopicFilter(selection)

    assert chosen.accepts(accepted)
    assert not chosen.accepts(refused)


SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"


@pytest.mark.parametrize(
    ("selection", "ros_type", "expected"),
    [
        (TopicSelection(types=(SCAN,)), SCAN, True),
        (TopicSelection(types=(SCAN,)), ODOMETRY, False),
        (TopicSelection(types=(SCAN,)), "", False),
        (TopicSelection(types=(SCAN,)), None, True),
        (TopicSelection(types=(SCAN,), topics=("r1/x",)), ODOMETRY, True),
        (TopicSelection(types=(SCAN,), exclude_topics=("r1/x",)), SCAN, False),
        (TopicSelection(topics=("r1/x",), exclude_types=(SCAN,)), SCAN, False),
        (TopicSelection(wants_all=True, exclude_types=(SCAN,)), ODOMETRY, True),
    ],
)
def test_filter_decides_by_type(
    selection: TopicSelection, ros_type: str | None, *, expected: bool
) -> None:
    assert TopicFilter(selection).accepts("/r1/x", ros_type) is expected


def test_types_alone_subscribe_to_topics_of_these_types_only() -> None:
    listed = list_keys(TopicFilter(TopicSelection(types=(ODOMETRY,))), "default", 0)

    assert "**/odom" in listed
    assert all(keys.last_chunk(one) in ("odom", "ground_truth") for one in listed)


@pytest.mark.parametrize(
    ("selection", "said"),
    [
        (TopicSelection(), "`all`"),
        (TopicSelection(regex="("), "--regex"),
        (TopicSelection(types=("Odometry",)), "Odometry"),
        (TopicSelection(topics=("a",), exclude_types=("nav_msgs/Odometry",)), "nav_msgs"),
    ],
)
def test_filter_refuses_nothing_and_invalid_expressions(
    selection: TopicSelection, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        TopicFilter(selection)


def test_keys_of_all_topics_cover_each_topic_of_a_robot_once() -> None:
    listed = list_keys(TopicFilter(ALL), "default", 0)

    for suffix in ROBOT_TOPICS:
        assert sum(keys.intersect(one, f"r1/{suffix}") for one in listed) == 1


def test_commands_are_subscribed_on_keys_of_ros_2_too() -> None:
    key = "7/r1/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_0"

    for selection in (ALL, TopicSelection(topics=("r1/cmd_vel",))):
        with_ros = list_keys(TopicFilter(selection), "default", 7)
        without = list_keys(TopicFilter(selection), "default", None)
        assert any(keys.intersect(one, key) for one in with_ros)
        assert not any(keys.intersect(one, key) for one in without)


def test_events_stats_and_snapshots_of_the_world_belong_to_all_topics() -> None:
    listed = list_keys(TopicFilter(ALL), "lab", 0)

    assert {"sim/lab/events", "sim/lab/stats", "sim/lab/snapshot", "map"} <= set(listed)
    assert not any(keys.intersect(one, "sim/lab/drive_states") for one in listed)


def test_topics_of_other_nodes_are_found_by_their_announcement() -> None:
    chosen = TopicFilter(ALL)
    known = list_keys(chosen, "default", 0)
    announced = [
        AnnouncedEndpoint("MP", "r1/odom", "/r1/agent", "nav_msgs/msg/Odometry", Qos()),
        AnnouncedEndpoint("MP", "r1/odometry", "/r1/agent", "nav_msgs/msg/Odometry", Qos()),
        AnnouncedEndpoint("MS", "chatter", "/listener", "std_msgs/msg/String", Qos()),
    ]

    assert list_ros_keys(chosen, announced, known, 0) == ["0/r1/odometry/*/*"]


def test_topic_of_a_robot_is_the_longest_suffix() -> None:
    found = find_robot_topic("lab/r1/image_raw/compressed")

    assert found is not None
    assert found.name == "image_compressed"
    assert find_robot_topic("r1/plan") is None


@pytest.mark.parametrize(
    "name", ["/" + "a" * 250_000 + "/odom", "/r1" * 100_000, "/" + "*a" * 120, "/**" * 80]
)
def test_long_names_are_compared_without_end_of_stack_or_time(name: str) -> None:
    chosen = TopicFilter(TopicSelection(topics=("*/imu", "*a*b*/x", "**/r2")))

    assert not chosen.accepts(name + "/y")
