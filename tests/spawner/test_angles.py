"""Angles of rotations, against the poses that are made of angles."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.standard_messages import Quaternion
from zensim.spawner.angles import roll_pitch_yaw, yaw_of
from zensim.spawner.launch import pose_at

TURN = st.floats(-3.1, 3.1)


@given(roll=TURN, pitch=st.floats(-1.5, 1.5), yaw=TURN)
def test_angles_are_those_that_a_rotation_was_made_of(
    roll: float, pitch: float, yaw: float
) -> None:
    turn = pose_at((0.0, 0.0, 0.0), (roll, pitch, yaw)).orientation

    assert roll_pitch_yaw(turn) == pytest.approx((roll, pitch, yaw), abs=1e-6)
    assert yaw_of(turn) == pytest.approx(yaw, abs=1e-6)


@pytest.mark.parametrize("pitch", [math.pi / 2.0, -math.pi / 2.0])
def test_upright_rotation_has_one_of_its_many_angles(pitch: float) -> None:
    turn = pose_at((0.0, 0.0, 0.0), (0.3, pitch, 0.5)).orientation

    again = pose_at((0.0, 0.0, 0.0), roll_pitch_yaw(turn)).orientation

    same = turn.x * again.x + turn.y * again.y + turn.z * again.z + turn.w * again.w
    assert abs(same) == pytest.approx(1.0, abs=1e-6)


def test_rotation_of_no_length_has_no_angles() -> None:
    assert roll_pitch_yaw(Quaternion(0.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
