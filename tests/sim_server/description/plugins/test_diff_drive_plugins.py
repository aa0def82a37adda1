"""Differential drive plug-ins: parameters, defaults, and what the report lists."""

import pytest

from tests.sim_server.description.robots import (
    SIZES,
    WHEELS,
    a_cart,
    a_drive,
    a_joint,
    a_link,
    a_plugin,
    a_wheel,
    an_inertial,
    mentions,
    report_of,
    subjects,
)
from tests.sim_server.description.sdf_robots import PIONEER
from zensim.proto.messages.drive_messages import DiffDrive, Limits, RosBlock, WheelPair
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

PAIR = WheelPair("left_joint", "right_joint", 0.4, 0.2)


def drive_of(*parts: str) -> DiffDrive:
    drive = read_urdf(a_cart(*parts)).drive
    assert isinstance(drive, DiffDrive)
    return drive


def test_drive_has_gazebos_defaults_when_only_wheels_are_given() -> None:
    drive = drive_of(a_drive(sizes="", frame=""))

    assert drive == DiffDrive(
        pairs=(WheelPair("left_joint", "right_joint", 0.34, 0.15),),
        max_torque_nm=5.0,
        max_acceleration=0.0,
        update_rate_hz=100.0,
        odometry_source="world",
        odometry_frame="odom",
        robot_base_frame="base_footprint",
        publish_odom=False,
        publish_odom_tf=False,
        publish_wheel_tf=False,
        covariance_x=1e-5,
        covariance_y=1e-5,
        covariance_yaw=1e-3,
        ros=RosBlock(),
    )


def test_drive_has_the_written_parameters() -> None:
    inside = """
      <ros><namespace>/r1</namespace><remapping>/tf:=/r1/tf</remapping></ros>
      <num_wheel_pairs>1</num_wheel_pairs>
      <max_wheel_torque>20</max_wheel_torque>
      <max_wheel_acceleration>1.5</max_wheel_acceleration>
      <update_rate>0</update_rate>
      <odometry_source>0</odometry_source>
      <odometry_frame>o</odometry_frame>
      <publish_odom>true</publish_odom>
      <publish_odom_tf>1</publish_odom_tf>
      <publish_wheel_tf>True</publish_wheel_tf>
      <covariance_x>0.1</covariance_x>
      <covariance_y>0.2</covariance_y>
      <covariance_yaw>0.3</covariance_yaw>
    """

    model = read_urdf(a_cart(a_drive(inside)))

    assert model.drive == DiffDrive(
        pairs=(PAIR,),
        max_torque_nm=20.0,
        max_acceleration=1.5,
        update_rate_hz=0.0,
        odometry_source="encoder",
        odometry_frame="o",
        robot_base_frame="base",
        publish_odom=True,
        publish_odom_tf=True,
        publish_wheel_tf=True,
        covariance_x=0.1,
        covariance_y=0.2,
        covariance_yaw=0.3,
        ros=RosBlock("r1", ("/tf:=/r1/tf",)),
    )
    assert {entry.status for entry in model.report} == {"applied"}


def test_drive_has_two_pairs_when_it_is_skid_steered() -> None:
    more = a_wheel("left2", 0.2) + a_wheel("right2", -0.2)
    wheels = (
        "<num_wheel_pairs>2</num_wheel_pairs>"
        "<left_joint>left_joint</left_joint><left_joint>left2_joint</left_joint>"
        "<right_joint>right_joint</right_joint><right_joint>right2_joint</right_joint>"
    )

    drive = drive_of(more, a_drive(wheels=wheels, sizes=SIZES + SIZES))

    assert drive.pairs == (PAIR, WheelPair("left2_joint", "right2_joint", 0.4, 0.2))


@pytest.mark.parametrize(
    ("wheels", "values"),
    [
        ("", ("0 left", "0 right", "1 wheel pair")),
        ("<left_joint>left_joint</left_joint>", ("1 left", "0 right", "1 wheel pair")),
        (
            "<num_wheel_pairs>2</num_wheel_pairs><left_joint>left_joint</left_joint>"
            "<right_joint>right_joint</right_joint>",
            ("1 left", "1 right", "2 wheel pair"),
        ),
        (
            "<left_joint>left</left_joint><right_joint>right_joint</right_joint>",
            ("'left'", "left_joint, right_joint"),
        ),
        (
            "<left_joint>left_joint</left_joint><right_joint>left_joint</right_joint>",
            ("'left_joint'", "twice"),
        ),
    ],
)
def test_robot_has_no_drive_when_its_joints_are_inconsistent(
    wheels: str, values: tuple[str, ...]
) -> None:
    model = read_urdf(a_cart(a_drive(wheels=wheels)))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "plugin 'p': ", *values)


