"""Poses of moving frames in arrays."""

import numpy as np
import pytest

from zensim.proto.joint_transforms import ODOMETRY, FramePoses, JointTransforms
from zensim.proto.messages.model_messages import Joint, Origin

WHEEL = Joint("wheel", "continuous", "base", "tyre", Origin((0.0, 0.2, 0.0)), axis=(0.0, 1.0, 0.0))
LIFT = Joint("lift", "prismatic", "base", "fork", Origin((0.1, 0.0, 0.3)), axis=(0.0, 0.0, 1.0))
MOTIONS = np.arange(26.0).reshape(2, 13)
POSITIONS = np.array([[9.0, 0.5, 0.25], [9.0, -1.0, 0.75]])
"""Of a joint without a frame, the wheel and the lift."""


def test_frames_keep_the_order_of_their_transforms() -> None:
    found = FramePoses((2, ODOMETRY, 1), (LIFT, WHEEL)).find(MOTIONS, POSITIONS)

    lift, odometry, wheel = np.split(found, 3, axis=1)
    joints = JointTransforms((WHEEL, LIFT)).poses(POSITIONS[:, 1:])
    assert odometry.tolist() == MOTIONS[:, :7].tolist()
    assert lift.tolist() == joints[:, 1].tolist()
    assert wheel.tolist() == joints[:, 0].tolist()
    assert lift[0, :3] == pytest.approx([0.1, 0.0, 0.55])


@pytest.mark.parametrize(("columns", "width"), [((), 0), ((ODOMETRY,), 7)])
def test_frames_may_be_few(columns: tuple[int, ...], width: int) -> None:
    assert FramePoses(columns, ()).find(MOTIONS, POSITIONS).shape == (2, width)
