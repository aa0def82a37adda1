"""Drives of the controllers of ros2_controllers and ros_control."""

import math

import pytest

from tests.sim_server.description.plugins.driven_robots import (
    a_car,
    a_diff_robot,
    a_four_steerer,
    a_four_wheeler,
    a_tricycle,
    a_virtual_car,
    read_driven,
)
from tests.sim_server.description.robots import mentions, subjects
from zensim.proto.messages.drive_messages import (
    DiffDrive,
    Limits,
    OmniDrive,
    SteeringDrive,
    WheelPair,
)
from zensim.proto.messages.model_messages import JointStatePublisher, Model
from zensim.sim_server.errors import ModelError

RATE_HZ = 50.0


def a_controller(kind: str, parameters: str) -> str:
    """A file of ROS 2 with one controller and a joint state broadcaster."""
    lines = "\n".join(f"    {line.strip()}" for line in parameters.strip().splitlines())
    return f"""
controller_manager:
  ros__parameters:
    update_rate: {RATE_HZ}
    base: {{type: {kind}}}
base:
  ros__parameters:
{lines}
"""


def a_diff(parameters: str = "") -> str:
    kind = "diff_drive_controller/DiffDriveController"
    return a_controller(kind, f"left_wheel_names: [left]\nright_wheel_names: [right]\n{parameters}")


def diff_of(model: Model) -> DiffDrive:
    assert isinstance(model.drive, DiffDrive)
    return model.drive


def steering_of(model: Model) -> SteeringDrive:
    assert isinstance(model.drive, SteeringDrive)
    return model.drive


def omni_of(model: Model) -> OmniDrive:
    assert isinstance(model.drive, OmniDrive)
    return model.drive


def test_diff_drive_measures_lengths_that_are_missing() -> None:
    drive = diff_of(read_driven(a_diff_robot(), a_diff()))

    (pair,) = drive.pairs
    assert (pair.left_joint, pair.right_joint) == ("left", "right")
    assert (pair.separation_m, pair.diameter_m) == pytest.approx((0.4, 0.2))
    assert (drive.odometry_source, drive.publish_odom) == ("encoder", True)
    assert (drive.update_rate_hz, drive.odometry_rate_hz) == (RATE_HZ, 50.0)


def test_diff_drive_applies_multipliers_without_a_warning() -> None:
    model = read_driven(
        a_diff_robot(),
        a_diff(
            "wheel_separation: 0.4\nwheel_radius: 0.1\nwheel_separation_multiplier: 1.5\n"
            "left_wheel_radius_multiplier: 0.9\nright_wheel_radius_multiplier: 0.9"
        ),
    )

    (pair,) = diff_of(model).pairs
    assert (pair.separation_m, pair.diameter_m) == pytest.approx((0.6, 0.18))
    assert subjects(model.report, "suspicious") == []


def test_diff_drive_reports_lengths_that_differ_from_the_links() -> None:
    model = read_driven(a_diff_robot(), a_diff("wheel_separation: 0.5\nwheel_radius: 0.12"))

    assert diff_of(model).pairs[0] == WheelPair("left", "right", 0.5, 0.24)
    assert mentions(model.report, "suspicious", "wheel_separation", "0.5 m", "0.4 m")
    assert mentions(model.report, "suspicious", "wheel_diameter", "0.24 m", "0.2 m")


def test_diff_drive_has_a_pair_for_each_two_wheels() -> None:
    kind = "diff_drive_controller/DiffDriveController"
    text = a_controller(kind, "left_wheel_names: [fl, rl]\nright_wheel_names: [fr, rr]")

    pairs = diff_of(read_driven(a_four_wheeler(), text)).pairs

    assert [(pair.left_joint, pair.right_joint) for pair in pairs] == [("fl", "fr"), ("rl", "rr")]


def test_settings_of_odometry_are_read() -> None:
    drive = diff_of(
        read_driven(
            a_diff_robot(),
            a_diff(
                "publish_rate: 20\nodom_frame_id: odom2\nbase_frame_id: base_link\n"
                "enable_odom_tf: false\npose_covariance_diagonal: [1, 2, 3, 4, 5, 6]\n"
                "twist_covariance_diagonal: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]"
            ),
        )
    )

    assert (drive.odometry_rate_hz, drive.odometry_frame) == (20.0, "odom2")
    assert drive.publish_odom_tf is False
    assert drive.pose_covariance == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert drive.twist_covariance == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


