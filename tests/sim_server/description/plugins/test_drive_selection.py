"""Which drive a robot gets: ordered, of controllers, of plug-ins, or none with advice."""

import pytest

from tests.sim_server.description.plugins.driven_robots import (
    TYRE,
    a_base,
    a_car,
    a_diff_robot,
    a_four_wheeler,
    a_tricycle,
    read_driven,
    reverse_axes,
)
from tests.sim_server.description.plugins.test_control_interfaces import TRANSMISSION
from tests.sim_server.description.robots import a_plugin, a_robot, mentions, subjects
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.messages.drive_messages import (
    DiffDrive,
    DriveOrder,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
)
from zensim.sim_server.errors import ModelError

PLUGIN = a_plugin(
    "libgazebo_ros_diff_drive.so",
    "<left_joint>left</left_joint><right_joint>right</right_joint>"
    "<wheel_separation>0.4</wheel_separation><wheel_diameter>0.2</wheel_diameter>",
)
CONTROLLERS = """
base:
  type: diff_drive_controller/DiffDriveController
  left_wheel: left
  right_wheel: right
  wheel_separation_multiplier: 2.0
"""


def separation(text: str, *controllers: str, order: DriveOrder | None = None) -> float:
    drive = read_driven(text, *controllers, order=order).drive
    assert isinstance(drive, DiffDrive)
    return drive.pairs[0].separation_m


def test_order_wins_over_controllers_and_these_over_plugins() -> None:
    order = parse_drive_order("diff:left,right,0.5")

    assert separation(a_diff_robot(PLUGIN)) == pytest.approx(0.4)
    assert separation(a_diff_robot(PLUGIN), CONTROLLERS) == pytest.approx(0.8)
    assert separation(a_diff_robot(PLUGIN), CONTROLLERS, order=order) == 0.5


def test_plugin_drives_where_no_controller_does() -> None:
    assert separation(a_diff_robot(PLUGIN), "a: b") == pytest.approx(0.4)


def test_replaced_plugin_is_reported() -> None:
    assert mentions(read_driven(a_diff_robot(PLUGIN), CONTROLLERS).report, "ignored", "drive")


def test_robot_with_wheels_and_no_drive_is_told_what_to_type() -> None:
    model = read_driven(a_diff_robot(TRANSMISSION))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "--drive diff:left,right", "--controllers")


def test_robot_whose_wheels_roll_aside_is_told_why_it_has_no_drive() -> None:
    text = a_diff_robot().replace('<axis xyz="0 1 0"/>', '<axis xyz="1 0 0"/>')
    text = text.replace('rpy="1.5707963267948966 0 0"', 'rpy="0 1.5707963267948966 0"')

    report = read_driven(text).report

    assert mentions(report, "suspicious", "no drive", "along y")


def test_advice_gives_the_drive_that_it_names() -> None:
    (entry,) = (e for e in read_driven(a_four_wheeler()).report if e.status == "suspicious")
    option = entry.reason.partition("--drive ")[2].split()[0]

    model = read_driven(a_four_wheeler(), order=parse_drive_order(option))

    assert model.drive is not None
    assert model.drive.wheel_joints == ("fl", "fr", "rl", "rr")
    assert subjects(model.report, "suspicious") == []


@pytest.mark.parametrize(
    ("text", "order"),
    [
        (reverse_axes(a_diff_robot(), "left"), "diff:left,right"),
        (
            reverse_axes(a_car(), "rear_left"),
            "ackermann:rear_left,rear_right,steer_left,steer_right",
        ),
    ],
    ids=["diff", "car"],
)
def test_ordered_wheel_whose_axis_points_to_the_right_turns_backward(text: str, order: str) -> None:
    model = read_driven(text, order=parse_drive_order(order))

    assert model.drive is not None
    assert model.drive.encoder is not None
    left, right = model.drive.encoder.radii_m
    assert (left, right) == pytest.approx((-0.1, 0.1))
    assert mentions(model.report, "applied", "drive", "turn backward", "left")


@pytest.mark.parametrize(
    ("text", "order"),
    [(a_robot(a_base()), DriveOrder()), (a_diff_robot(), DriveOrder("none"))],
    ids=["box", "none ordered"],
)
def test_nothing_is_advised_where_nothing_is_missing(text: str, order: DriveOrder) -> None:
    model = read_driven(text, order=order)

    assert model.drive is None
    assert subjects(model.report, "suspicious") == []


def test_order_of_none_removes_the_drive_of_a_plugin() -> None:
    assert read_driven(a_diff_robot(PLUGIN), order=DriveOrder("none")).drive is None


@pytest.mark.parametrize(
    ("text", "order", "kind"),
    [
        (a_diff_robot(), "diff:left,right", DiffDrive),
        (a_four_wheeler(), "diff:fl+rl,fr+rr", DiffDrive),
        (a_four_wheeler(), "mecanum:fl,fr,rl,rr", OmniDrive),
        (a_four_wheeler(), "omni:fl,fr,rl,rr", OmniDrive),
        (a_car(), "ackermann:rear_left,rear_right,steer_left,steer_right", SteeringDrive),
        (a_tricycle(), "bicycle:rear_left,steer,0,0,0.5", SteeringDrive),
        (a_tricycle(), "tricycle:front,steer", SteeringDrive),
        (a_tricycle(), "tricycle:rear_left,rear_right,steer", SteeringDrive),
        (a_robot(a_base()), "planar", PlanarMove),
    ],
)
def test_every_kind_of_order_gives_its_drive(text: str, order: str, kind: type) -> None:
    model = read_driven(text, order=parse_drive_order(order))

    assert isinstance(model.drive, kind)
    assert model.drive is not None
    assert model.drive.publish_odom
    assert subjects(model.report, "suspicious") == []


def test_mecanum_order_equals_the_controller() -> None:
    drive = read_driven(a_four_wheeler(), order=parse_drive_order("mecanum:fl,fr,rl,rr")).drive

    assert isinstance(drive, OmniDrive)
    first = drive.wheels[0]
    assert (first.ahead, first.left, first.turn) == pytest.approx((10.0, -10.0, -4.5))


def test_omni_order_measures_where_each_wheel_rolls() -> None:
    drive = read_driven(a_four_wheeler(), order=parse_drive_order("omni:fl,fr,rl,rr")).drive

    assert isinstance(drive, OmniDrive)
    first = drive.wheels[0]
    assert (first.ahead, first.left, first.turn) == pytest.approx((10.0, 0.0, -2.0))


@pytest.mark.parametrize(
    "order",
    [
        "diff:left,nobody",
        "diff:left,left",
        "mecanum:left,right",
        "omni:left,right",
        "ackermann:left,right",
        "bicycle:left,right",
        "planar:left",
        "diff",
        "diff:left,right,1e9",
    ],
)
def test_order_that_does_not_fit_the_robot_is_refused(order: str) -> None:
    text = a_diff_robot()

    with pytest.raises((ModelError, ValueError)) as refused:
        read_driven(text, order=parse_drive_order(order))

    assert getattr(refused.value, "slug", "drive.order") == "drive.order"


def test_driven_wheel_that_touches_nothing_is_reported() -> None:
    text = a_diff_robot().replace(f"<collision>{TYRE}</collision>", "", 1)

    model = read_driven(text, order=parse_drive_order("diff:left,right,0.4,0.2"))

    assert mentions(model.report, "suspicious", "'left'", "no collision")
    assert not mentions(model.report, "suspicious", "'right'", "no collision")
