"""Controllers of joints: from files, from `<ros2_control>`, and by default."""

from pathlib import Path

import pytest

from tests.sim_server.description.plugins.driven_robots import a_diff_robot, read_driven
from tests.sim_server.description.robots import a_joint, a_link, mentions
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import JointController, Model, PositionTolerance

EXAMPLE = Path(__file__).parents[4] / "examples" / "arm"
LIMIT = '<limit lower="-1" upper="1" effort="9" velocity="2"/>'


def a_moving(name: str, parent: str, kind: str = "revolute", inside: str = LIMIT) -> str:
    """A link on a joint of the same name."""
    return a_link(f"{name}_link") + a_joint(
        name, (parent, f"{name}_link"), kind, f'<axis xyz="0 1 0"/>{inside}'
    )


ARM = a_moving("lift", "base_link", "prismatic") + a_moving("wrist", "lift_link")
PLUGIN = """<gazebo><plugin name="d" filename="libgazebo_ros_diff_drive.so">
<left_joint>left</left_joint><right_joint>right</right_joint></plugin></gazebo>"""
CONTROL = """<ros2_control name="c" type="system"><joint name="wrist">
<command_interface name="position"/><state_interface name="position">
<param name="initial_value">0.4</param></state_interface></joint></ros2_control>"""
FILE = """
controller_manager:
  ros__parameters:
    arm: {type: joint_trajectory_controller/JointTrajectoryController}
    speeds: {type: velocity_controllers/JointGroupVelocityController}
    forward: {type: forward_command_controller/ForwardCommandController}
    bad name: {type: joint_trajectory_controller/JointTrajectoryController}
arm:
  ros__parameters:
    joints: [wrist, lift, left, nothing]
    allow_partial_joints_goal: true
    gains: {wrist: {p: 1.0, i: 2.0}}
    constraints:
      goal_time: 1.5
      stopped_velocity_tolerance: 0.2
      wrist: {trajectory: 0.1, goal: 0.05}
speeds: {ros__parameters: {joints: [lift]}}
forward: {ros__parameters: {joints: [lift], interface_name: effort}}
bad name: {ros__parameters: {joints: [lift]}}
"""


def only(model: Model) -> JointController:
    (controller,) = model.joint_controllers
    return controller


def test_default_controller_has_the_joints_with_limits_but_none_of_the_drive() -> None:
    found = only(read_driven(a_diff_robot(PLUGIN, ARM)))

    assert found == JointController("joint_trajectory_controller", ("lift", "wrist"))


def test_robot_without_other_joints_than_wheels_has_no_controller() -> None:
    model = read_driven(a_diff_robot(PLUGIN))

    assert model.joint_controllers == ()
    assert model.actuators == model.drive_actuators


def test_joint_without_limits_is_part_of_an_arm_or_left_out() -> None:
    between = a_moving("roll", "lift_link", "continuous", "")
    rotor = a_moving("rotor", "base_link", "continuous", "")

    found = only(read_driven(a_diff_robot(PLUGIN, ARM, between, rotor)))

    assert found.joints == ("lift", "wrist", "roll")


@pytest.mark.parametrize(
    "extra",
    [
        a_moving("locked", "base_link", inside='<limit effort="1" velocity="1"/>'),
        a_moving("finger", "wrist_link", inside=LIMIT + '<mimic joint="wrist"/>'),
        a_moving("spring", "base_link")
        + "<gazebo reference='spring'><springStiffness>9</springStiffness></gazebo>",
    ],
    ids=["locked", "follower", "spring"],
)
def test_other_joints_are_left_out(extra: str) -> None:
    assert only(read_driven(a_diff_robot(PLUGIN, ARM, extra))).joints == ("lift", "wrist")


def test_wheels_are_commanded_where_no_drive_is_wanted() -> None:
    found = read_driven(a_diff_robot(PLUGIN), order=DriveOrder("none"))

    assert only(found).joints == ("left", "right")


def test_described_interfaces_name_the_joints_which_are_held_at_their_initial_value() -> None:
    model = read_driven(a_diff_robot(PLUGIN, ARM, CONTROL))

    found = only(model)
    assert (found.joints, found.holds) == (("wrist",), True)
    assert model.command_interfaces[0].initial == 0.4


def test_files_name_controllers_with_joints_tolerances_and_interfaces() -> None:
    model = read_driven(a_diff_robot(PLUGIN, ARM), FILE)

    arm, speeds, forward = model.joint_controllers
    assert (arm.name, arm.joints, arm.holds) == ("arm", ("wrist", "lift"), True)
    assert arm.tolerances == (PositionTolerance("wrist", 0.1, 0.05), PositionTolerance("lift"))
    assert (arm.goal_time_s, arm.stopped_velocity, arm.allows_partial_goals) == (1.5, 0.2, True)
    assert (speeds.interface, speeds.follows_trajectories) == ("velocity", False)
    assert (forward.interface, forward.holds) == ("effort", False)
    assert mentions(model.report, "suspicious", "'left'", "'nothing'")
    assert mentions(model.report, "suspicious", "bad name")
    assert mentions(model.report, "applied", "follows trajectories of wrist, lift")
    assert not mentions(model.report, "unknown", "gains")


def test_actuators_of_joints_follow_those_of_the_drive_in_the_order_of_the_model() -> None:
    model = read_driven(a_diff_robot(PLUGIN, ARM), FILE)

    assert [one.joint for one in model.joint_actuators] == ["lift", "wrist"]
    assert [one.effort for one in model.joint_actuators] == [9.0, 9.0]
    assert model.actuators == model.drive_actuators + model.joint_actuators
    assert model.target_count == 2 + 2 * 2


def test_example_has_an_arm_and_a_gripper() -> None:
    text = (EXAMPLE / "arm_bot.urdf").read_text(encoding="utf-8")
    file = (EXAMPLE / "controllers.yaml").read_text(encoding="utf-8")

    model = read_driven(text, file)

    assert [one.name for one in model.joint_controllers] == ["arm_controller", "gripper_controller"]
    warned = [one for one in model.report if one.status in ("unknown", "suspicious", "predicted")]
    assert {one.subject for one in warned} <= {"joints", "friction"}


def test_arm_that_is_fixed_to_the_world_has_a_controller() -> None:
    arm = a_link("world") + a_link("post") + a_joint("mount", ("world", "post"), "fixed")

    model = read_driven(f"<robot name='arm'>{arm}{a_moving('lift', 'post')}</robot>")

    assert model.is_static
    assert only(model).joints == ("lift",)


@pytest.mark.parametrize("name", ["position-controller", "controller", "trajectory-controller"])
def test_plugin_of_gazebo_that_commands_a_joint_is_known_and_its_joint_is_commanded(
    name: str,
) -> None:
    plugin = f"""<gazebo><plugin filename="gz-sim-joint-{name}-system" name="p">
<joint_name>lift</joint_name></plugin></gazebo>"""

    model = read_driven(a_diff_robot(PLUGIN, ARM, plugin))

    assert mentions(model.report, "ignored", "joint_commands")
    assert only(model).joints == ("lift", "wrist")
