import pytest

from zensim.proto.ros2.ros_settings import RosSettings, parse_ros_settings
from zensim.proto.settings.ros_choice import RosChoice, TfChoice
from zensim.proto.topic_catalog import select_ros_topics


def test_settings_are_parsed_from_options() -> None:
    read = parse_ros_settings(
        RosChoice(ros_domain="7", ros_distro="humble", ros_bridge=True), TfChoice(tf="global")
    )

    assert read == RosSettings(domain=7, has_hashes=False, tf="global", is_bridged=True)
    assert (read.has_global_tf, read.has_namespaced_tf) == (True, False)


def test_ros_is_disabled_by_off() -> None:
    assert parse_ros_settings(RosChoice(ros_domain="off")).domain is None


@pytest.mark.parametrize("domain", ["", "-1", "233"])
def test_unknown_domain_is_refused(domain: str) -> None:
    with pytest.raises(ValueError, match=repr(domain).strip("'") or "''"):
        parse_ros_settings(RosChoice(ros_domain=domain))


def test_topics_are_selected_by_name_and_tf_has_its_fixed_part() -> None:
    selected = select_ros_topics(RosSettings(), "odom, tf,cmd_vel")

    assert selected.topics == ("odom", "tf", "cmd_vel", "tf_static")
    assert [selected.has_topic(name) for name in ("odom", "scan", "")] == [True, False, True]
    assert not selected.has_node_services


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
    read = [parse_ros_settings(RosChoice(), TfChoice(tf_root=root)) for root in ("map", "off")]

    assert [one.tf_root for one in read] == ["map", ""]


def test_invalid_root_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="/map"):
        parse_ros_settings(RosChoice(), TfChoice(tf_root="/map"))