def test_robot_has_no_drive_when_a_wheel_joint_is_prismatic() -> None:
    limit = '<limit lower="0" upper="1" effort="1" velocity="1"/>'
    slide = a_link("s", an_inertial()) + a_joint("s_joint", ("base", "s"), "prismatic", limit)
    wheels = "<left_joint>s_joint</left_joint><right_joint>right_joint</right_joint>"

    model = read_urdf(a_cart(slide, a_drive(wheels=wheels)))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "'s_joint'", "prismatic")


@pytest.mark.parametrize("tag", ["wheel_separation", "wheel_diameter"])
@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "wide", "", "1e308", "1e-320"])
def test_drive_is_refused_when_a_length_is_not_positive(tag: str, value: str) -> None:
    with pytest.raises(ModelError, match=tag) as caught:
        read_urdf(a_cart(a_drive(sizes=f"<{tag}>{value}</{tag}>")))

    assert caught.value.slug == f"drive.{tag}"


@pytest.mark.parametrize(
    "tag", ["max_wheel_torque", "max_wheel_acceleration", "update_rate", "covariance_yaw"]
)
@pytest.mark.parametrize("value", ["-1", "nan", "fast"])
def test_drive_is_refused_when_a_number_is_invalid(tag: str, value: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_urdf(a_cart(a_drive(f"<{tag}>{value}</{tag}>")))

    assert caught.value.slug == f"drive.{tag}"


@pytest.mark.parametrize(
    ("inside", "tag", "value"),
    [
        ("<num_wheel_pairs>0</num_wheel_pairs>", "num_wheel_pairs", "0"),
        ("<odometry_source>2</odometry_source>", "odometry_source", "'2'"),
        ("<publish_odom>yes</publish_odom>", "publish_odom", "'yes'"),
        ("<update_rate>1</update_rate><update_rate>2</update_rate>", "update_rate", "2"),
        ("<odometry_frame>my odom</odometry_frame>", "odometry_frame", "'odom'"),
        ("<wheel_seperation>1</wheel_seperation>", "wheel_seperation", "<wheel_separation>"),
        ("<max_acceleration>1</max_acceleration>", "max_acceleration", "<max_wheel_acceleration>"),
        ("<wheel_diameter>9</wheel_diameter>", "wheel_diameter", "2"),
    ],
)
def test_drive_is_used_when_a_tag_is_suspicious(inside: str, tag: str, value: str) -> None:
    model = read_urdf(a_cart(a_drive(inside)))

    assert isinstance(model.drive, DiffDrive)
    assert model.drive.pairs == (PAIR,)
    assert model.drive.odometry_source == "world"
    assert mentions(model.report, "suspicious", f"plugin 'p': <{tag}>: ", value)


def test_default_lengths_are_reported_when_lengths_are_missing() -> None:
    entries = report_of(a_cart(a_drive(sizes="")))

    assert mentions(entries, "suspicious", "<wheel_separation>", "0.34 m")
    assert mentions(entries, "suspicious", "<wheel_diameter>", "0.15 m")


def test_topics_that_gazebo_lacks_are_reported() -> None:
    entries = report_of(a_cart(a_drive("<command_topic>c</command_topic><zebra/>")))

    assert mentions(entries, "applied", "<command_topic>", "<namespace>/c", "gazebo11")
    assert subjects(entries, "unknown") == ["plugin 'p': <zebra>"]


def test_frame_loses_its_leading_slash_when_it_has_one() -> None:
    assert drive_of(a_drive("<odometry_frame>/odom</odometry_frame>")).odometry_frame == "odom"


def test_drive_is_read_when_it_is_spelt_as_in_ros_1() -> None:
    inside = """
      <robotNamespace>r</robotNamespace>
      <leftJoint>left_joint</leftJoint><rightJoint>right_joint</rightJoint>
      <wheelSeparation>0.4</wheelSeparation><wheelDiameter>0.2</wheelDiameter>
      <wheelTorque>2</wheelTorque><odometrySource>encoder</odometrySource>
      <robotBaseFrame>base</robotBaseFrame><commandTopic>cmd_vel</commandTopic>
    """

    model = read_urdf(a_cart(a_plugin("libgazebo_ros_diff_drive.so", inside)))

    assert model.drive == DiffDrive(
        pairs=(PAIR,),
        max_torque_nm=2.0,
        odometry_source="encoder",
        robot_base_frame="base",
        publish_odom=True,
        publish_odom_tf=True,
    )
    assert mentions(model.report, "suspicious", "<leftJoint>", "<left_joint>")


def test_drive_has_two_pairs_when_it_is_the_skid_steer_of_ros_1() -> None:
    more = a_wheel("left2", 0.2) + a_wheel("right2", -0.2)
    inside = """
      <leftFrontJoint>left_joint</leftFrontJoint><rightFrontJoint>right_joint</rightFrontJoint>
      <leftRearJoint>left2_joint</leftRearJoint><rightRearJoint>right2_joint</rightRearJoint>
      <wheelSeparation>0.4</wheelSeparation><wheelDiameter>0.2</wheelDiameter><torque>9</torque>
    """

    drive = drive_of(more, a_plugin("libgazebo_ros_skid_steer_drive.so", inside))

    assert drive.pairs == (PAIR, WheelPair("left2_joint", "right2_joint", 0.4, 0.2))
    assert drive.max_torque_nm == 9.0


@pytest.mark.parametrize(
    ("filename", "tags", "unused"),
    [
        (
            "libgazebo_ros_kobuki.so",
            ("left_wheel_joint_name", "right_wheel_joint_name"),
            "<velocity_command_timeout>0.6</velocity_command_timeout><imu_name>imu</imu_name>",
        ),
        (
            "libgazebo_ros_create.so",
            ("left_wheel_joint", "right_wheel_joint"),
            "<node_namespace>turtlebot_node</node_namespace><base_geom>base_collision</base_geom>",
        ),
    ],
)
def test_drive_is_read_when_it_is_that_of_an_old_turtlebot(
    filename: str, tags: tuple[str, str], unused: str
) -> None:
    left, right = tags
    inside = f"<{left}>left_joint</{left}><{right}>right_joint</{right}>{SIZES}<torque>1</torque>"

    model = read_urdf(a_cart(a_plugin(filename, inside + unused)))

    assert isinstance(model.drive, DiffDrive)
    assert (model.drive.pairs, model.drive.max_torque_nm) == ((PAIR,), 1.0)
    assert model.drive.publish_odom
    assert len(subjects(model.report, "ignored")) == 2


def test_drive_is_refused_as_xacro_when_a_number_is_not_expanded() -> None:
    with pytest.raises(ModelError) as caught:
        read_urdf(a_cart(a_drive(sizes="<wheel_separation>${2 * track}</wheel_separation>")))

    assert (caught.value.slug, caught.value.code) == ("urdf.xacro", SpawnCode.UNSUPPORTED_FORMAT)


TWO, FOUR = "libDiffDrivePlugin.so", "libSkidSteerDrivePlugin.so"
PAIR = WheelPair("left_joint", "right_joint", 0.4, 0.2)


def test_lengths_of_a_classic_plugin_are_measured() -> None:
    model = read_urdf(a_cart(a_plugin(TWO, WHEELS + "<torque>7</torque>")))

    assert model.drive == DiffDrive(
        pairs=(PAIR,),
        max_torque_nm=7.0,
        robot_base_frame="base",
        publish_odom=True,
        publish_odom_tf=True,
    )
    assert subjects(model.report, "suspicious") == []


def test_skid_steer_plugin_has_two_pairs() -> None:
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


def test_base_is_the_link_fixed_to_the_model_frame() -> None:
    drive = read_sdf_model(PIONEER.replace("libgazebo_ros_diff_drive.so", TWO)).drive

    assert drive is not None
    assert drive.robot_base_frame == "chassis"


GZ = "gz-sim-diff-drive-system"


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


def test_diff_drive_of_gazebo_sim_has_the_written_parameters() -> None:
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
