"""A drive whose numbers the links contradict is used as written, and the contradiction is told."""

import pytest

from tests.sim_server.description.robots import (
    FRAME,
    SIZES,
    a_cart,
    a_collision,
    a_drive,
    a_joint,
    a_link,
    a_robot,
    a_wheel,
    an_inertial,
    reasons,
    report_of,
)
from zensim.proto.messages.model_messages import DiffDrive
from zensim.sim_server.description.urdf.urdf_parser import read_urdf


def noted(*parts: str) -> list[str]:
    return [reason.removeprefix("plugin 'p': ") for reason in suspicious(a_cart(*parts))]


def suspicious(text: str) -> list[str]:
    return reasons(report_of(text), "suspicious")


def test_nothing_is_noted_when_drive_and_links_agree() -> None:
    assert noted(a_drive()) == []


def test_diameter_is_noted_and_used_when_it_is_not_the_wheels() -> None:
    model = read_urdf(a_cart(a_drive(sizes=SIZES.replace("0.2", "0.1"))))

    assert isinstance(model.drive, DiffDrive)
    assert model.drive.pairs[0].diameter_m == 0.1
    assert reasons(model.report, "suspicious") == [
        f"plugin 'p': wheel_diameter 0.1 m, but the wheel of '{side}_joint' has 0.2 m; "
        "used as written"
        for side in ("left", "right")
    ]


def test_separation_is_noted_when_it_is_not_that_of_the_wheels() -> None:
    assert noted(a_drive(sizes=SIZES.replace("0.4", "0.5"))) == [
        "wheel_separation 0.5 m, but 'left_joint' and 'right_joint' are 0.4 m apart; "
        "used as written"
    ]


@pytest.mark.parametrize("separation", ["0.385", "0.415"])
def test_separation_is_not_noted_when_it_is_close(separation: str) -> None:
    assert noted(a_drive(sizes=SIZES.replace("0.4", separation))) == []


def test_sides_are_noted_when_left_is_right() -> None:
    swapped = "<left_joint>right_joint</left_joint><right_joint>left_joint</right_joint>"

    assert noted(a_drive(wheels=swapped)) == [
        "left_joint 'right_joint' is on the right side: turns are reversed"
    ]


def test_axis_is_noted_when_it_points_to_the_right() -> None:
    text = a_robot(
        a_link("base", an_inertial()),
        a_wheel("left", 0.2, axis="0 -1 0"),
        a_wheel("right", -0.2),
        a_drive(),
    )

    assert suspicious(text) == [
        "plugin 'p': the axis of 'left_joint' points to -y: it rolls backward"
    ]


def test_diameter_is_not_noted_when_no_collision_is_round() -> None:
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


def test_base_frame_may_be_a_frame_that_is_fixed_to_the_root() -> None:
    foot = a_link("foot") + a_joint("f", ("base", "foot"))

    assert noted(foot, a_drive(frame=FRAME.replace("base<", "foot<"))) == []


@pytest.mark.parametrize(
    ("frame", "fault"), [("ghost", "is no link"), ("left", "moves on the root link")]
)
def test_base_frame_is_noted_when_it_is_not_fixed_to_the_root(frame: str, fault: str) -> None:
    assert noted(a_drive(frame=FRAME.replace("base<", f"{frame}<"))) == [
        f"robot_base_frame '{frame}' {fault}; it stands for 'base'"
    ]
