"""Boxes around models."""

import msgspec
import numpy as np
import pytest

from tests.spawner.page.builders import CUBE, make_robot
from zensim.proto.messages.model_messages import Joint, JointKind, Link, Model, Origin
from zensim.proto.se3 import FloatArray, from_rpy
from zensim.spawner.page.model_bounds import ModelBounds, make_bounds
from zensim.spawner.page.model_visuals import find_link_poses, make_link_meshes, make_template

BASE = np.array([(3.0, -2.0, 1.0, *from_rpy(0.2, -0.4, 1.0))])


def bounds_of(model: Model) -> ModelBounds:
    template = make_template(model)
    return make_bounds(template, [make_link_meshes(shapes) for shapes in template.links])


def pose_links(model: Model, position: float) -> FloatArray:
    joints = make_template(model).visual_joints
    return np.concatenate(find_link_poses(joints, BASE, np.array([[position]])))


def an_arm(kind: JointKind) -> Model:
    """Make a cube with another one at the end of an arm of 1 m."""
    links = (
        Link("base", visuals=(CUBE,)),
        Link("hand", visuals=(msgspec.structs.replace(CUBE, origin=Origin((1.0, 0.0, 0.0))),)),
    )
    return Model("arm", links, (Joint("hinge", kind, "base", "hand", axis=(0.0, 0.0, 1.0)),))


def test_bounds_are_those_of_all_links() -> None:
    low, high = bounds_of(make_robot()).at_rest

    assert low == pytest.approx((-0.05, -0.05, -0.05))
    assert high == pytest.approx((0.05, 0.085, 0.05), abs=1e-3)


def test_bounds_without_shapes_are_zero() -> None:
    assert make_bounds(make_template(make_robot()), [[], []]).at_rest.tolist() == [[0.0] * 3] * 2


@pytest.mark.parametrize(
    ("kind", "high"), [("revolute", (0.05, 1.05, 0.05)), ("continuous", (1.05, 0.05, 0.05))]
)
def test_bounds_follow_an_arm_and_not_a_wheel(
    kind: JointKind, high: tuple[float, float, float]
) -> None:
    arm = an_arm(kind)

    found = bounds_of(arm).find(lambda: pose_links(arm, np.pi / 2.0))

    assert found[1] == pytest.approx(high)


def test_poses_of_a_robot_on_wheels_are_not_asked_for() -> None:
    def find_poses() -> FloatArray:
        raise AssertionError

    bounds = bounds_of(make_robot())

    assert bounds.find(find_poses) is bounds.at_rest
