"""Predicted motions of each ordered drive: on level ground they are as commanded."""

import math

import msgspec
import pytest

from tests.models import an_arm
from tests.sim_server.description.plugins.driven_robots import (
    BALLS,
    ORDERED_ROBOTS,
    a_car,
    a_diff_robot,
    a_four_wheeler,
    read_driven,
)
from tests.sim_server.description.robots import a_joint, a_link, an_inertial, mentions
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.messages.drive_messages import DiffDrive, SteeringDrive
from zensim.sim_server.description.ground_friction import GroundFriction
from zensim.sim_server.description.motion_prediction import (
    limit_position,
    predict_motion,
    predict_nominal_motions,
)

STRAIGHT, TURN, ARC = (0.2, 0.0, 0.0), (0.0, 0.0, 0.5), (0.2, 0.0, 0.2)


@pytest.mark.parametrize("name", ORDERED_ROBOTS)
def test_robot_whose_wheels_roll_is_predicted_to_move_as_commanded(name: str) -> None:
    text, order = ORDERED_ROBOTS[name]
    model = read_driven(text, order=parse_drive_order(order))
    friction = GroundFriction(model)

    straight, turn = (
        predict_motion(model, command, friction)
        for command in (STRAIGHT, ARC if isinstance(model.drive, SteeringDrive) else TURN)
    )

    assert straight.nominal == pytest.approx(STRAIGHT, abs=1e-6)
    assert straight.twist == pytest.approx(straight.nominal, abs=1e-3)
    assert turn.nominal[2] == pytest.approx(turn.command[2])
    assert turn.twist == pytest.approx(turn.nominal, abs=2e-3)
    assert not [entry for entry in model.report if entry.status == "predicted"]


def test_swapped_wheels_are_predicted_to_turn_the_robot_the_other_way() -> None:
    model = read_driven(a_diff_robot(BALLS), order=parse_drive_order("diff:right,left"))

    (reason,) = (entry.reason for entry in model.report if entry.status == "predicted")

    assert "-1.00" in reason
    assert "'right', its left wheel, is on the right" in reason


def test_wheelbase_that_is_not_that_of_the_links_is_named_as_the_cause() -> None:
    _, order = ORDERED_ROBOTS["car"]
    load = a_link("load", an_inertial("20")) + a_joint(
        "hold", ("base_link", "load"), inside='<origin xyz="0.4 0 0"/>'
    )
    model = read_driven(a_car(load), order=parse_drive_order(f"{order},0.4,0.2,0.4"))

    (reason,) = (entry.reason for entry in model.report if entry.status == "predicted")

    assert "its axles are 0.6 m apart, the drive's wheelbase is 0.4 m" in reason


def test_robot_that_drags_as_much_as_it_drives_is_not_predicted() -> None:
    _, order = ORDERED_ROBOTS["car"]
    load = a_link("load", an_inertial("9")) + a_joint(
        "hold", ("base_link", "load"), inside='<origin xyz="0.6 0 0"/>'
    )
    stiff = a_car(load)
    for side in ("left", "right"):
        joint = f'<joint name="front_{side}" type='
        stiff = stiff.replace(f'{joint}"continuous"', f'{joint}"fixed"')

    model = read_driven(stiff, order=parse_drive_order(order))

    assert mentions(model.report, "predicted", "driving", "not predicted")


def test_weak_wheels_that_hardly_differ_are_predicted_to_stand_when_told_to_turn() -> None:
    text = a_four_wheeler()
    for name in ("fl", "rl"):
        head, link, tail = text.partition(f'<link name="{name}_tyre"')
        text = head + link + tail.replace('radius="0.1"', 'radius="0.10001"', 1)
    model = read_driven(text, order=parse_drive_order("diff:fl+rl,fr+rr"))
    assert isinstance(model.drive, DiffDrive)
    weak = msgspec.structs.replace(model.drive, max_torque_nm=1.0)
    model = msgspec.structs.replace(model, drive=weak)

    turn = predict_motion(model, TURN, GroundFriction(model))

    assert turn.ground.motion.is_converged
    assert turn.twist == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


def a_narrow_car(limit: float) -> str:
    """Make a car whose steering joints turn by up to a limit [rad]."""
    return a_car().replace('lower="-0.7" upper="0.7"', f'lower="{-limit}" upper="{limit}"')


def test_turn_of_a_car_is_predicted_within_what_its_steering_joints_allow() -> None:
    """0.3 rad of steering: a turn rate of 0.3 rad/s took 0.73 rad of a wheelbase of 0.6 m."""
    _, order = ORDERED_ROBOTS["car"]
    model = read_driven(a_narrow_car(0.5), order=parse_drive_order(order))

    _, turn = predict_nominal_motions(model)

    assert turn.command == pytest.approx((0.2, 0.0, 0.2 * math.tan(0.3) / 0.6))
    assert turn.twist[2] == pytest.approx(turn.command[2], rel=0.01)
    assert not mentions(model.report, "predicted", "driving", "turns")


@pytest.mark.parametrize(
    ("kind", "lower", "upper", "found"),
    [
        ("revolute", -0.5, 0.4, 0.4),
        ("revolute", 0.1, 0.1, 0.1),
        ("revolute", 1.0, -1.0, 5.0),
        ("continuous", -0.5, 0.4, 5.0),
    ],
)
def test_position_is_kept_within_limits_unless_there_are_none(
    kind: str, lower: float, upper: float, found: float
) -> None:
    joint = msgspec.structs.replace(
        an_arm("revolute").joints[0], kind=kind, lower=lower, upper=upper
    )

    assert limit_position(joint, 5.0) == found
