"""Rigid transforms in plain floats."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.model_messages import Origin, Quat, Vec3
from zensim.proto.rigid_transforms import (
    compose,
    conjugate,
    cross,
    find_yaw,
    from_axis_angle,
    from_directions,
    from_rpy,
    invert,
    normalize,
    rotate,
    to_rpy,
    transform_point,
)

QUARTER = math.sqrt(0.5)
LEFT: Quat = (0.0, 0.0, QUARTER, QUARTER)
lengths = st.floats(-10.0, 10.0)
vectors = st.tuples(lengths, lengths, lengths)
angles = st.floats(-3.1, 3.1)


@st.composite
def origins(draw: st.DrawFn) -> Origin:
    axis = normalize(draw(vectors))
    return Origin(draw(vectors), from_axis_angle(axis, draw(angles)))


def test_rotate_turns_x_to_y_when_turned_left() -> None:
    assert rotate(LEFT, (1.0, 2.0, 3.0)) == pytest.approx((-2.0, 1.0, 3.0))


def test_compose_places_the_inner_frame_in_the_outer() -> None:
    composed = compose(Origin((1.0, 0.0, 0.0), LEFT), Origin((1.0, 0.0, 0.5), LEFT))

    assert composed.position == pytest.approx((1.0, 1.0, 0.5))
    assert composed.orientation == pytest.approx((0.0, 0.0, 1.0, 0.0))


def test_cross_of_x_and_y_is_z() -> None:
    assert cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)) == (0.0, 0.0, 1.0)


def test_unit_is_x_when_the_vector_has_no_direction() -> None:
    assert normalize((0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0)


def test_inverse_of_nothing_has_no_negative_zeros() -> None:
    position = invert(Origin()).position

    assert [math.copysign(1.0, number) for number in position] == [1.0, 1.0, 1.0]


@given(origins())
def test_inverse_undoes_a_transform(origin: Origin) -> None:
    there_and_back = compose(origin, invert(origin))

    assert there_and_back.position == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert abs(there_and_back.orientation[3]) == pytest.approx(1.0)


@given(origins(), origins(), vectors)
def test_compose_rotates_as_one_rotation_after_the_other(
    outer: Origin, inner: Origin, vector: Vec3
) -> None:
    composed = compose(outer, inner)

    one_by_one = rotate(outer.orientation, rotate(inner.orientation, vector))
    assert rotate(composed.orientation, vector) == pytest.approx(one_by_one, abs=1e-9)


@given(angles)
def test_yaw_is_the_angle_about_z(angle: float) -> None:
    assert find_yaw(from_axis_angle((0.0, 0.0, 1.0), angle), FLOAT_MATH) == pytest.approx(angle)


def test_compose_is_exact_when_the_outer_frame_is_not_rotated() -> None:
    left = Origin((1.0, 0.0, 0.0), LEFT)

    assert compose(Origin(), left) == left
    assert compose(Origin((0.0, 0.0, 2.0)), left) == Origin((1.0, 0.0, 2.0), LEFT)


def test_transform_point_rotates_then_translates() -> None:
    found = transform_point(Origin((1.0, 0.0, 0.0), LEFT), (1.0, 0.0, 0.0))

    assert found == pytest.approx((1.0, 1.0, 0.0))


@given(origins(), vectors)
def test_conjugate_undoes_a_rotation(origin: Origin, vector: Vec3) -> None:
    turned = rotate(origin.orientation, vector)

    assert rotate(conjugate(origin.orientation), turned) == pytest.approx(vector, abs=1e-9)


@given(vectors, vectors)
def test_from_directions_takes_the_first_to_the_second(start: Vec3, end: Vec3) -> None:
    start, end = normalize(start), normalize(end)

    turn = from_directions(start, end)

    assert rotate(turn, start) == pytest.approx(end, abs=1e-6)
    assert math.hypot(*turn) == pytest.approx(1.0)


@pytest.mark.parametrize("start", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_from_directions_makes_a_half_turn_between_opposite_vectors(start: Vec3) -> None:
    end = (-start[0], -start[1], -start[2])

    assert rotate(from_directions(start, end), start) == pytest.approx(end)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_to_rpy_finds_the_angles_of_from_rpy(roll: float, pitch: float, yaw: float) -> None:
    turn = from_rpy(roll, pitch, yaw)

    assert to_rpy(turn) == pytest.approx((roll, pitch, yaw), abs=1e-6)
    assert find_yaw(turn, FLOAT_MATH) == pytest.approx(yaw, abs=1e-6)


@pytest.mark.parametrize("pitch", [math.pi / 2.0, -math.pi / 2.0])
def test_to_rpy_finds_one_of_many_solutions_at_gimbal_lock(pitch: float) -> None:
    turn = from_rpy(0.3, pitch, 0.5)

    again = from_rpy(*to_rpy(turn))

    assert abs(sum(a * b for a, b in zip(turn, again, strict=True))) == pytest.approx(1.0, abs=1e-6)


def test_to_rpy_of_a_zero_quaternion_is_zero() -> None:
    assert to_rpy((0.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