@pytest.mark.parametrize(
    ("parameters", "limits"),
    [
        ("linear.x.max_velocity: 1.0", Limits(-1.0, 1.0)),
        ("linear.x.max_velocity: .nan", Limits()),
        (
            "linear.x.max_velocity: 1.0\nlinear.x.min_velocity: -0.2\n"
            "linear.x.max_acceleration: 2.0",
            Limits(-0.2, 1.0, -2.0, 2.0),
        ),
        (
            "linear.x.has_velocity_limits: false\nlinear.x.max_velocity: 0.0\n"
            "linear.x.has_acceleration_limits: true\nlinear.x.max_acceleration: 1.0",
            Limits(None, None, -1.0, 1.0),
        ),
        (
            "linear.x.max_acceleration: 1.0\nlinear.x.max_deceleration: -1.0\n"
            "linear.x.max_acceleration_reverse: -0.5",
            Limits(None, None, -0.5, 1.0),
        ),
    ],
)
def test_limits_follow_older_and_newer_releases(parameters: str, limits: Limits) -> None:
    assert diff_of(read_driven(a_diff_robot(), a_diff(parameters))).linear_limits == limits


def test_parameters_without_effect_are_reported() -> None:
    model = read_driven(
        a_diff_robot(), a_diff("cmd_vel_timeout: 0.25\nopen_loop: true\nmine: 3\nwheel_radiu: 1")
    )

    assert mentions(model.report, "ignored", "cmd_vel_timeout")
    assert mentions(model.report, "ignored", "open_loop")
    assert mentions(model.report, "unknown", "mine")
    assert mentions(model.report, "suspicious", "wheel_radiu", "wheel_radius")


def test_diff_drive_of_ros_1_is_read() -> None:
    text = """
    husky_velocity_controller:
      type: "diff_drive_controller/DiffDriveController"
      left_wheel: ['fl', 'rl']
      right_wheel: ['fr', 'rr']
      wheel_separation_multiplier: 1.875
      wheel_radius_multiplier: 0.5
      enable_odom_tf: false
      linear: {x: {has_velocity_limits: true, max_velocity: 1.0}}
    """

    drive = diff_of(read_driven(a_four_wheeler(), text))

    assert drive.wheel_joints == ("fl", "fr", "rl", "rr")
    assert drive.pairs[0].separation_m == pytest.approx(0.75)
    assert drive.pairs[0].diameter_m == pytest.approx(0.1)
    assert drive.linear_limits == Limits(-1.0, 1.0)


def test_joint_with_an_argument_of_a_launch_file_is_found_by_its_end() -> None:
    text = a_diff().replace("[left]", "'$(arg prefix)left'").replace("[right]", "['${p}right']")

    model = read_driven(a_diff_robot(), text)

    assert diff_of(model).wheel_joints == ("left", "right")
    assert len(subjects(model.report, "suspicious")) == 2


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[left]", "[nobody]"),
        ("[left]", "[]"),
        ("[left]", "[left, left]"),
        ("[left]", "[right]"),
        ("left_wheel_names: [left]", ""),
        ("[left]", "'$(arg prefix)t'"),
    ],
)
def test_wheels_that_do_not_fit_give_no_drive(old: str, new: str) -> None:
    model = read_driven(a_diff_robot(), a_diff().replace(old, new))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "controller 'base'", "no drive")


@pytest.mark.parametrize(
    ("parameter", "slug"),
    [
        ("wheel_radius: much", "drive.wheel_radius"),
        ("wheel_radius: -1", "drive.wheel_radius"),
        ("wheel_separation: 1e9", "drive.wheel_separation"),
        ("wheel_separation_multiplier: 0", "drive.multiplier"),
        ("publish_rate: -1", "drive.publish_rate"),
        ("linear.x.max_velocity: fast", "drive.linear.x.max_velocity"),
    ],
)
def test_value_that_is_no_usable_number_is_refused(parameter: str, slug: str) -> None:
    with pytest.raises(ModelError) as refused:
        read_driven(a_diff_robot(), a_diff(parameter))

    assert refused.value.slug == slug


def test_joint_state_broadcaster_gives_joint_states() -> None:
    text = a_diff().replace(
        "    base: {", "    jsb: {type: joint_state_broadcaster/JointStateBroadcaster}\n    base: {"
    )

    model = read_driven(a_diff_robot(), text)

    assert model.joint_state == JointStatePublisher(("left", "right"), RATE_HZ)


def test_other_controllers_are_reported_and_drive_nothing() -> None:
    gripper = a_controller("position_controllers/GripperActionController", "joint: left")

    model = read_driven(a_diff_robot(), gripper)

    assert model.drive is None
    assert mentions(model.report, "ignored", "'base'", "GripperActionController")


