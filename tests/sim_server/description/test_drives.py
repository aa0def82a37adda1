"""Drives other than Gazebo's differential one are read as their plug-ins read them."""

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
    DiffDrive,
    Limits,
    PlanarMove,
    RosBlock,
    TricycleDrive,
    WheelPair,
)
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


def test_planar_move_has_gazebos_defaults() -> None:
    model = read_urdf(a_cart(a_plugin(PLANAR, BASE)))

    assert model.drive == PlanarMove(odometry_rate_hz=20.0, robot_base_frame="base")
    assert model.drive.update_rate_hz == 20.0
    assert model.drive.publish_odom
    assert model.drive.publish_odom_tf
    assert subjects(model.report, "applied") == ["plugin 'p'"] * 2
    assert mentions(model.report, "applied", "friction")


def test_body_that_is_pushed_takes_the_twist_at_once() -> None:
    inside = """
      <odometryRate>50</odometryRate><publishOdometryTf>false</publishOdometryTf>
      <force_x_velocity_p_gain>10000</force_x_velocity_p_gain>
    """

    model = read_urdf(a_cart(a_plugin("libgazebo_ros_force_based_move.so", BASE + inside)))

    assert model.drive == PlanarMove(
        odometry_rate_hz=50.0, robot_base_frame="base", publish_odom_tf=False
    )
    assert len(subjects(model.report, "ignored")) == 1


def test_planar_move_has_what_the_file_says() -> None:
    inside = """
      <ros><remapping>cmd_vel:=go</remapping></ros>
      <update_rate>50</update_rate><publish_rate>10</publish_rate>
      <publish_odom>false</publish_odom><publish_odom_tf>false</publish_odom_tf>
      <odometry_frame>o</odometry_frame><covariance_x>0.5</covariance_x>
    """

    drive = read_urdf(a_cart(a_plugin(PLANAR, BASE + inside))).drive

    assert drive == PlanarMove(
        update_rate_hz=50.0,
        odometry_rate_hz=10.0,
        publish_odom=False,
        publish_odom_tf=False,
        odometry_frame="o",
        robot_base_frame="base",
        covariance_x=0.5,
        ros=RosBlock("", ("cmd_vel:=go",)),
    )


def test_planar_move_is_read_when_it_is_spelt_as_in_ros_1() -> None:
    inside = """
      <commandTopic>move/cmd_vel</commandTopic><odometryTopic>odom</odometryTopic>
      <odometryFrame>o</odometryFrame><odometryRate>5</odometryRate>
      <robotBaseFrame>base</robotBaseFrame>
    """

    drive = read_urdf(a_cart(a_plugin(PLANAR, inside))).drive

    assert drive == PlanarMove(
        odometry_rate_hz=5.0,
        odometry_frame="o",
        robot_base_frame="base",
        command_topic="move/cmd_vel",
    )


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


def test_wheels_of_a_car_are_noted_when_they_touch_as_spheres() -> None:
    entries = report_of(a_car(a_plugin(CAR, CAR_JOINTS + BASE)))

    assert mentions(entries, "applied", "plugin 'p'", "'rl', 'rr', 'fl', 'fr'", "spheres")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (a_car(a_plugin(CAR)), "'rear_left_joint'"),
        (
            a_car(a_plugin(CAR, CAR_JOINTS.replace("fr_steer_joint", "fl_steer_joint"))),
            "'fl_steer_joint'",
        ),
        (a_car(a_plugin(CAR, CAR_JOINTS), tyre=""), "round collision"),
        (
            a_car(a_plugin(CAR, CAR_JOINTS)).replace('xyz="0.3', 'xyz="-0.3'),
            "in one place",
        ),
        (a_trike(a_plugin(TRIKE)), "'front_wheel_joint'"),
    ],
)
def test_robot_has_no_drive_when_its_plugin_would_not_work(text: str, fault: str) -> None:
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


def test_tricycle_has_what_the_file_says() -> None:
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


