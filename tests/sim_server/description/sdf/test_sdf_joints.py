"""Joints of SDF files: axes, limits, pivots, chains, and the order of a tree."""

import math

import numpy as np
import pytest

from tests.sim_server.description.robots import mentions, subjects
from tests.sim_server.description.sdf_robots import a_joint, a_link, a_model, a_pose, an_axis, read
from zensim.proto.messages.model_messages import Joint, Mimic, Model
from zensim.sim_server.description.model_geometry import find_link_poses
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.sdf.sdf_joints import find_spanning_tree
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.errors import ModelError

QUARTER = str(math.pi / 2)


def joints_of(inside: str, *, kind: str = "revolute", pose: str = "0 0 0 0 0 0") -> list[Joint]:
    parts = (a_link("a"), a_link("b", a_pose(pose)), a_joint("j", ("a", "b"), kind, inside))
    return list(read(*parts).joints)


def a_limit(lower: str, upper: str) -> str:
    return f"<limit><lower>{lower}</lower><upper>{upper}</upper></limit>"


@pytest.mark.parametrize(
    "limit", ["", a_limit("-1e16", "1e16"), a_limit("-inf", "inf"), a_limit("-1e+16", "1e+16")]
)
def test_revolute_joint_without_limits_is_continuous(limit: str) -> None:
    (joint,) = joints_of(an_axis("0 0 1", limit))

    assert (joint.kind, joint.lower, joint.upper) == ("continuous", 0.0, 0.0)


def test_limits_are_kept() -> None:
    inside = (
        "<limit><lower>-1</lower><upper>2</upper><effort>3</effort><velocity>4</velocity></limit>"
        "<dynamics><damping>5</damping><friction>6</friction></dynamics>"
    )

    (joint,) = joints_of(an_axis("0 0 1", inside))

    assert (joint.kind, joint.lower, joint.upper) == ("revolute", -1.0, 2.0)
    assert (joint.effort, joint.velocity, joint.damping, joint.friction) == (3.0, 4.0, 5.0, 6.0)


def test_prismatic_joint_without_limits_has_those_of_the_world() -> None:
    (joint,) = joints_of(an_axis("1 0 0"), kind="prismatic")

    assert (joint.kind, joint.lower, joint.upper) == ("prismatic", -1e5, 1e5)


def test_axis_is_in_the_frame_of_the_joint() -> None:
    turned = a_pose(f"0 0 0 0 0 {QUARTER}")

    (joint,) = joints_of(turned + an_axis("1 0 0"))

    assert joint.axis == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)


def test_axis_is_in_the_frame_that_it_names() -> None:
    pose = f"0 0 0 0 0 {QUARTER}"

    (joint,) = joints_of(an_axis("1 0 0", attributes='expressed_in="__model__"'), pose=pose)

    assert joint.axis == pytest.approx((0.0, -1.0, 0.0), abs=1e-9)


