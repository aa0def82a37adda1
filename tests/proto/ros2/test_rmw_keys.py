import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk.keyexpr import topic_keyexpr

from zensim.proto.messages import standard_messages
from zensim.proto.ros2.rmw_keys import (
    NO_HASH,
    DataKey,
    check_domain,
    make_data_key,
    mangle_name,
    parse_data_key,
    parse_dds_type,
    qualify_name,
)
from zensim.proto.ros2.type_hash import hash_type


@pytest.mark.parametrize(
    ("name", "chunk"),
    [("/", "%"), ("/box_bot0", "%box_bot0"), ("/box_bot0/odom", "%box_bot0%odom")],
)
def test_name_is_mangled(name: str, chunk: str) -> None:
    assert mangle_name(name) == chunk


def test_no_name_is_mangled_as_the_root() -> None:
    assert mangle_name("") == "%"


@pytest.mark.parametrize("namespace", ["", "/"])
def test_name_in_the_root_has_one_slash(namespace: str) -> None:
    assert qualify_name(namespace, "clock") == "/clock"


def test_name_is_qualified_by_its_namespace() -> None:
    assert qualify_name("team/r1", "odom") == qualify_name("/team/r1", "/odom") == "/team/r1/odom"


@pytest.mark.parametrize(
    "dds", ["", "a::b", "a::msg::dds::B_", "a::msg::dds_::B", "::msg::dds_::B_"]
)
def test_ros_type_is_empty_for_an_invalid_dds_name(dds: str) -> None:
    assert not parse_dds_type(dds)


ODOM = (
    "0/box_bot0/odom/nav_msgs::msg::dds_::Odometry_/"
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
)
CMD_VEL = (
    "0/box_bot0/cmd_vel/geometry_msgs::msg::dds_::Twist_/"
    "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
)


@pytest.mark.parametrize(
    ("name", "kind", "key"),
    [
        ("/box_bot0/odom", standard_messages.Odometry, ODOM),
        ("box_bot0/cmd_vel", standard_messages.Twist, CMD_VEL),
    ],
)
def test_data_key_keeps_the_slashes_of_the_name(
    name: str, kind: type[standard_messages.Odometry | standard_messages.Twist], key: str
) -> None:
    assert make_data_key(0, name, kind.ros_type, hash_type(kind)) == key


def test_data_key_is_what_another_implementation_writes() -> None:
    ours = make_data_key(7, "/team/r1/odom", standard_messages.Odometry.ros_type, NO_HASH)

    assert ours == topic_keyexpr(7, "/team/r1/odom", "nav_msgs::msg::dds_::Odometry_", NO_HASH)


def test_data_key_is_read_as_written() -> None:
    read = parse_data_key(make_data_key(7, "/team/r1/odom", "nav_msgs/msg/Odometry", "RIHS01_3c"))

    assert read == DataKey(7, "/team/r1/odom", "nav_msgs/msg/Odometry", "RIHS01_3c")


@pytest.mark.parametrize(
    "key",
    [
        "",
        "0",
        "x/odom/a::msg::dds_::B_/h",
        "0/odom/Odometry/h",
        "0/a::msg::dds_::B_/h",
        "9999/a/b/c",
    ],
)
def test_parse_data_key_returns_none_for_another_key(key: str) -> None:
    assert parse_data_key(key) is None


@given(st.text(st.sampled_from("0/a:_dsmg"), max_size=60))
def test_parse_data_key_never_fails(key: str) -> None:
    assert parse_data_key(key) is None or key.startswith("0")


@pytest.mark.parametrize("ros_type", ["Odometry", "nav_msgs/Odometry", "a/b/c/d", "nav_msgs//O"])
def test_data_key_refuses_an_invalid_ros_type(ros_type: str) -> None:
    with pytest.raises(ValueError, match="package/msg/Name"):
        make_data_key(0, "/odom", ros_type, NO_HASH)


def test_domain_is_checked() -> None:
    assert check_domain(232) == 232
    with pytest.raises(ValueError, match="233"):
        check_domain(233)
