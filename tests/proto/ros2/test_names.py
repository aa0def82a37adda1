import pytest

from zensim.proto.ros2.names import demangled, mangled, qualified, ros_type


@pytest.mark.parametrize(
    ("name", "chunk"),
    [("/", "%"), ("/box_bot0", "%box_bot0"), ("/box_bot0/odom", "%box_bot0%odom")],
)
def test_name_is_mangled_and_back(name: str, chunk: str) -> None:
    assert mangled(name) == chunk
    assert demangled(chunk) == name


def test_no_name_is_mangled_as_the_root() -> None:
    assert mangled("") == "%"


@pytest.mark.parametrize("namespace", ["", "/"])
def test_name_in_the_root_has_one_slash(namespace: str) -> None:
    assert qualified(namespace, "clock") == "/clock"


def test_name_is_qualified_by_its_namespace() -> None:
    assert qualified("team/r1", "odom") == qualified("/team/r1", "/odom") == "/team/r1/odom"


@pytest.mark.parametrize(
    "dds", ["", "a::b", "a::msg::dds::B_", "a::msg::dds_::B", "::msg::dds_::B_"]
)
def test_ros_type_is_empty_for_what_dds_does_not_write(dds: str) -> None:
    assert not ros_type(dds)
