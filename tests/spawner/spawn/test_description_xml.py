"""Parsing of descriptions, and namespaces of drives."""

import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.names import InvalidName
from zensim.spawner.spawn.description_xml import (
    DescriptionError,
    ElementCounts,
    add_namespace,
    blank_comments,
    count_elements,
    parse_description,
    remove_namespace,
)


@pytest.mark.parametrize(
    "text",
    [
        "<robot><link/></robot>",
        "\ufeff\n<!-- -- a -- --><robot><link/></robot>",
        "<robot><link/><!-- b -- --></robot>",
        "<robot><link/><a:b c:d='1'/></robot>",
    ],
)
def test_description_is_parsed_like_gazebo(text: str) -> None:
    assert parse_description(text)[0].tag == "link"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<robot>",
        "<robot><!-- -- --></robt>",
        "<robot><!-- --",
        "<robot>&lol;</robot>",
        "<world/>",
        "<!DOCTYPE robot><robot/>",
        '<!-- -- --><!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>',
        "<robot>" * 70 + "</robot>" * 70,
        "<robot>\ud800</robot>",
    ],
)
def test_invalid_text_is_refused(text: str) -> None:
    with pytest.raises(DescriptionError):
        parse_description(text)


def test_blanked_comments_keep_line_numbers() -> None:
    assert blank_comments("a<!-- b\n -- \n-->c\n<!---->") == "a\n\nc\n"


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("<robot><link/><gazebo><link/></gazebo><link/><joint/></robot>", ElementCounts(2, 1)),
        (
            "<sdf><model><link><sensor/></link><model><link/><joint/></model></model></sdf>",
            ElementCounts(2, 1),
        ),
    ],
)
def test_links_and_joints_are_counted(text: str, written: ElementCounts) -> None:
    assert count_elements(parse_description(text)) == written


NAMES = st.from_regex(r"/?[a-z][a-z0-9_]{0,5}(/[a-z]{1,3})?", fullmatch=True).filter(
    lambda name: name.strip("/").split("/")[0] not in ("sim", "world")
)


def make_drive(ros: str = "<ros/>", filename: str = "libgazebo_ros_diff_drive.so") -> str:
    return f'<gazebo><plugin name="d" filename="{filename}">{ros}<x/></plugin></gazebo>'


def make_robot(*parts: str) -> str:
    return f'<robot name="r"><link name="a"/>{"".join(parts)}</robot>'


def find_ros_entries(text: str) -> list[tuple[str, str]]:
    return [
        (child.tag, child.text or "") for ros in ET.fromstring(text).iter("ros") for child in ros
    ]


TEN = [("namespace", "/r10"), ("remapping", "/tf:=/r10/tf")]


@pytest.mark.parametrize(
    "ros",
    [
        "<ros/>",
        "",
        "<ros><!-- only a comment --></ros>",
        "<ros><namespace>/old</namespace><namespace>/older</namespace></ros>",
        "<ros><remapping>/tf:=/old/tf</remapping><remapping> tf := x</remapping></ros>",
    ],
)
@pytest.mark.parametrize("namespace", ["r10", "/r10"])
def test_drive_has_one_namespace_and_one_tf_remapping(ros: str, namespace: str) -> None:
    assert find_ros_entries(add_namespace(make_robot(make_drive(ros)), namespace)) == TEN


@pytest.mark.parametrize(
    "ros",
    ["<ros/>", "", "<ros><namespace>/old</namespace><remapping>/tf:=/old/tf</remapping></ros>"],
)
def test_removal_leaves_no_namespace(ros: str) -> None:
    assert find_ros_entries(remove_namespace(make_robot(make_drive(ros)))) == []


def test_removal_keeps_other_entries_of_the_ros_block() -> None:
    ros = "<ros><namespace>/old</namespace><remapping>cmd_vel:=drive</remapping></ros>"

    found = find_ros_entries(remove_namespace(make_robot(make_drive(ros))))

    assert found == [("remapping", "cmd_vel:=drive")]


def test_addition_keeps_other_entries_of_the_ros_block() -> None:
    ros = "<ros><remapping>cmd_vel:=drive</remapping><argument>a</argument></ros>"

    assert find_ros_entries(add_namespace(make_robot(make_drive(ros)), "r10")) == [
        ("remapping", "cmd_vel:=drive"),
        ("argument", "a"),
        *TEN,
    ]


@pytest.mark.parametrize(
    "plugin",
    [
        make_drive(filename="libgazebo_ros_skid_steer_drive.so"),
        '<gazebo><plugin name="differential_drive_controller" filename="libmine.so"/></gazebo>',
    ],
)
def test_drive_is_found_by_file_or_name(plugin: str) -> None:
    assert find_ros_entries(add_namespace(make_robot(plugin), "r10")) == TEN


def test_all_drives_get_the_namespace() -> None:
    assert (
        find_ros_entries(add_namespace(make_robot(make_drive(), make_drive("")), "r10")) == TEN * 2
    )


def test_text_without_drive_is_unchanged() -> None:
    text = make_robot('<gazebo><plugin name="imu" filename="libimu.so"><ros/></plugin></gazebo>')

    assert add_namespace(text, "r10") is text


@given(NAMES, NAMES)
def test_second_namespace_replaces_the_first(first: str, second: str) -> None:
    text = make_robot(make_drive())

    assert add_namespace(add_namespace(text, first), second) == add_namespace(text, second)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", "XML"),
        ("<robot>", "XML"),
        ("<robot>&nbsp;</robot>", "XML"),
        ("<robot>\ud800</robot>", "XML"),
        ("<html/>", "<html>"),
        ("<!DOCTYPE robot><robot/>", "DOCTYPE"),
        ('<!DOCTYPE r [<!ENTITY a "aa">]><robot>&a;</robot>', "DOCTYPE"),
        (f"<robot>{'<a>' * 70}{'</a>' * 70}</robot>", "64"),
    ],
)
def test_invalid_text_is_refused_in_one_line(text: str, value: str) -> None:
    with pytest.raises(DescriptionError, match=value) as caught:
        add_namespace(text, "r10")

    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("namespace", ["", "/", "1r", "a b", "sim/r", "<ros>"])
def test_invalid_namespace_is_refused(namespace: str) -> None:
    with pytest.raises(InvalidName):
        add_namespace(make_robot(make_drive()), namespace)


@pytest.mark.parametrize("head", ['<?xml version="1.0" encoding="utf-8"?>', "\ufeff", "\n"])
def test_text_may_start_with_blanks_and_declarations(head: str) -> None:
    assert find_ros_entries(add_namespace(head + make_robot(make_drive()), "r10")) == TEN


def test_default_namespace_of_the_root_is_removed() -> None:
    text = '<robot xmlns="http://drake.mit.edu" name="n"><link name="b"/></robot>'

    root = parse_description(text)

    assert (root.tag, [child.tag for child in root]) == ("robot", ["link"])
