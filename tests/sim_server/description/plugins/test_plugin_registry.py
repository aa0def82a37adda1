"""Plug-ins are read, or reported as unused or unknown."""

from tests.sim_server.description.robots import (
    a_cart,
    a_drive,
    a_plugin,
    mentions,
    report_of,
    subjects,
)
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

JOINTS = "<joint_name>left_joint</joint_name>"
STATES = "libgazebo_ros_joint_state_publisher.so"


def test_plugins_that_are_read_are_reported() -> None:
    entries = report_of(a_cart(a_drive(), a_plugin(STATES, JOINTS)))

    assert subjects(entries, "applied") == ["plugin 'p'"] * 2
    assert mentions(entries, "applied", "0.4 m", "0.2 m")
    assert mentions(entries, "applied", "joint states", "left_joint")


def test_unused_plugins_are_reported() -> None:
    entries = report_of(
        a_cart(
            a_plugin("libgazebo_ros_control.so", "<robotNamespace>/</robotNamespace>", name="c"),
            a_plugin("libgazebo_ros_ft_sensor.so", name="t"),
        )
    )

    assert subjects(entries, "ignored") == ["plugin 'c'", "plugin 't'"]
    assert mentions(entries, "ignored", "plugin 'c'", "--controllers")


def test_unknown_plugins_are_reported() -> None:
    entries = report_of(a_cart(a_plugin("libmine.so"), "<gazebo><plugin/></gazebo>"))

    assert subjects(entries, "unknown") == ["plugin 'p'", "plugin ''"]
    assert mentions(entries, "unknown", "'libmine.so'")


def test_first_drive_and_publisher_are_used() -> None:
    other = a_plugin(STATES, "<joint_name>right_joint</joint_name>")

    model = read_urdf(
        a_cart(
            a_drive("<max_wheel_torque>1</max_wheel_torque>"),
            a_drive("<max_wheel_torque>2</max_wheel_torque>"),
            a_plugin(STATES, JOINTS),
            other,
        )
    )

    assert isinstance(model.drive, DiffDrive)
    assert model.drive.max_torque_nm == 1.0
    assert model.joint_state is not None
    assert model.joint_state.joints == ("left_joint",)
    assert subjects(model.report, "suspicious") == ["plugin 'p'"] * 2
    assert mentions(model.report, "suspicious", "drive")
    assert mentions(model.report, "suspicious", "joint state")


def test_second_drive_is_used_when_the_first_is_unusable() -> None:
    model = read_urdf(a_cart(a_drive(wheels=""), a_drive()))

    assert model.drive is not None


def test_plugins_beyond_a_hundred_are_left_out() -> None:
    entries = report_of(a_cart(*[a_plugin("libmine.so", name=f"p{i}") for i in range(103)]))

    assert subjects(entries, "unknown") == ["plugin 'p0', 'p1', 'p2' and 97 more"]
    assert subjects(entries, "suspicious") == ["plugins"]
    assert mentions(entries, "suspicious", "103", "100")