MECANUM = "mecanum_drive_controller/MecanumDriveController"
WHEELS = """front_left_wheel_command_joint_name: fl
front_right_wheel_command_joint_name: fr
rear_left_wheel_command_joint_name: rl
rear_right_wheel_command_joint_name: rr
"""


@pytest.mark.parametrize(
    "text",
    [
        a_controller(MECANUM, WHEELS),
        a_controller(
            MECANUM,
            WHEELS + "kinematics.wheels_radius: 0.1\n"
            "kinematics.sum_of_robot_center_projection_on_X_Y_axis: 0.45",
        ),
        a_controller(
            MECANUM,
            WHEELS.replace("command_joint_name", "name")
            + "wheel_separation_x: 0.5\nwheel_separation_y: 0.4\nwheel_radius: 0.1",
        ),
        f"""
        base:
          type: {MECANUM}
          front_left_wheel_joint: fl
          front_right_wheel_joint: fr
          back_left_wheel_joint: rl
          back_right_wheel_joint: rr
        """,
    ],
    ids=["measured", "ros 2", "husarion", "ros 1"],
)
def test_mecanum_wheels_have_their_speeds(text: str) -> None:
    drive = omni_of(read_driven(a_four_wheeler(), text))

    assert drive.wheel_joints == ("fl", "fr", "rl", "rr")
    speeds = [(wheel.ahead, wheel.left, wheel.turn) for wheel in drive.wheels]
    assert speeds == [
        pytest.approx((10.0, -10.0, -4.5)),
        pytest.approx((10.0, 10.0, 4.5)),
        pytest.approx((10.0, 10.0, -4.5)),
        pytest.approx((10.0, -10.0, 4.5)),
    ]
    assert [one.mode for one in drive.actuators] == ["twist", *["velocity"] * 4]


def test_omni_wheels_have_their_speeds() -> None:
    text = a_controller(
        "omni_wheel_drive_controller/OmniWheelDriveController",
        "wheel_names: [fl, rl, rr]\nwheel_offset: 0.0\nrobot_radius: 0.3\nwheel_radius: 0.1\n"
        "diagonal_covariance.pose: [1, 1, 1, 1, 1, 1]\nlinear.y.max_velocity: 0.5",
    )

    drive = omni_of(read_driven(a_four_wheeler(), text))

    first, second, _ = drive.wheels
    assert (first.ahead, first.left, first.turn) == pytest.approx((0.0, -10.0, -3.0), abs=1e-9)
    assert (second.ahead, second.left) == pytest.approx((10.0 * math.sqrt(0.75), 5.0))
    assert drive.pose_covariance == (1.0,) * 6
    assert drive.lateral_limits == Limits(-0.5, 0.5)


@pytest.mark.parametrize(
    "names",
    [
        "traction_joints_names: [rear_right, rear_left]\n"
        "steering_joints_names: [steer_right, steer_left]",
        "rear_wheels_names: [rear_right, rear_left]\n"
        "front_wheels_names: [steer_right, steer_left]\n"
        "front_steering: true\nwheelbase: 0.6\nrear_wheels_radius: 0.1\nrear_wheel_track: 0.4",
    ],
    ids=["new", "old"],
)
def test_ackermann_steering_sorts_sides_and_measures_lengths(names: str) -> None:
    text = a_controller("ackermann_steering_controller/AckermannSteeringController", names)

    drive = steering_of(read_driven(a_car(), text))

    assert (drive.traction, drive.steering) == (
        ("rear_left", "rear_right"),
        ("steer_left", "steer_right"),
    )
    assert drive.passive == ("front_left", "front_right")
    lengths = (drive.wheelbase_m, drive.traction_track_m, drive.steering_track_m)
    assert lengths == pytest.approx((0.6, 0.4, 0.4))
    assert (drive.wheel_radius_m, drive.max_steer) == pytest.approx((0.1, 0.7))
    assert drive.encoder == WheelPair("rear_left", "rear_right", drive.traction_track_m, 0.2)


def test_tricycle_controller_drives_its_steered_wheel() -> None:
    text = a_controller(
        "tricycle_controller/TricycleController",
        "traction_joint_name: front\nsteering_joint_name: steer\nsteering.max_position: 1.2\n"
        "traction.max_velocity: 20.0",
    )

    drive = steering_of(read_driven(a_tricycle(), text))

    assert drive.is_traction_steered
    assert (drive.wheelbase_m, drive.wheel_radius_m) == pytest.approx((0.5, 0.1))
    assert (drive.max_steer, drive.max_speed) == pytest.approx((1.2, 2.0))
    assert drive.passive == ("rear_left", "rear_right")
    assert (drive.odometry_source, drive.publish_odom_tf) == ("world", False)


