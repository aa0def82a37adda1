"""Validation and conversion of poses and twists between messages and state rows."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_state
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion, Twist, Vector3
from zensim.sim_server.errors import PoseRefused
from zensim.sim_server.world.pose_conversion import (
    MAX_POSITION_M,
    MAX_SPEED,
    is_zero_quaternion,
    pose_from_row,
    pose_to_row,
    twist_from_row,
    twist_to_row,
)

any_float = st.floats()
metres = st.floats(-MAX_POSITION_M, MAX_POSITION_M)
angles = st.floats(-3.0, 3.0)
states = st.builds(
    a_state, st.tuples(metres, metres, metres), turn=st.tuples(angles, angles, angles)
)


def test_pose_row_is_position_and_unit_quaternion() -> None:
    row = pose_to_row(Pose(Point(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 2.0, 0.0)))

    assert row.tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0]


def test_pose_row_of_an_all_zero_quaternion_is_the_identity() -> None:
    unset = Quaternion(0.0, 0.0, 0.0, 0.0)

    assert is_zero_quaternion(unset)
    assert pose_to_row(Pose(orientation=unset)).tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("part", ["position", "orientation"])
def test_pose_row_refuses_a_number_that_is_not_finite(part: str, value: float) -> None:
    pose = Pose(Point(value)) if part == "position" else Pose(orientation=Quaternion(w=value))

    with pytest.raises(PoseRefused):
        pose_to_row(pose)


@pytest.mark.parametrize("x", [100_001.0, -1e300])
def test_pose_row_refuses_a_position_that_is_too_far(x: float) -> None:
    with pytest.raises(PoseRefused):
        pose_to_row(Pose(Point(x=x)))


@pytest.mark.parametrize("length", [1e-7, 1e-320, 1e6, 1e200])
def test_pose_row_refuses_a_quaternion_without_a_direction(length: float) -> None:
    with pytest.raises(PoseRefused):
        pose_to_row(Pose(orientation=Quaternion(0.0, length, 0.0, 0.0)))


@given(st.builds(Point, any_float, any_float, any_float), st.builds(Quaternion, *[any_float] * 4))
def test_pose_row_is_finite_and_normal_or_refused(point: Point, quaternion: Quaternion) -> None:
    try:
        row = pose_to_row(Pose(point, quaternion))
    except PoseRefused:
        return

    assert abs(row[:3]).max() <= MAX_POSITION_M
    assert np.linalg.norm(row[3:]) == pytest.approx(1.0, abs=1e-12)


@given(st.tuples(*[any_float] * 6))
def test_twist_row_is_finite_or_refused(numbers: tuple[float, ...]) -> None:
    twist = Twist(Vector3(*numbers[:3]), Vector3(*numbers[3:]))

    if all(abs(number) <= MAX_SPEED for number in numbers):
        assert twist_to_row(twist).tolist() == list(numbers)
    else:
        with pytest.raises(PoseRefused):
            twist_to_row(twist)


def test_rows_convert_to_messages_and_back() -> None:
    row = a_state((1.0, 2.0, 3.0), turn=(0.1, 0.2, 0.3), linear=(4.0, 5.0, 6.0), angular=(7, 8, 9))

    assert pose_to_row(pose_from_row(row)) == pytest.approx(row[:7])
    assert twist_to_row(twist_from_row(row)).tolist() == row[7:].tolist()
