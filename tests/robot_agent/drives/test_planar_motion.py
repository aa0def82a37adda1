"""A base that takes the twist itself."""

import math

import pytest

from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.robot_agent.drives.drive_controller import MeasuredJoints
from zensim.robot_agent.drives.planar_motion import PlanarMotion


@pytest.mark.parametrize(
    ("linear", "angular", "expected"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.5, -0.2, 0.0), (0.0, 0.0, 1.5), (0.5, -0.2, 1.5)),
        ((0.0, 0.0, 9.0), (9.0, 9.0, 0.0), (0.0, 0.0, 0.0)),
        ((-3.0, 4.0, 1.0), (1.0, 1.0, -7.0), (-3.0, 4.0, -7.0)),
    ],
)
def test_base_takes_x_y_and_yaw(
    linear: tuple[float, float, float],
    angular: tuple[float, float, float],
    expected: tuple[float, float, float],
) -> None:
    twist = Twist(Vector3(*linear), Vector3(*angular))

    assert PlanarMotion().update(twist, measured=MeasuredJoints(), elapsed_s=0.05) == expected


def test_base_stays_finite_when_the_twist_overflows() -> None:
    drive = PlanarMotion()
    drive.reset()

    far = drive.update(Twist(Vector3(1e308, -1e308)), measured=MeasuredJoints(), elapsed_s=0.05)

    assert all(math.isfinite(speed) for speed in far)
