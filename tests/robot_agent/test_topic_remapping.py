"""Where remappings lead."""

import pytest

from zensim.proto.messages.drive_messages import Compat, DiffDrive, RosBlock
from zensim.robot_agent.topic_remapping import (
    resolve_cmd_vel_key,
    resolve_odom_key,
    resolve_topic_key,
)


@pytest.mark.parametrize(
    ("topic", "rules", "expected"),
    [
        ("cmd_vel", (), "team/r1/cmd_vel"),
        ("tf", (), "team/r1/tf"),
        ("cmd_vel", ("cmd_vel:=cmd_vel_nav",), "team/r1/cmd_vel_nav"),
        ("cmd_vel", (" cmd_vel := /joy ",), "joy"),
        ("cmd_vel", ("/team/r1/cmd_vel:=go",), "team/r1/go"),
        ("cmd_vel", ("odom:=o", "cmd_vel:=a", "cmd_vel:=b"), "team/r1/a"),
        ("cmd_vel", ("/cmd_vel:=other",), "team/r1/cmd_vel"),
        ("tf", ("/tf:=/r9/tf",), "r9/tf"),
        ("tf", ("/tf:=tf",), "team/r1/tf"),
        ("tf", ("/tf:=/tf",), "tf"),
        ("tf", ("tf:=elsewhere",), "team/r1/tf"),
        ("odom", ("~/odom:=elsewhere",), "team/r1/odom"),
    ],
)
def test_topic_is_where_its_first_fitting_rule_leads(
    topic: str, rules: tuple[str, ...], expected: str
) -> None:
    assert resolve_topic_key("team/r1", topic, RosBlock("ignored", rules)) == expected


@pytest.mark.parametrize("target", ["/sim/default/clock", "a*", "**", "~/odom", "/", "a//b", "$x"])
def test_topic_stays_where_it_is_when_a_rule_leads_to_no_key(target: str) -> None:
    assert resolve_topic_key("r1", "odom", RosBlock("", (f"odom:={target}",))) == "r1/odom"


@pytest.mark.parametrize(
    ("written", "rules", "compat", "expected"),
    [
        ("", (), "fixed", "r1/cmd_vel"),
        ("go", (), "fixed", "r1/go"),
        ("go", (), "gazebo11", "r1/cmd_vel"),
        ("go", ("cmd_vel:=away",), "fixed", "r1/away"),
        ("go", ("go:=away",), "fixed", "r1/away"),
        ("go", ("odom:=away",), "fixed", "r1/go"),
    ],
)
def test_commands_are_heard_where_the_drive_says_unless_it_is_gazebos(
    written: str, rules: tuple[str, ...], compat: Compat, expected: str
) -> None:
    drive = DiffDrive(command_topic=written, ros=RosBlock("", rules), compat=compat)

    assert resolve_cmd_vel_key("r1", drive) == expected


def test_odometry_is_told_where_the_drive_says() -> None:
    assert resolve_odom_key("r1", DiffDrive(odometry_topic="o")) == "r1/o"
    assert resolve_odom_key("r1", DiffDrive()) == "r1/odom"
