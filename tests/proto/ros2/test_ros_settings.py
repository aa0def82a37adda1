import pytest

from zensim.proto.ros2.ros_settings import RosSettings, parse_ros_settings, to_cli_arguments
from zensim.proto.topic_catalog import select_ros_topics


def test_settings_are_parsed_from_options() -> None:
    read = parse_ros_settings("7", "humble", "global", is_bridged=True)

    assert read == RosSettings(domain=7, has_hashes=False, tf="global", is_bridged=True)
    assert (read.has_global_tf, read.has_namespaced_tf) == (True, False)


def test_ros_is_disabled_by_off() -> None:
    assert parse_ros_settings("off", "jazzy", is_bridged=False).domain is None


def test_settings_are_written_as_options() -> None:
    assert to_cli_arguments(RosSettings()) == ("--ros-domain", "0")
    assert to_cli_arguments(RosSettings(domain=None)) == ("--ros-domain", "off")


@pytest.mark.parametrize(
    ("domain", "distribution", "tf", "refused"),
    [
        ("", "jazzy", "both", "''"),
        ("-1", "jazzy", "both", "'-1'"),
        ("233", "jazzy", "both", "233"),
        ("0", "hydro", "both", "`ros_distro` 'hydro'"),
        ("0", "jazzy", "none", "`tf` 'none'"),
    ],
)
def test_settings_refuse_unknown_values(
    domain: str, distribution: str, tf: str, refused: str
) -> None:
    with pytest.raises(ValueError, match=refused):
        parse_ros_settings(domain, distribution, tf, is_bridged=False)


def test_topics_are_selected_by_name_and_tf_has_its_fixed_part() -> None:
    selected = select_ros_topics(RosSettings(), "odom, tf,cmd_vel")

    assert selected.topics == ("odom", "tf", "cmd_vel", "tf_static")
    assert [selected.has_topic(name) for name in ("odom", "scan", "")] == [True, False, True]
    assert not selected.has_node_services
    assert to_cli_arguments(selected)[-2:] == ("--ros-topics", "odom,tf,cmd_vel,tf_static")


def test_all_topics_are_the_default() -> None:
    assert select_ros_topics(RosSettings(), "") == RosSettings()
    assert RosSettings().has_topic("scan")
    assert RosSettings().has_node_services
    assert select_ros_topics(RosSettings(), "odom,parameters").has_node_services


@pytest.mark.parametrize("names", ["laser", "odom,clock"])
def test_topic_that_robots_do_not_have_is_refused(names: str) -> None:
    with pytest.raises(ValueError, match=names.rsplit(",", maxsplit=1)[-1]):
        select_ros_topics(RosSettings(), names)


def test_root_frame_is_read() -> None:
    read = [
        parse_ros_settings("0", "jazzy", "both", root, is_bridged=False) for root in ("map", "off")
    ]

    assert [one.tf_root for one in read] == ["map", ""]


def test_invalid_root_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="/map"):
        parse_ros_settings("0", "jazzy", "both", "/map", is_bridged=False)
