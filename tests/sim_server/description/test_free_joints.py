"""Planar and floating joints become chains whose joints have one number each."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.sim_server.description.robots import (
    a_joint,
    a_link,
    a_robot,
    an_inertial,
    link_names,
    reasons,
)
from zensim.proto.messages.model_messages import Origin
from zensim.sim_server.description.urdf import MAX_JOINTS, read_urdf
from zensim.sim_server.errors import ModelError

PAIR = a_link("a", an_inertial()) + a_link("b", an_inertial())
PLACE = '<origin xyz="1 2 3"/><axis xyz="0 0 1"/>'


def test_planar_joint_slides_in_its_plane_then_turns() -> None:
    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "planar", PLACE)))

    assert [(j.name, j.kind, j.parent, j.child, j.axis) for j in model.joints] == [
        ("j_x", "prismatic", "a", "b_x", (1.0, 0.0, 0.0)),
        ("j_y", "prismatic", "b_x", "b_y", (0.0, 1.0, 0.0)),
        ("j", "continuous", "b_y", "b", (0.0, 0.0, 1.0)),
    ]
    assert [j.origin for j in model.joints] == [Origin((1.0, 2.0, 3.0)), Origin(), Origin()]
    assert model.mass_kg == 2.0


def test_floating_joint_slides_and_turns_in_all_ways() -> None:
    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "floating", PLACE)))

    assert link_names(model) == ["a", "b_x", "b_y", "b_z", "b_yaw", "b_pitch", "b"]
    assert [j.kind for j in model.joints] == ["prismatic"] * 3 + ["continuous"] * 3
    assert "joint 'j': floating: 6 joints in a chain" in reasons(model.report, "applied")


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: sum(a * a for a in axis) > 0.01))
def test_planar_joint_slides_across_its_normal_whatever_it_is(
    axis: tuple[float, float, float],
) -> None:
    place = f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'

    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "planar", place)))

    axes = np.array([joint.axis for joint in model.joints])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.cross(axes[0], axes[1]) == pytest.approx(axes[2], abs=1e-9)


def test_chain_takes_no_name_that_is_taken() -> None:
    links = a_link("b_x", an_inertial()) + a_joint("j_x", ("a", "b_x"), "continuous")

    model = read_urdf(a_robot(PAIR, links, a_joint("j", ("a", "b"), "planar")))

    assert len({*link_names(model)}) == len(model.links) == 5
    assert len({joint.name for joint in model.joints}) == 4


def test_robot_is_free_when_it_floats_in_the_world() -> None:
    world = a_joint("free", ("world", "a"), "floating")

    model = read_urdf(a_robot(a_link("world"), a_link("a", an_inertial()), world))

    assert (link_names(model), model.joints, model.is_static) == (["a"], (), False)


def test_robot_is_held_when_its_root_is_the_world() -> None:
    fixed = a_joint("nail", ("world", "a")) + a_joint("j", ("a", "b"), "continuous")

    model = read_urdf(a_robot(a_link("world"), PAIR, fixed))

    assert (link_names(model), model.is_static, model.mass_kg) == (["world", "b"], True, 2.0)
    assert [frame.name for frame in model.frames] == ["a"]


def a_hedgehog(spines: int, kind: str) -> str:
    return a_robot(
        a_link("body", an_inertial()),
        *(
            a_link(f"s{i}", an_inertial()) + a_joint(f"j{i}", ("body", f"s{i}"), kind)
            for i in range(spines)
        ),
    )


@pytest.mark.parametrize(("spines", "kind"), [(MAX_JOINTS + 1, "continuous"), (41, "planar")])
def test_robot_is_refused_when_too_many_joints_are_left(spines: int, kind: str) -> None:
    with pytest.raises(ModelError, match="at most 120") as caught:
        read_urdf(a_hedgehog(spines, kind))

    assert caught.value.slug == "urdf.joints"


@pytest.mark.parametrize(("spines", "kind"), [(MAX_JOINTS, "continuous"), (499, "fixed")])
def test_robot_is_read_when_few_joints_are_left(spines: int, kind: str) -> None:
    assert read_urdf(a_hedgehog(spines, kind)).mass_kg == pytest.approx(spines + 1)
