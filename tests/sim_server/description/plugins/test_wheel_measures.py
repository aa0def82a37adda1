"""Wheels that a drive and the links describe differently are reported."""

import pytest

from tests.sim_server.description.robots import (
    SIZES,
    a_cart,
    a_collision,
    a_drive,
    a_joint,
    a_link,
    a_robot,
    a_wheel,
    an_inertial,
    assert_only_fault,
    mentions,
    subjects,
    suspicious,
)
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.sim_server.description.urdf.urdf_parser import read_urdf


def test_diameter_is_used_when_it_differs_from_the_wheels() -> None:
    model = read_urdf(a_cart(a_drive(sizes=SIZES.replace("0.2", "0.1"))))

    assert isinstance(model.drive, DiffDrive)
    assert model.drive.pairs[0].diameter_m == 0.1
    assert len(subjects(model.report, "suspicious")) == 2
    for side in ("left", "right"):
        assert mentions(
            model.report, "suspicious", "wheel_diameter", "0.1 m", f"'{side}_joint'", "0.2 m"
        )


def test_separation_is_reported_when_it_differs_from_the_wheels() -> None:
    assert_only_fault(
        a_cart(a_drive(sizes=SIZES.replace("0.4", "0.5"))),
        *("wheel_separation", "0.5 m", "'left_joint'", "'right_joint'", "0.4 m"),
    )


@pytest.mark.parametrize("separation", ["0.385", "0.415"])
def test_separation_is_not_reported_when_it_is_close(separation: str) -> None:
    assert suspicious(a_cart(a_drive(sizes=SIZES.replace("0.4", separation)))) == []


def test_sides_are_reported_when_left_is_right() -> None:
    swapped = "<left_joint>right_joint</left_joint><right_joint>left_joint</right_joint>"

    assert_only_fault(a_cart(a_drive(wheels=swapped)), "left_joint 'right_joint'")


def test_axis_is_reported_when_it_points_to_the_right() -> None:
    text = a_robot(
        a_link("base", an_inertial()),
        a_wheel("left", 0.2, axis="0 -1 0"),
        a_wheel("right", -0.2),
        a_drive(),
    )

    assert_only_fault(text, "axis of 'left_joint'")


def test_diameter_is_not_reported_when_no_collision_is_round() -> None:
    box = a_collision('<geometry><box size="1 1 1"/></geometry>')
    wheels = [
        a_link(name, an_inertial() + box)
        + a_joint(
            f"{name}_joint",
            ("base", name),
            "continuous",
            f'<origin xyz="0 {y} 0"/><axis xyz="0 1 0"/>',
        )
        for name, y in (("left", 0.2), ("right", -0.2))
    ]

    assert suspicious(a_robot(a_link("base", an_inertial()), *wheels, a_drive())) == []
