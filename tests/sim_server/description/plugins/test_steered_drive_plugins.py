"""Ackermann and tricycle plug-ins: parameters, defaults and measured lengths."""

import msgspec
import pytest

from tests.sim_server.description.cars import a_car, a_trike
from tests.sim_server.description.robots import (
    WHEELS,
    a_cart,
    a_plugin,
    mentions,
    report_of,
    subjects,
)
from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    SteeringDrive,
    TricycleDrive,
    WheelPair,
)
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

PLANAR = "libgazebo_ros_planar_move.so"
CAR = "libgazebo_ros_ackermann_drive.so"
TRIKE = "libgazebo_ros_tricycle_drive.so"
GZ = "gz-sim-diff-drive-system"
BASE = "<robot_base_frame>base</robot_base_frame>"
CAR_JOINTS = """
  <rear_left_joint>rl_joint</rear_left_joint><rear_right_joint>rr_joint</rear_right_joint>
  <front_left_joint>fl_joint</front_left_joint><front_right_joint>fr_joint</front_right_joint>
  <left_steering_joint>fl_steer_joint</left_steering_joint>
  <right_steering_joint>fr_steer_joint</right_steering_joint>
"""
TRIKE_JOINTS = """
  <steering_joint>front_steer_joint</steering_joint>
  <actuated_wheel_joint>front_joint</actuated_wheel_joint>
  <encoder_wheel_left_joint>left_joint</encoder_wheel_left_joint>
  <encoder_wheel_right_joint>right_joint</encoder_wheel_right_joint>
"""


def test_car_has_the_lengths_of_its_links() -> None:
    inside = "<max_speed>3</max_speed><max_steer>0.5</max_steer><publish_odom>true</publish_odom>"

    model = read_urdf(a_car(a_plugin(CAR, CAR_JOINTS + BASE + inside)))

    drive = model.drive
    assert isinstance(drive, AckermannDrive)
    lengths = (drive.wheelbase_m, drive.track_m, drive.wheel_radius_m)
    assert lengths == pytest.approx((0.6, 0.4, 0.1))
    assert drive.wheel_effort_nm == pytest.approx(10.0 * 9.81 * 0.1 / 2.0)
    assert drive == AckermannDrive(
        rear_left_joint="rl_joint",
        rear_right_joint="rr_joint",
        front_left_joint="fl_joint",
        front_right_joint="fr_joint",
        left_steering_joint="fl_steer_joint",
        right_steering_joint="fr_steer_joint",
        wheel_radius_m=0.1,
        wheelbase_m=drive.wheelbase_m,
        track_m=drive.track_m,
        max_speed=3.0,
        max_steer=0.5,
        max_steering_angle=7.85,
        robot_base_frame="base",
        publish_odom=True,
        wheel_effort_nm=drive.wheel_effort_nm,
        steering_effort_nm=7.0,
    )
    assert mentions(model.report, "applied", "plugin 'p'", "0.6 m", "0.4 m", "0.1 m")


def test_wheels_that_become_spheres_are_reported() -> None:
    text = a_car(a_plugin(CAR, CAR_JOINTS + BASE))
    car = parse_description(text, assets={}, allow_missing=False, compat="fixed").model

    assert mentions(car.report, "applied", "drive", "'rl', 'rr', 'fl', 'fr'", "spheres")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (a_car(a_plugin(CAR)), "'rear_left_joint'"),
        (
            a_car(a_plugin(CAR, CAR_JOINTS.replace("fr_steer_joint", "fl_steer_joint"))),
            "'fl_steer_joint'",
        ),
        (a_car(a_plugin(CAR, CAR_JOINTS), tyre=""), "round collision"),
        (a_car(a_plugin(CAR, CAR_JOINTS)).replace('xyz="0.3', 'xyz="-0.3'), "in one place"),
        (a_trike(a_plugin(TRIKE)), "'front_wheel_joint'"),
    ],
)
def test_robot_has_no_drive_when_its_plugin_is_unusable(text: str, fault: str) -> None:
    model = read_urdf(text)

    assert model.drive is None
    assert mentions(model.report, "suspicious", "no drive", fault)


