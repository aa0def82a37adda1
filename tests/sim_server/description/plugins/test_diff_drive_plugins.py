"""Gazebo's own drive plug-ins say no sizes: they are those of the wheels."""

import pytest

from tests.sim_server.description.robots import (
    WHEELS,
    a_cart,
    a_joint,
    a_link,
    a_plugin,
    a_wheel,
    an_inertial,
    mentions,
    subjects,
)
from tests.sim_server.description.sdf_robots import PIONEER
from zensim.proto.messages.drive_messages import DiffDrive, WheelPair
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

TWO, FOUR = "libDiffDrivePlugin.so", "libSkidSteerDrivePlugin.so"
PAIR = WheelPair("left_joint", "right_joint", 0.4, 0.2)


def test_two_wheels_are_as_large_and_as_far_apart_as_they_are() -> None:
    model = read_urdf(a_cart(a_plugin(TWO, WHEELS + "<torque>7</torque>")))

    assert model.drive == DiffDrive(
        pairs=(PAIR,),
        max_torque_nm=7.0,
        robot_base_frame="base",
        publish_odom=True,
        publish_odom_tf=True,
    )
    assert subjects(model.report, "suspicious") == []


def test_four_wheels_skid() -> None:
    names = {
        "left_front": "left_joint",
        "left_rear": "l2_joint",
        "right_front": "right_joint",
        "right_rear": "r2_joint",
    }
    inside = "".join(f"<{tag}>{name}</{tag}>" for tag, name in names.items())

    drive = read_urdf(a_cart(a_wheel("l2", 0.3), a_wheel("r2", -0.3), a_plugin(FOUR, inside))).drive

    assert isinstance(drive, DiffDrive)
    assert drive.pairs == (PAIR, WheelPair("l2_joint", "r2_joint", 0.6, 0.2))
    assert drive.max_torque_nm == 5.0


@pytest.mark.parametrize(
    ("inside", "values"),
    [
        ("", ("0 left", "0 right")),
        ("<left_joint>left_joint</left_joint>", ("1 left", "0 right")),
        (WHEELS.replace(">left_joint<", ">ghost<"), ("'ghost'",)),
        (WHEELS.replace(">left_joint<", ">bare_joint<"), ("collision",)),
    ],
)
def test_drive_without_wheels_is_reported(inside: str, values: tuple[str, ...]) -> None:
    bare = a_link("bare", an_inertial()) + a_joint("bare_joint", ("base", "bare"), "continuous")

    model = read_urdf(a_cart(bare, a_plugin(TWO, inside)))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "plugin 'p'", *values)


def test_base_is_the_link_that_hangs_from_the_frame_of_its_model() -> None:
    drive = read_sdf_model(PIONEER.replace("libgazebo_ros_diff_drive.so", TWO)).drive

    assert drive is not None
    assert drive.robot_base_frame == "chassis"
