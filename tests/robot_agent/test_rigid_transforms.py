"""Rigid transforms."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.model_messages import Origin, Quat, Vec3
from zensim.robot_agent import rigid_transforms

QUARTER = math.sqrt(0.5)
LEFT: Quat = (0.0, 0.0, QUARTER, QUARTER)
lengths = st.floats(-10.0, 10.0)
vectors = st.tuples(lengths, lengths, lengths)
angles = st.floats(-3.1, 3.1)


@st.composite
def origins(draw: st.DrawFn) -> Origin:
    axis = rigid_transforms.normalize(draw(vectors))
    return Origin(draw(vectors), rigid_transforms.from_axis_angle(axis, draw(angles)))


def test_rotate_turns_x_to_y_when_turned_left() -> None:
    assert rigid_transforms.rotate(LEFT, (1.0, 2.0, 3.0)) == pytest.approx((-2.0, 1.0, 3.0))


def test_compose_places_the_inner_frame_in_the_outer() -> None:
    composed = rigid_transforms.compose(
        Origin((1.0, 0.0, 0.0), LEFT), Origin((1.0, 0.0, 0.5), LEFT)
    )

    assert composed.position == pytest.approx((1.0, 1.0, 0.5))
    assert composed.orientation == pytest.approx((0.0, 0.0, 1.0, 0.0))


def test_cross_of_x_and_y_is_z() -> None:
    assert rigid_transforms.cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)) == (0.0, 0.0, 1.0)


def test_unit_is_x_when_the_vector_has_no_direction() -> None:
    assert rigid_transforms.normalize((0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0)


def test_inverse_of_nothing_has_no_negative_zeros() -> None:
    position = rigid_transforms.invert(Origin()).position

    assert [math.copysign(1.0, number) for number in position] == [1.0, 1.0, 1.0]


@given(origins())
def test_inverse_undoes_a_transform(origin: Origin) -> None:
    there_and_back = rigid_transforms.compose(origin, rigid_transforms.invert(origin))

    assert there_and_back.position == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert abs(there_and_back.orientation[3]) == pytest.approx(1.0)


@given(origins(), origins(), vectors)
def test_compose_rotates_as_one_rotation_after_the_other(
    outer: Origin, inner: Origin, vector: Vec3
) -> None:
    composed = rigid_transforms.compose(outer, inner)

    one_by_one = rigid_transforms.rotate(
        outer.orientation, rigid_transforms.rotate(inner.orientation, vector)
    )
    assert rigid_transforms.rotate(composed.orientation, vector) == pytest.approx(
        one_by_one, abs=1e-9
    )


@given(angles)
def test_yaw_is_the_angle_about_z(angle: float) -> None:
    assert rigid_transforms.find_yaw(
        rigid_transforms.from_axis_angle((0.0, 0.0, 1.0), angle), FLOAT_MATH
    ) == pytest.approx(angle)
