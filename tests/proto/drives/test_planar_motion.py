"""A base that takes the twist itself."""

import math

import pytest

from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.messages.drive_messages import PlanarMove


@pytest.mark.parametrize("twist", [(0.0, 0.0, 0.0), (0.5, -0.2, 1.5), (-3.0, 4.0, -7.0)])
def test_base_takes_x_y_and_yaw(twist: tuple[float, float, float]) -> None:
    vx, vy, wz = twist

    assert SingleDrive(PlanarMove()).update(vx, wz, vy=vy) == twist


def test_base_stays_finite_when_the_twist_overflows() -> None:
    targets = SingleDrive(PlanarMove()).update(1e308, vy=-1e308)

    assert all(math.isfinite(speed) for speed in targets)
