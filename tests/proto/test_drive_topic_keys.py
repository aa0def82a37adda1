"""Remapped topic keys."""

import pytest

from zensim.proto.drive_topic_keys import resolve_cmd_vel_key, resolve_odom_key, resolve_topic_key
from zensim.proto.messages.drive_messages import Compat, DiffDrive, RosBlock


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
def test_topic_key_follows_the_first_matching_rule(
    topic: str, rules: tuple[str, ...], expected: str
) -> None:
    assert resolve_topic_key("team/r1", topic, RosBlock("ignored", rules)) == expected


@pytest.mark.parametrize("target", ["/sim/default/clock", "a*", "**", "~/odom", "/", "a//b", "$x"])
def test_topic_key_ignores_a_rule_without_a_valid_key(target: str) -> None:
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
def test_cmd_vel_key_is_that_of_the_drive_unless_compat_is_gazebo11(
    written: str, rules: tuple[str, ...], compat: Compat, expected: str
) -> None:
    drive = DiffDrive(command_topic=written, ros=RosBlock("", rules), compat=compat)

    assert resolve_cmd_vel_key("r1", drive) == expected


def test_odom_key_is_that_of_the_drive() -> None:
    assert resolve_odom_key("r1", DiffDrive(odometry_topic="o")) == "r1/o"
    assert resolve_odom_key("r1", DiffDrive()) == "r1/odom"