def test_tricycle_has_gazebos_defaults() -> None:
    drive = read_urdf(a_trike(a_plugin(TRIKE, TRIKE_JOINTS))).drive

    assert isinstance(drive, TricycleDrive)
    assert 0.0 < drive.steering_effort_nm <= 7.0
    assert drive == TricycleDrive(
        steering_joint="front_steer_joint",
        actuated_wheel_joint="front_joint",
        encoder_wheel_left_joint="left_joint",
        encoder_wheel_right_joint="right_joint",
        steering_effort_nm=drive.steering_effort_nm,
    )


def test_tricycle_has_the_written_parameters() -> None:
    inside = """
      <actuated_wheel_diameter>0.2</actuated_wheel_diameter>
      <encoder_wheel_diameter>0.2</encoder_wheel_diameter>
      <wheel_separation>0.4</wheel_separation><odometry_source>0</odometry_source>
      <max_wheel_torque>20</max_wheel_torque><max_wheel_acceleration>2</max_wheel_acceleration>
      <max_wheel_speed_tolerance>0.1</max_wheel_speed_tolerance>
      <max_steering_speed>1</max_steering_speed>
      <max_steering_angle_tolerance>0.02</max_steering_angle_tolerance>
      <publish_odom>true</publish_odom><publish_wheel_joint_state>true</publish_wheel_joint_state>
    """

    model = read_urdf(a_trike(a_plugin(TRIKE, TRIKE_JOINTS + inside)))

    drive = model.drive
    assert isinstance(drive, TricycleDrive)
    assert drive.encoder == WheelPair("left_joint", "right_joint", 0.4, 0.2)
    assert drive.actuators[0].effort == drive.actuators[1].effort == 20.0
    assert (drive.max_acceleration, drive.max_deceleration, drive.speed_tolerance) == (2, 2, 0.1)
    assert (drive.max_steering_speed, drive.angle_tolerance) == (1.0, 0.02)
    assert drive.publish_odom
    assert drive.publish_odom_tf
    assert subjects(model.report, "ignored") == ["plugin 'p': <publish_wheel_joint_state>"]


