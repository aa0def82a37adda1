"""Command interfaces of `<ros2_control>` and `<transmission>`."""

from tests.sim_server.description.plugins.driven_robots import a_diff_robot
from tests.sim_server.description.robots import mentions
from zensim.proto.messages.model_messages import CommandInterface
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

CONTROL = """<ros2_control name="c" type="system"><hardware><plugin>p</plugin></hardware>
<joint name="left"><command_interface name="velocity"><param name="min">-3</param>
<param name="max">4</param></command_interface><state_interface name="position"/></joint>
<joint name="right"><command_interface name="effort"/></joint></ros2_control>"""
TRANSMISSION = """<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="left"><hardwareInterface>hardware_interface/VelocityJointInterface
</hardwareInterface></joint><actuator name="m"/></transmission>"""


def test_ros2_control_names_joints_and_their_commands_with_limits() -> None:
    model = read_urdf(a_diff_robot(CONTROL))

    assert model.command_interfaces == (
        CommandInterface("left", "velocity", -3.0, 4.0),
        CommandInterface("right", "effort"),
    )
    assert mentions(model.report, "applied", "left velocity -3.0 to 4.0", "right effort")


def test_transmission_of_ros_1_names_a_joint_and_its_command() -> None:
    assert read_urdf(a_diff_robot(TRANSMISSION)).command_interfaces == (
        CommandInterface("left", "velocity"),
    )


def test_interfaces_of_other_joints_are_reported_and_left_out() -> None:
    model = read_urdf(a_diff_robot(CONTROL.replace('"right"', '"arm"')))

    assert [one.joint for one in model.command_interfaces] == ["left"]
    assert mentions(model.report, "ignored", "'arm'")


def test_limit_that_is_no_number_is_reported() -> None:
    model = read_urdf(a_diff_robot(CONTROL.replace(">-3<", ">${x}<")))

    assert model.command_interfaces[0] == CommandInterface("left", "velocity", None, 4.0)
    assert mentions(model.report, "suspicious", "'left'", "min")


def test_parameters_that_are_not_read_are_reported() -> None:
    extra = '<param name="min">-3</param><param name="acceleration">1</param>'
    model = read_urdf(a_diff_robot(CONTROL.replace('<param name="min">-3</param>', extra)))

    assert mentions(model.report, "ignored", "'left'", "'acceleration'")
    assert not mentions(model.report, "ignored", "'left'", "'min'")