@pytest.mark.parametrize("filename", [GZ, "libignition-gazebo-diff-drive-system.so"])
def test_diff_drive_of_gazebo_sim_has_its_defaults(filename: str) -> None:
    drive = read_urdf(a_cart(a_plugin(filename, WHEELS))).drive

    assert isinstance(drive, DiffDrive)
    assert drive == DiffDrive(
        pairs=(WheelPair("left_joint", "right_joint", 1.0, 0.4),),
        max_torque_nm=drive.max_torque_nm,
        update_rate_hz=0.0,
        odometry_rate_hz=50.0,
        odometry_source="encoder",
        robot_base_frame="base",
        publish_odom=True,
        publish_odom_tf=True,
    )


def test_diff_drive_of_gazebo_sim_has_what_the_file_says() -> None:
    inside = """
      <wheel_separation>0.4</wheel_separation><wheel_radius>0.1</wheel_radius>
      <odom_publish_frequency>10</odom_publish_frequency>
      <topic>/model/r/cmd_vel</topic><odom_topic>odom</odom_topic><tf_topic>/tf</tf_topic>
      <frame_id>o</frame_id><child_frame_id>base</child_frame_id>
      <max_velocity>2</max_velocity><max_linear_velocity>0.5</max_linear_velocity>
      <min_linear_velocity>-0.2</min_linear_velocity>
      <min_angular_acceleration>-1</min_angular_acceleration><max_jerk>9</max_jerk>
    """

    model = read_urdf(a_cart(a_plugin(GZ, WHEELS + inside)))

    drive = model.drive
    assert isinstance(drive, DiffDrive)
    assert drive.pairs == (WheelPair("left_joint", "right_joint", 0.4, 0.2),)
    assert drive.linear_limits == Limits(min_velocity=-0.2, max_velocity=0.5)
    assert drive.angular_limits == Limits(max_velocity=2.0, min_acceleration=-1.0)
    assert (drive.odometry_frame, drive.odometry_rate_hz) == ("o", 10.0)
    assert (drive.command_topic, drive.odometry_topic) == ("model/r/cmd_vel", "")
    assert len(subjects(model.report, "ignored")) == 2
    assert subjects(model.report, "unknown") == []


@pytest.mark.parametrize(
    ("inside", "rate"),
    [
        ("<odom_publisher_frequency>30</odom_publisher_frequency>", 30.0),
        (
            "<odom_publisher_frequency>30</odom_publisher_frequency>"
            "<odom_publish_frequency>10</odom_publish_frequency>",
            10.0,
        ),
    ],
)
def test_rate_of_gazebo_sims_odometry_is_read_in_either_spelling(inside: str, rate: float) -> None:
    model = read_urdf(a_cart(a_plugin(GZ, WHEELS + inside)))

    assert model.drive is not None
    assert model.drive.odometry_rate_hz == rate
    assert subjects(model.report, "unknown") == []


def test_diff_drive_of_gazebo_sim_is_none_when_its_sides_differ() -> None:
    model = read_urdf(a_cart(a_plugin(GZ, "<left_joint>left_joint</left_joint>")))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "plugin 'p'", "1 left", "0 right")


def test_topic_is_the_usual_one_when_it_is_no_name() -> None:
    model = read_urdf(a_cart(a_plugin(PLANAR, BASE + "<command_topic>a b</command_topic>")))

    assert model.drive is not None
    assert model.drive.command_topic == ""
    assert mentions(model.report, "suspicious", "<command_topic>", "'cmd_vel'")


def test_every_drive_is_told_by_its_kind_on_the_wire() -> None:
    for text in (
        a_cart(a_plugin(PLANAR)),
        a_car(a_plugin(CAR, CAR_JOINTS)),
        a_trike(a_plugin(TRIKE, TRIKE_JOINTS)),
        a_cart(a_plugin(GZ, WHEELS)),
    ):
        model = read_urdf(text)
        assert model.drive is not None
        assert msgspec.json.decode(msgspec.json.encode(model), type=type(model)) == model