@pytest.mark.parametrize("value", ["0", "-1", "nan", "wide"])
@pytest.mark.parametrize(
    ("text", "tag"),
    [
        (a_trike(a_plugin(TRIKE, TRIKE_JOINTS + "{}")), "actuated_wheel_diameter"),
        (a_cart(a_plugin(GZ, WHEELS + "{}")), "wheel_radius"),
    ],
)
def test_drive_is_refused_when_a_length_is_not_positive(text: str, tag: str, value: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_urdf(text.replace("{}", f"<{tag}>{value}</{tag}>"))

    assert caught.value.slug == f"drive.{tag}"


ROS1_TRIKE_JOINTS = (
    "<steeringJoint>front_steer_joint</steeringJoint>"
    "<actuatedWheelJoint>front_joint</actuatedWheelJoint>"
    "<encoderWheelLeftJoint>left_joint</encoderWheelLeftJoint>"
    "<encoderWheelRightJoint>right_joint</encoderWheelRightJoint>"
)


def test_tricycle_written_for_ros1_publishes_odometry_and_says_so() -> None:
    model = read_urdf(a_trike(a_plugin(TRIKE, ROS1_TRIKE_JOINTS)))

    assert model.drive is not None
    assert (model.drive.publish_odom, model.drive.publish_odom_tf) == (True, True)
    assert mentions(model.report, "suspicious", "plugin 'p'", "ROS 1", "odom")


@pytest.mark.parametrize(
    ("tag", "written", "wheels"),
    [
        ("actuated_wheel_diameter", "0.15", "'front_joint'"),
        ("encoder_wheel_diameter", "0.15", "'left_joint'"),
        ("wheel_separation", "0.5", "'left_joint' and 'right_joint'"),
    ],
)
def test_size_of_a_tricycle_that_is_not_that_of_its_links_is_reported(
    tag: str, written: str, wheels: str
) -> None:
    fitting = {
        "actuated_wheel_diameter": "0.2",
        "encoder_wheel_diameter": "0.2",
        "wheel_separation": "0.4",
    }

    def write(sizes: dict[str, str]) -> str:
        inside = "".join(f"<{name}>{size}</{name}>" for name, size in sizes.items())
        return a_trike(a_plugin(TRIKE, TRIKE_JOINTS + inside))

    assert not mentions(report_of(write(fitting)), "suspicious", tag)
    assert mentions(report_of(write({**fitting, tag: written})), "suspicious", tag, wheels)


def test_car_with_unequal_rear_wheels_is_reported() -> None:
    text = a_car(a_plugin(CAR, CAR_JOINTS + BASE))
    small = text.replace('radius="0.1"', 'radius="0.08"', 1)

    assert not mentions(report_of(text), "suspicious", "diameter")
    assert mentions(report_of(small), "suspicious", "diameter", "'rl_joint'")


GZ_CAR = "gz-sim-ackermann-steering-system"
GZ_CAR_JOINTS = """
  <left_joint>fl_joint</left_joint><left_joint>rl_joint</left_joint>
  <right_joint>fr_joint</right_joint><right_joint>rr_joint</right_joint>
  <left_steering_joint>fl_steer_joint</left_steering_joint>
  <right_steering_joint>fr_steer_joint</right_steering_joint>
"""
GZ_CAR_SIZES = """
  <wheel_base>0.6</wheel_base><kingpin_width>0.4</kingpin_width>
  <wheel_separation>0.4</wheel_separation><wheel_radius>0.1</wheel_radius>
"""


def test_car_of_gz_sim_drives_its_unsteered_wheels() -> None:
    inside = GZ_CAR_SIZES + "<steering_limit>0.4</steering_limit><max_velocity>2</max_velocity>"

    model = read_urdf(a_car(a_plugin(GZ_CAR, GZ_CAR_JOINTS + inside)))

    drive = model.drive
    assert isinstance(drive, SteeringDrive)
    assert drive.traction == ("rl_joint", "rr_joint")
    assert drive.steering == ("fl_steer_joint", "fr_steer_joint")
    assert drive.passive == ("fl_joint", "fr_joint")
    sizes = (drive.wheelbase_m, drive.traction_track_m, drive.steering_track_m)
    assert (*sizes, drive.wheel_radius_m) == pytest.approx((0.6, 0.4, 0.4, 0.1))
    assert (drive.max_steer, drive.max_speed) == (0.4, 2.0)
    assert (drive.publish_odom, drive.odometry_rate_hz) == (True, 50.0)
    assert subjects(model.report, "suspicious") == []
    assert mentions(model.report, "ignored", "plugin 'p'", "fl_joint and fr_joint")


def test_car_of_gz_sim_has_its_default_lengths_and_is_told_that_they_do_not_fit() -> None:
    model = read_urdf(a_car(a_plugin(GZ_CAR, GZ_CAR_JOINTS)))

    drive = model.drive
    assert isinstance(drive, SteeringDrive)
    sizes = (drive.wheelbase_m, drive.traction_track_m, drive.steering_track_m)
    assert (*sizes, drive.wheel_radius_m, drive.max_steer) == (1.0, 1.0, 0.8, 0.2, 0.5)
    assert mentions(model.report, "suspicious", "plugin 'p'", "0.2 m")


@pytest.mark.parametrize(
    "text",
    [
        a_plugin(GZ_CAR, GZ_CAR_JOINTS + "<steering_only>true</steering_only>"),
        a_plugin(GZ_CAR, GZ_CAR_JOINTS.replace("rr_joint", "nothing")),
        a_plugin(GZ_CAR, "<left_joint>rl_joint</left_joint>"),
    ],
)
def test_car_of_gz_sim_without_usable_joints_has_no_drive(text: str) -> None:
    model = read_urdf(a_car(text))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "plugin 'p'", "no drive")


def test_every_drive_is_decoded_by_its_tag() -> None:
    for text in (
        a_cart(a_plugin(PLANAR)),
        a_car(a_plugin(CAR, CAR_JOINTS)),
        a_trike(a_plugin(TRIKE, TRIKE_JOINTS)),
        a_cart(a_plugin(GZ, WHEELS)),
    ):
        model = read_urdf(text)
        assert model.drive is not None
        assert msgspec.json.decode(msgspec.json.encode(model), type=type(model)) == model
