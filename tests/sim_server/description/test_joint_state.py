"""The joint state plug-in publishes the joints that exist."""

import pytest

from tests.sim_server.description.robots import a_cart, a_plugin, reasons
from zensim.proto.messages.model_messages import JointStatePublisher, RosBlock
from zensim.sim_server.description.urdf import read_urdf

FILE = "libgazebo_ros_joint_state_publisher.so"


def test_joint_states_are_of_the_joints_named() -> None:
    inside = (
        "<ros><namespace>/r</namespace></ros><update_rate>30</update_rate>"
        "<joint_name>right_joint</joint_name><joint_name>left_joint</joint_name>"
    )

    model = read_urdf(a_cart(a_plugin(FILE, inside)))

    assert model.joint_state == JointStatePublisher(
        ("right_joint", "left_joint"), 30.0, RosBlock("r")
    )
    assert reasons(model.report, "suspicious") == []


def test_joint_states_leave_out_and_note_joints_that_do_not_exist() -> None:
    inside = "<joint_name>left_joint</joint_name><joint_name>wheel_left_joint</joint_name>"

    model = read_urdf(a_cart(a_plugin(FILE, inside)))

    assert model.joint_state == JointStatePublisher(("left_joint",), 100.0)
    assert reasons(model.report, "suspicious") == [
        "plugin 'p': <joint_name>: joint 'wheel_left_joint' does not exist or is fixed; left out"
    ]


def test_joint_states_are_none_when_no_joint_exists() -> None:
    model = read_urdf(a_cart(a_plugin(FILE, "<joint_name>ghost</joint_name>")))

    assert model.joint_state is None
    assert "no joint states" in reasons(model.report, "suspicious")[-1]


def test_joint_states_are_read_when_spelt_as_in_ros_1() -> None:
    inside = "<jointName>left_joint, right_joint</jointName><updateRate>50</updateRate>"

    model = read_urdf(a_cart(a_plugin(FILE, inside)))

    assert model.joint_state == JointStatePublisher(("left_joint", "right_joint"), 50.0)


@pytest.mark.parametrize(
    ("inside", "joints"),
    [
        ("", ("left_joint", "right_joint")),
        ("<joint_name>right_joint</joint_name>", ("right_joint",)),
    ],
)
def test_joint_states_of_gazebo_sim_are_of_all_joints_or_those_named(
    inside: str, joints: tuple[str, ...]
) -> None:
    plugin = a_plugin("gz-sim-joint-state-publisher-system", f"<topic>js</topic>{inside}")

    model = read_urdf(a_cart(plugin))

    assert model.joint_state == JointStatePublisher(joints, 100.0)
    assert len(reasons(model.report, "ignored")) == 1
