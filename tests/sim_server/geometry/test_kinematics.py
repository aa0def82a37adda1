"""Forward kinematics: links of many entities at once."""

import math

import numpy as np
import pytest

from tests.models import a_cart, a_state, an_arm
from zensim.proto.messages.model_messages import Frame, JointKind, Model, Origin
from zensim.proto.rotation import FloatArray, from_rpy
from zensim.sim_server.geometry.kinematics import link_poses, placed

HERE = a_state()[:7]


def pose(*place: float, yaw: float = 0.0) -> FloatArray:
    return np.concatenate([place, from_rpy(0.0, 0.0, yaw)])


@pytest.mark.parametrize(
    ("kind", "position", "tip"),
    [
        ("prismatic", 0.25, (0.2, 0.0, 1.25)),
        ("continuous", math.pi / 2.0, (0.0, 0.0, 0.8)),
        ("revolute", -math.pi / 2.0, (0.0, 0.0, 1.2)),
        ("fixed", 0.3, (0.2, 0.0, 1.0)),
    ],
)
def test_joint_moves_its_child(
    kind: JointKind, position: float, tip: tuple[float, float, float]
) -> None:
    poses = link_poses(an_arm(kind), HERE[None], np.array([[position]]))

    found = placed(poses["arm"], pose(0.2, 0.0, 0.0))

    assert found[0, :3] == pytest.approx(tip)


def test_links_of_many_entities_are_found_at_once() -> None:
    bases = np.array([pose(0.0, 0.0, 0.0), pose(5.0, 1.0, 0.0, yaw=math.pi / 2.0)])

    poses = link_poses(a_cart(), bases, np.zeros((2, 2)))

    assert poses["left"][0, :3] == pytest.approx([0.0, 0.15, 0.0])
    assert poses["left"][1, :3] == pytest.approx([4.85, 1.0, 0.0])


def test_frames_that_were_merged_are_found_too() -> None:
    model = Model(
        "r", a_cart().links[:1], frames=(Frame("lidar", "base", Origin((0.1, 0.0, 0.2))),)
    )

    poses = link_poses(model, pose(1.0, 0.0, 0.0, yaw=math.pi)[None], np.zeros((1, 0)))

    assert poses["lidar"][0, :3] == pytest.approx([0.9, 0.0, 0.2])
