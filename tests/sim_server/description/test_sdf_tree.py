"""SDF joints make a graph; what can be a tree becomes one, and loops are left open."""

import numpy as np
import pytest

from tests.sim_server.description.robots import reasons
from tests.sim_server.description.sdf_robots import a_joint, a_link, a_pose, an_axis, read
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.sdf_tree import as_tree
from zensim.sim_server.description.transforms import link_poses

THREE = (a_link("a"), a_link("b", a_pose("0 1 0 0 0 0")), a_link("c", a_pose("0 2 0 0 0 0")))


def ends(model: Model) -> list[tuple[str, str, str]]:
    return [(joint.name, joint.parent, joint.child) for joint in model.joints]


def test_joint_is_turned_round_when_its_link_has_a_parent_already() -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("c", "b"), "revolute", an_axis("1 0 0")),
    )

    assert ends(model) == [("j", "a", "b"), ("k", "b", "k_pivot")]
    assert [frame.name for frame in model.frames] == ["c"]
    assert model.joints[1].axis == (-1.0, 0.0, 0.0)
    assert reasons(model.report, "suspicious") == []


def test_link_stays_in_its_place_when_its_joint_is_turned_round() -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("c", "b"), "universal", an_axis("1 0 0") + "<axis2><xyz>0 0 1</xyz></axis2>"),
    )

    poses = link_poses("a", model.joints)
    (held,) = model.frames
    apart = np.add(poses[held.parent].position, held.origin.position)
    assert apart.tolist() == pytest.approx([0.0, 2.0, 0.0])
    assert [joint.axis for joint in model.joints[1:]] == [(0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)]


def test_first_link_is_the_root_whatever_holds_it() -> None:
    model = read(
        *THREE,
        a_joint("j", ("c", "a"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("c", "b"), "revolute", an_axis("0 0 1")),
        a_joint("l", ("a", "b"), "revolute", an_axis("0 0 1")),
    )

    assert model.links[0].name == "a"
    assert ends(model)[-1] == ("l", "a", "b")
    assert len(reasons(model.report, "suspicious")) == 1


def test_loop_is_left_open_and_noted() -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("b", "c"), "revolute", an_axis("0 0 1")),
        a_joint("l", ("a", "c"), "revolute", an_axis("0 0 1")),
    )

    assert {name for name, _, _ in ends(model)} == {"j", "l"}
    assert reasons(model.report, "suspicious") == [
        "joint 'k': closes a loop of joints; loops are left open"
    ]


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
def test_joint_that_only_couples_is_left_out_and_noted(kind: str) -> None:
    model = read(
        *THREE,
        a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")),
        a_joint("k", ("a", "c"), "revolute", an_axis("0 0 1")),
        a_joint("g", ("b", "c"), kind),
    )

    assert [name for name, _, _ in ends(model)] == ["j", "k"]
    assert reasons(model.report, "suspicious") == [f"joint 'g': {kind} is not simulated; left out"]


def test_nothing_is_made_of_no_joints() -> None:
    assert as_tree([], ["a"], Report()) == ()
