"""The <ros> block gives a namespace and remappings."""

import pytest
from lxml import etree

from tests.sim_server.description.robots import mentions, subjects
from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import ReportEntry
from zensim.sim_server.description.plugins.plugin_tags import read_ros_block
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.strict_xml import parse_xml


def read(inside: str) -> tuple[RosBlock, tuple[ReportEntry, ...]]:
    ros = parse_xml(f"<ros>{inside}</ros>", root_tag="ros", slug="urdf")
    assert etree.tostring(ros)
    report = ParseReport()
    block = read_ros_block(ros, subject="plugin 'p'", report=report)
    return block, report.entries()


def test_ros_block_is_empty_when_nothing_is_in_it() -> None:
    assert read("") == (RosBlock(), ())


def test_ros_block_gives_namespace_and_remappings_when_written() -> None:
    inside = (
        "<namespace>/team/r1</namespace>"
        "<remapping>/tf:=/r1/tf</remapping><remapping> cmd_vel:=drive </remapping>"
    )

    assert read(inside) == (RosBlock("team/r1", ("/tf:=/r1/tf", "cmd_vel:=drive")), ())


def test_ros_block_has_no_namespace_when_it_is_the_root() -> None:
    assert read("<namespace>/</namespace>")[0] == RosBlock()


def test_first_namespace_is_used_when_there_are_two() -> None:
    block, entries = read("<namespace>/a</namespace><namespace>/b</namespace>")

    assert block.namespace == "a"
    assert subjects(entries, "suspicious") == ["plugin 'p': <namespace>"]


def test_invalid_namespace_is_left_out() -> None:
    block, entries = read("<namespace>/1 robot</namespace>")

    assert block.namespace == ""
    assert len(subjects(entries, "suspicious")) == 1


@pytest.mark.parametrize("topic", ["my-odom", "a//odom", "/2nd/odom", "~/odom", "/sim/x", "odom/*"])
def test_invalid_remapping_is_left_out(topic: str) -> None:
    block, entries = read(f"<remapping>odom:={topic}</remapping>")

    assert block.remappings == ()
    assert subjects(entries, "suspicious") == ["plugin 'p': <remapping>"]
    assert mentions(entries, "suspicious", repr(topic))


def test_relative_remapping_may_start_with_a_reserved_name() -> None:
    assert read("<remapping>odom:=sim/x</remapping>")[0].remappings == ("odom:=sim/x",)


def test_unusable_tags_of_a_ros_block_are_reported() -> None:
    block, entries = read(
        "<remapping>tf</remapping><remapping>:=a</remapping><argument>x</argument>"
        "<parameter/><qos/><name_space/><zebra/>"
    )

    assert block == RosBlock()
    assert [entry.status for entry in entries] == [
        "suspicious",
        "suspicious",
        "ignored",
        "ignored",
        "ignored",
        "suspicious",
        "unknown",
    ]
