import pytest

from zensim.proto.ros2.settings import RosSettings, arguments_of, ros_settings


def test_settings_are_read_from_words() -> None:
    read = ros_settings("7", "humble", "global", is_bridged=True)

    assert read == RosSettings(domain=7, has_hashes=False, tf="global", is_bridged=True)
    assert (read.has_global_tf, read.has_own_tf) == (True, False)


def test_ros_is_left_out_by_an_explicit_word() -> None:
    assert ros_settings("off", "jazzy", is_bridged=False).domain is None


def test_settings_are_written_as_words() -> None:
    assert arguments_of(RosSettings()) == ("--ros-domain", "0")
    assert arguments_of(RosSettings(domain=None)) == ("--ros-domain", "off")


@pytest.mark.parametrize(
    ("domain", "distribution", "tf", "complaint"),
    [
        ("", "jazzy", "both", "ROS domain '' is not valid; use 0 to 232, or off"),
        ("-1", "jazzy", "both", "ROS domain '-1' is not valid"),
        ("233", "jazzy", "both", "ROS domain 233 is not valid; use 0 to 232"),
        ("0", "hydro", "both", "--ros-distro 'hydro' is unknown; use humble"),
        ("0", "jazzy", "none", "--tf 'none' is unknown; use global, namespaced, both"),
    ],
)
def test_settings_refuse_what_is_unknown(
    domain: str, distribution: str, tf: str, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        ros_settings(domain, distribution, tf, is_bridged=False)


def test_root_frame_is_read() -> None:
    read = [ros_settings("0", "jazzy", "both", root, is_bridged=False) for root in ("map", "off")]

    assert [one.tf_root for one in read] == ["map", ""]


def test_root_frame_that_tf_refuses_is_refused() -> None:
    with pytest.raises(ValueError, match="frame_id '/map' is not valid"):
        ros_settings("0", "jazzy", "both", "/map", is_bridged=False)