def test_axis_is_in_the_model_frame_when_it_says_so() -> None:
    axis = an_axis("1 0 0", "<use_parent_model_frame>true</use_parent_model_frame>")

    (joint,) = joints_of(axis, pose=f"0 0 0 0 0 {QUARTER}")

    assert joint.axis == pytest.approx((0.0, -1.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(("version", "axis"), [("1.4", (0.0, -1.0, 0.0)), ("1.5", (1.0, 0.0, 0.0))])
def test_axis_without_a_frame_is_as_its_version_has_it(
    version: str, axis: tuple[float, float, float]
) -> None:
    parts = (
        a_link("a"),
        a_link("b", a_pose(f"0 0 0 0 0 {QUARTER}")),
        a_joint("j", ("a", "b"), "revolute", an_axis("1 0 0")),
    )

    model = read_sdf_model(a_model(*parts, version=version))

    assert model.joints[0].axis == pytest.approx(axis, abs=1e-9)


def test_child_gets_a_pivot_when_the_axis_misses_its_origin() -> None:
    parts = (
        a_link("a"),
        a_link("b", a_pose("1 0 0 0 0 0")),
        a_joint("j", ("a", "b"), "revolute", a_pose("0 0.5 0 0 0 0") + an_axis("0 0 1")),
    )

    model = read(*parts)

    assert model.joints[0].origin.position == (1.0, 0.5, 0.0)
    assert [(f.name, f.parent, f.origin.position) for f in model.frames] == [
        ("b", "j_pivot", (0.0, -0.5, 0.0))
    ]
    assert model.links[1].inertial.com_in_link == (0.0, -0.5, 0.0)


def test_child_needs_no_pivot_when_the_axis_runs_through_its_origin() -> None:
    parts = (
        a_link("a"),
        a_link("b"),
        a_joint("j", ("a", "b"), "revolute", a_pose("0 0 0.5 0 0 0") + an_axis("0 0 1")),
    )

    assert read(*parts).links[1].name == "b"


def test_joint_pose_may_be_relative_to_another_frame() -> None:
    pose = a_pose("0 0 0 0 0 0", 'relative_to="__model__"')

    (joint,) = joints_of(pose + an_axis("0 0 1"), pose="1 0 0 0 0 0")

    assert joint.origin.position == (0.0, 0.0, 0.0)


def test_ball_joint_is_three_revolute_joints() -> None:
    joints = joints_of("", kind="ball")

    assert [joint.name for joint in joints] == ["j_1", "j_2", "j"]
    assert [joint.kind for joint in joints] == ["continuous"] * 3
    assert joints[0].axis == (0.0, 1.0, 0.0)
    assert joints[-1].child == "b"


def test_pivot_links_of_a_ball_joint_are_not_reported() -> None:
    model = read(a_link("a"), a_link("b"), a_joint("j", ("a", "b"), "ball"))

    assert subjects(model.report, "suspicious") == []


def test_universal_joint_is_two_revolute_joints() -> None:
    axes = an_axis("1 0 0") + an_axis("0 1 0").replace("axis>", "axis2>")

    joints = joints_of(axes, kind="universal")

    assert [joint.axis for joint in joints] == [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


def test_mimic_offset_includes_its_reference() -> None:
    mimic = (
        '<mimic joint="j"><multiplier>2</multiplier><offset>1</offset><reference>3</reference>'
        "</mimic>"
    )
    parts = (
        *(a_link(name) for name in "abc"),
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("a", "c"), "revolute", an_axis("0 0 1", mimic)),
    )

    assert read(*parts).joints[1].mimic == Mimic("j", 2.0, -5.0)


def test_missing_axis_is_reported() -> None:
    parts = (a_link("a"), a_link("b"), a_joint("j", ("a", "b"), "revolute"))

    assert mentions(read(*parts).report, "suspicious", "joint 'j'", "<axis>", "0 0 1")


def test_joint_and_link_may_have_one_name() -> None:
    parts = (
        a_link("a"),
        a_link("b", a_pose("1 0 0 0 0 0")),
        a_joint("a", ("a", "b"), "revolute", a_pose("0 0 1 0 0 0") + an_axis("0 0 1")),
    )

    model = read_sdf_model(a_model(*parts, version="1.6"))

    assert model.joints[0].origin.position == (1.0, 0.0, 0.0)
    assert subjects(model.report, "suspicious") == ["model 'm'"]


def test_joint_and_link_of_one_name_are_refused_as_of_sdf_1_7() -> None:
    with pytest.raises(ModelError) as caught:
        read_sdf_model(a_model(a_link("a"), a_link("b"), a_joint("a", ("a", "b")), version="1.7"))

    assert caught.value.slug == "sdf.duplicate_name"


THREE = (a_link("a"), a_link("b", a_pose("0 1 0 0 0 0")), a_link("c", a_pose("0 2 0 0 0 0")))


def ends(model: Model) -> list[tuple[str, str, str]]:
    return [(joint.name, joint.parent, joint.child) for joint in model.joints]


def test_joint_is_reversed_when_its_child_has_a_parent() -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("c", "b"), "revolute", an_axis("1 0 0")),
    )

    assert ends(model) == [("j", "a", "b"), ("k", "b", "k_pivot")]
    assert [frame.name for frame in model.frames] == ["c"]
    assert model.joints[1].axis == (-1.0, 0.0, 0.0)
    assert subjects(model.report, "suspicious") == []


def test_link_keeps_its_pose_when_its_joint_is_reversed() -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("c", "b"), "universal", an_axis("1 0 0") + "<axis2><xyz>0 0 1</xyz></axis2>"),
    )

    poses = find_link_poses("a", model.joints)
    (held,) = model.frames
    apart = np.add(poses[held.parent].position, held.origin.position)
    assert apart.tolist() == pytest.approx([0.0, 2.0, 0.0])
    assert [joint.axis for joint in model.joints[1:]] == [(0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)]


def test_first_link_is_the_root_when_it_has_a_parent() -> None:
    model = read(
        *THREE,
        a_joint("j", ("c", "a"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("c", "b"), "revolute", an_axis("0 0 1")),
        a_joint("l", ("a", "b"), "revolute", an_axis("0 0 1")),
    )

    assert model.links[0].name == "a"
    assert ends(model)[-1] == ("l", "a", "b")
    assert len(subjects(model.report, "suspicious")) == 1


def test_loop_of_joints_is_opened_and_reported() -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("b", "c"), "revolute", an_axis("0 0 1")),
        a_joint("l", ("a", "c"), "revolute", an_axis("0 0 1")),
    )

    assert {name for name, _, _ in ends(model)} == {"j", "l"}
    assert subjects(model.report, "suspicious") == ["joint 'k'"]


def test_joint_to_the_world_is_the_root_of_all() -> None:
    model = read(
        *THREE,
        a_joint("w", ("world", "b"), "revolute", an_axis("0 0 1")),
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("b", "c"), "revolute", an_axis("0 0 1")),
    )

    assert model.is_static
    assert {name for name, _, _ in ends(model)} == {"w", "j", "k"}


@pytest.mark.parametrize("kind", ["gearbox", "screw"])
def test_coupling_joint_is_left_out(kind: str) -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("a", "c"), "revolute", an_axis("0 0 1")),
        a_joint("g", ("b", "c"), kind),
    )

    assert [name for name, _, _ in ends(model)] == ["j", "k"]
    assert subjects(model.report, "suspicious") == ["joint 'g'"]
    assert mentions(model.report, "suspicious", kind)


def test_spanning_tree_of_no_joints_is_empty() -> None:
    assert find_spanning_tree([], ["a"], ParseReport()) == ()


def test_joint_has_its_spring() -> None:
    dynamics = (
        "<dynamics><spring_stiffness>40</spring_stiffness>"
        "<spring_reference>0.1</spring_reference></dynamics>"
    )
    axis = an_axis("0 0 1", dynamics)

    model = read(a_link("a"), a_link("b"), a_joint("j", ("a", "b"), "prismatic", axis))

    (joint,) = model.joints
    assert (joint.spring_stiffness, joint.spring_reference) == (40.0, 0.1)