def test_bicycle_steering_has_one_wheel_and_one_joint() -> None:
    text = a_controller(
        "bicycle_steering_controller/BicycleSteeringController",
        "traction_joints_names: [rear_left]\nsteering_joints_names: [steer]\nwheelbase: 0.55",
    )

    drive = steering_of(read_driven(a_tricycle(), text))

    assert (drive.traction, drive.steering) == (("rear_left",), ("steer",))
    assert drive.wheelbase_m == 0.55
    assert not drive.is_traction_steered


def test_joints_that_mimic_a_virtual_wheel_are_driven_in_its_place() -> None:
    text = a_controller(
        "bicycle_steering_controller/BicycleSteeringController",
        "traction_joints_names: [drive]\nsteering_joints_names: [steer]\nwheelbase: 0.6",
    )

    model = read_driven(a_virtual_car(), text)

    drive = steering_of(model)
    assert drive.traction == ("rear_left", "rear_right")
    assert drive.steering == ("steer_left", "steer_right")
    assert all(joint.mimic is None for joint in model.joints if joint.name in drive.joints)
    assert mentions(model.report, "applied", "'drive'", "'rear_left' and 'rear_right'")
    assert mentions(model.report, "applied", "<mimic>", "'steer_left'")


def test_steered_wheels_without_an_axle_are_reported() -> None:
    text = a_controller(
        "ackermann_steering_controller/AckermannSteeringController",
        "traction_joints_names: [rear_left, rear_right]\n"
        "steering_joints_names: [steer_left, steer_right]\n",
    )
    stiff = a_car()
    for side in ("left", "right"):
        stiff = stiff.replace(
            f'<joint name="front_{side}" type="continuous"',
            f'<joint name="front_{side}" type="fixed"',
        )

    assert not mentions(read_driven(a_car(), text).report, "suspicious", "drag")
    assert mentions(read_driven(stiff, text).report, "suspicious", "'steer_left'", "drag")


FOUR_WHEELS = (
    "front_wheel: [fr, fl]\nrear_wheel: [rl, rr]\nfront_steering: [fl_steer, fr_steer]\n"
    "rear_steering: [rl_steer, rr_steer]\n"
)


@pytest.mark.parametrize(
    ("lengths", "expected"),
    [
        ("", (0.3, 0.4, 0.4, 0.1)),
        (
            "wheel_separation_h: 0.7\nwheel_separation_w: 0.5\nwheel_radius: 0.2\n"
            "wheel_steering_y_offset: 0.05\nwheel_radius_multiplier: 0.5",
            (0.35, 0.5, 0.4, 0.1),
        ),
    ],
    ids=["measured", "written"],
)
def test_four_wheel_steering_turns_two_axles_oppositely(
    lengths: str, expected: tuple[float, ...]
) -> None:
    kind = "four_wheel_steering_controller/FourWheelSteeringController"

    drive = steering_of(read_driven(a_four_steerer(), a_controller(kind, FOUR_WHEELS + lengths)))

    assert drive.traction == ("fl", "fr", "rl", "rr")
    assert (drive.steering, drive.counter_steering) == (
        ("fl_steer", "fr_steer"),
        ("rl_steer", "rr_steer"),
    )
    sizes = (drive.wheelbase_m, drive.traction_track_m, drive.steering_track_m)
    assert (*sizes, drive.wheel_radius_m) == pytest.approx(expected)
    assert (drive.max_steer, drive.encoder) == (0.7, None)


def test_four_wheel_steering_with_one_axle_has_no_drive() -> None:
    text = a_controller(
        "four_wheel_steering_controller/FourWheelSteeringController",
        FOUR_WHEELS.replace("rl_steer, rr_steer", ""),
    )

    model = read_driven(a_four_steerer(), text)

    assert model.drive is None
    assert mentions(model.report, "suspicious", "no drive", "two axles")


def test_tricycle_steering_has_two_wheels_and_one_joint() -> None:
    text = a_controller(
        "tricycle_steering_controller/TricycleSteeringController",
        "traction_joints_names: [rear_right, rear_left]\nsteering_joints_names: [steer]\n"
        "traction_wheels_radius: 0.11",
    )

    model = read_driven(a_tricycle(), text)

    drive = steering_of(model)
    assert (drive.traction, drive.steering) == (("rear_left", "rear_right"), ("steer",))
    assert mentions(model.report, "suspicious", "traction_wheels_radius", "0.22 m", "0.2 m")
