"""Joint state and ground truth plug-ins."""

import pytest

from tests.sim_server.description.robots import a_cart, a_plugin, mentions, subjects
from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import GroundTruth, JointStatePublisher, Model, Origin
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

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
    assert subjects(model.report, "suspicious") == []


def test_joint_states_leave_out_joints_that_do_not_exist() -> None:
    inside = "<joint_name>left_joint</joint_name><joint_name>wheel_left_joint</joint_name>"

    model = read_urdf(a_cart(a_plugin(FILE, inside)))

    assert model.joint_state == JointStatePublisher(("left_joint",), 100.0)
    assert subjects(model.report, "suspicious") == ["plugin 'p': <joint_name>"]
    assert mentions(model.report, "suspicious", "'wheel_left_joint'")


def test_joint_states_are_none_when_no_joint_exists() -> None:
    model = read_urdf(a_cart(a_plugin(FILE, "<joint_name>ghost</joint_name>")))

    assert model.joint_state is None
    assert subjects(model.report, "suspicious")[-1] == "plugin 'p'"


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
    assert len(subjects(model.report, "ignored")) == 1


P3D = "libgazebo_ros_p3d.so"


def a_cart_with_ground_truth(inside: str) -> Model:
    return read_urdf(a_cart(a_plugin(P3D, inside)))


def test_ground_truth_has_gazebos_defaults() -> None:
    model = a_cart_with_ground_truth("<body_name>left</body_name>")

    assert model.ground_truths == (GroundTruth("left"),)
    assert mentions(model.report, "applied", "plugin 'p'", "'left'", "'world'")


def test_ground_truth_has_the_written_parameters() -> None:
    model = a_cart_with_ground_truth(
        "<ros><remapping>odom:=truth</remapping></ros><body_name>base</body_name>"
        "<frame_name>map</frame_name><update_rate>20</update_rate>"
        "<xyz_offset>1 2 3</xyz_offset><rpy_offset>0 0 0</rpy_offset>"
        "<gaussian_noise>0.01</gaussian_noise>"
    )

    assert model.ground_truths == (
        GroundTruth(
            "base",
            "map",
            20.0,
            offset=Origin((1.0, 2.0, 3.0)),
            noise=0.01,
            ros=RosBlock(remappings=("odom:=truth",)),
        ),
    )


def test_ground_truth_is_read_in_spellings_of_ros_1() -> None:
    model = a_cart_with_ground_truth(
        "<bodyName>base</bodyName><topicName>ground_truth/state</topicName>"
        "<frameName>/map</frameName><updateRate>5</updateRate><xyzOffsets>1 0 0</xyzOffsets>"
        "<gaussianNoise>0.5</gaussianNoise><alwaysOn>true</alwaysOn>"
    )

    assert model.ground_truths == (
        GroundTruth("base", "map", 5.0, "ground_truth/state", Origin((1.0, 0.0, 0.0)), noise=0.5),
    )


def test_robot_may_have_several_ground_truths() -> None:
    two = a_plugin(P3D, "<body_name>left</body_name>") + a_plugin(
        P3D, "<body_name>right</body_name>", name="q"
    )

    assert [one.body for one in read_urdf(a_cart(two)).ground_truths] == ["left", "right"]


def test_ground_truth_of_an_unknown_link_is_reported() -> None:
    model = a_cart_with_ground_truth("<body_name>ghost</body_name>")

    assert model.ground_truths == ()
    assert mentions(model.report, "suspicious", "plugin 'p'", "'ghost'")


def test_unknown_frame_of_ground_truth_is_reported() -> None:
    model = a_cart_with_ground_truth("<body_name>base</body_name><frame_name>there</frame_name>")

    assert model.ground_truths[0].frame_id == "there"
    assert mentions(model.report, "suspicious", "plugin 'p': <frame_name>", "'there'", "world")


@pytest.mark.parametrize(
    ("inside", "slug"),
    [
        ("<update_rate>-1</update_rate>", "ground_truth.update_rate"),
        ("<gaussian_noise>some</gaussian_noise>", "ground_truth.gaussian_noise"),
        ("<xyz_offset>1 2</xyz_offset>", "ground_truth.xyz_offset"),
    ],
)
def test_ground_truth_is_refused_when_a_number_is_invalid(inside: str, slug: str) -> None:
    with pytest.raises(ModelError) as caught:
        a_cart_with_ground_truth(f"<body_name>base</body_name>{inside}")

    assert caught.value.slug == slug


def test_ground_truth_has_the_compat_of_the_spawn_request() -> None:
    text = a_cart(a_plugin(P3D, "<body_name>base</body_name>"))

    described = parse_description(text, assets={}, allow_missing=False, compat="gazebo11")

    assert described.model.ground_truths[0].compat == "gazebo11"
