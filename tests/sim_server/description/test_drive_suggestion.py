"""The option that would drive a robot without a drive."""

import pytest

from tests.sim_server.description.plugins.driven_robots import (
    BALLS,
    a_base,
    a_car,
    a_diff_robot,
    a_four_wheeler,
    a_steering,
    a_tyre,
    read_driven,
)
from tests.sim_server.description.plugins.test_wheel_guess import OMNI_BASE, RING_ROBOT, SUSPENDED
from tests.sim_server.description.robots import a_link, a_robot, an_inertial, mentions
from zensim.proto.drive_orders import format_drive_order
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.sim_server.description.drive_suggestion import TriedDrive, suggest_drive, try_drive
from zensim.sim_server.description.joint_reduction import LumpedModel
from zensim.sim_server.description.urdf.urdf_parser import read_urdf


def a_car_whose_front_wheels_are_drawn_only() -> str:
    """Make a car with a steered wheel between its front wheels, which alone carries."""
    text = a_car(
        a_steering("steer_middle", 0.6, 0.0),
        a_tyre("front_middle", 0.0, 0.0, parent="steer_middle_knuckle"),
    )
    for side in ("front_left", "front_right"):
        head, link, tail = text.partition(f'<link name="{side}_tyre"')
        text = head + link + tail.replace("collision>", "visual>", 2)
    return text


def advise(text: str) -> str:
    """Find the option that the report of a robot suggests; empty without one."""
    reasons = [one.reason for one in read_driven(text).report if one.subject == "drive"]
    return next((one.partition("--drive ")[2].split(" ")[0] for one in reasons), "")


@pytest.mark.parametrize(
    ("text", "option"),
    [
        (a_diff_robot(BALLS), "diff:left,right"),
        (a_car(), "ackermann:rear_left,rear_right,steer_left,steer_right"),
        (OMNI_BASE, "omni:front,left,right"),
        (RING_ROBOT, "planar"),
        (SUSPENDED, "diff:left,right"),
        (a_robot('<link name="base"/>'), ""),
        (a_car_whose_front_wheels_are_drawn_only(), "tricycle:front_middle,steer_middle"),
    ],
    ids=["diff", "car", "omni", "ring", "suspension", "no wheels", "front wheels for show"],
)
def test_report_names_a_drive_that_moves_the_robot(text: str, option: str) -> None:
    assert advise(text) == option


def test_suggested_drive_is_tried_before_it_is_named() -> None:
    model = read_urdf(a_four_wheeler())
    lumped = LumpedModel(model.links, model.joints, model.frames)

    found = suggest_drive(model, lumped)

    assert found is not None
    assert found.speed == pytest.approx(1.0, abs=0.01)
    assert found.turn is not None
    assert 0.2 < found.turn < 0.8, "it skids"


def test_drive_of_wheels_in_the_air_ranks_below_one_that_carries() -> None:
    text = a_four_wheeler(BALLS).replace('xyz="0.25 0.2 0"', 'xyz="0.25 0.2 0.03"')
    text = text.replace('xyz="0.25 -0.2 0"', 'xyz="0.25 -0.2 0.03"')
    model = read_urdf(text)
    lumped = LumpedModel(model.links, model.joints, model.frames)

    front = try_drive(model, DriveOrder("diff", ("fl", "fr")), lumped)
    rear = try_drive(model, DriveOrder("diff", ("rl", "rr")), lumped)

    assert front is not None
    assert rear is not None
    assert rear.rank < front.rank


def test_drive_that_cannot_turn_the_robot_ranks_last() -> None:
    order = DriveOrder("diff", ("left", "right"))
    stuck, unknown, skids = (
        TriedDrive(order, speed, turn) for speed, turn in ((1.0, 0.0), (None, None), (1.0, 0.2))
    )

    assert skids.rank < unknown.rank < stuck.rank


def test_drive_of_wheels_on_legs_is_not_predicted() -> None:
    legs = "".join(
        a_link(f"{side}_leg", an_inertial())
        + f'<joint name="{side}_hip" type="revolute"><parent link="base_link"/>'
        f'<child link="{side}_leg"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        + a_tyre(side, 0.0, y, parent=f"{side}_leg")
        for side, y in (("left", 0.2), ("right", -0.2))
    )
    model = read_urdf(a_robot(a_base(), BALLS, legs))
    lumped = LumpedModel(model.links, model.joints, model.frames)

    found = suggest_drive(model, lumped)

    assert found is not None
    assert (found.order.joints, found.speed) == (("left", "right"), None)


def test_drive_of_joints_that_are_no_wheels_is_not_tried() -> None:
    model = read_urdf(a_diff_robot())
    lumped = LumpedModel(model.links, model.joints, model.frames)

    assert try_drive(model, DriveOrder("diff", ("left", "none")), lumped) is None


def test_wheels_that_nothing_turns_are_reported() -> None:
    report = read_driven(RING_ROBOT).report

    assert mentions(report, "suspicious", "no drive")
    assert mentions(report, "suspicious", format_drive_order(DriveOrder("planar")))


@pytest.mark.parametrize(("kind", "has_wheels"), [("continuous", True), ("revolute", False)])
def test_joint_with_limits_and_a_velocity_interface_is_no_wheel(
    kind: str,
    has_wheels: bool,  # noqa: FBT001
) -> None:
    arm = a_link("arm", an_inertial()) + (
        f'<joint name="elbow" type="{kind}"><parent link="base_link"/><child link="arm"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        '<ros2_control name="x" type="system"><joint name="elbow">'
        '<command_interface name="velocity"/></joint></ros2_control>'
    )

    report = read_driven(a_robot(a_base(), arm)).report

    assert mentions(report, "suspicious", "no drive") == has_wheels
