"""Rigid transforms on arrays agree with matrices and floats, and broadcast."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto import rigid_transforms
from zensim.proto.messages.model_messages import Origin
from zensim.proto.se3 import (
    FloatArray,
    compose,
    conjugate,
    cross,
    from_axis_angle,
    from_matrix,
    from_origin,
    from_rpy,
    invert,
    multiply,
    rotate,
    to_matrix,
    to_yaw,
    transform_points,
)

angles = st.floats(-math.pi, math.pi)
turns = st.builds(from_rpy, angles, angles, angles)
vectors = st.tuples(*[st.floats(-10.0, 10.0)] * 3).map(np.array)


def an_origin(pose: FloatArray) -> Origin:
    x, y, z, qx, qy, qz, qw = pose.tolist()
    return Origin((x, y, z), (qx, qy, qz, qw))


def assert_same_turn(found: FloatArray, expected: FloatArray) -> None:
    assert abs(np.dot(found, expected)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("rpy", "turned"),
    [
        ((0.0, 0.0, math.pi / 2.0), [0.0, 1.0, 0.0]),
        ((0.0, math.pi / 2.0, 0.0), [0.0, 0.0, -1.0]),
        ((math.pi / 2.0, 0.0, 0.0), [1.0, 0.0, 0.0]),
        # Fixed axes: roll about x first, then yaw about z.
        ((math.pi / 2.0, 0.0, math.pi / 2.0), [0.0, 1.0, 0.0]),
    ],
)
def test_from_rpy_turns_x_about_fixed_axes(
    rpy: tuple[float, float, float], turned: list[float]
) -> None:
    found = rotate(from_rpy(*rpy), np.array([1.0, 0.0, 0.0]))

    assert found == pytest.approx(turned, abs=1e-12)


@given(angles, angles, angles)
def test_from_rpy_is_yaw_after_pitch_after_roll(roll: float, pitch: float, yaw: float) -> None:
    steps = multiply(
        from_rpy(0.0, 0.0, yaw), multiply(from_rpy(0.0, pitch, 0.0), from_rpy(roll, 0.0, 0.0))
    )

    assert from_rpy(roll, pitch, yaw) == pytest.approx(steps, abs=1e-12)


@given(turns, turns, vectors)
def test_multiply_turns_by_the_right_one_first(
    left: FloatArray, right: FloatArray, vector: FloatArray
) -> None:
    at_once = rotate(multiply(left, right), vector)

    assert at_once == pytest.approx(rotate(left, rotate(right, vector)), abs=1e-9)


@given(turns, vectors)
def test_conjugate_turns_back(turn: FloatArray, vector: FloatArray) -> None:
    there = rotate(turn, vector)

    assert rotate(conjugate(turn), there) == pytest.approx(vector, abs=1e-9)
    assert np.linalg.norm(there) == pytest.approx(np.linalg.norm(vector), abs=1e-9)


@given(turns)
def test_from_matrix_gives_the_turn_back(turn: FloatArray) -> None:
    found = from_matrix(to_matrix(turn))

    assert_same_turn(found, turn)
    assert found[3] >= 0.0


@pytest.mark.parametrize("axis", range(3))
def test_from_matrix_is_exact_for_half_turns(axis: int) -> None:
    signs = np.full(3, -1.0)
    signs[axis] = 1.0

    found = from_matrix(np.diag(signs))

    assert abs(found[axis]) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 0.5, 3.1])
def test_yaw_of_finds_the_heading_whatever_the_sign(yaw: float) -> None:
    turn = from_rpy(0.1, -0.2, yaw)

    assert to_yaw(turn) == pytest.approx(yaw, abs=1e-12)
    assert to_yaw(-turn) == pytest.approx(yaw, abs=1e-12)


def test_arithmetic_broadcasts_over_leading_axes() -> None:
    many = np.array([from_rpy(0.1 * i, 0.2, 0.3) for i in range(6)]).reshape(2, 3, 4)
    one, vector = from_rpy(0.4, 0.5, 0.6), np.array([1.0, 2.0, 3.0])

    products, turned, headings = multiply(many, one), rotate(many, vector), to_yaw(many)

    assert (products.shape, turned.shape, headings.shape) == ((2, 3, 4), (2, 3, 3), (2, 3))
    assert products[1, 2] == pytest.approx(multiply(many[1, 2], one))
    assert turned[0, 1] == pytest.approx(rotate(many[0, 1], vector))
    assert conjugate(many).shape == many.shape


@pytest.mark.parametrize("count", [1, 10, 300])
def test_vector_product_of_many_equals_that_of_each(count: int) -> None:
    left, right = (np.random.default_rng(seed).normal(size=(count, 3)) for seed in (1, 2))

    found = cross(left, right)

    assert found.tolist() == [cross(*pair).tolist() for pair in zip(left, right, strict=True)]
    assert found == pytest.approx(np.cross(left, right), abs=1e-12)


poses = st.builds(lambda position, turn: np.concatenate([position, turn]), vectors, turns)


@given(poses, poses, vectors)
def test_compose_transforms_by_the_inner_pose_first(
    outer: FloatArray, inner: FloatArray, point: FloatArray
) -> None:
    one_by_one = transform_points(outer, transform_points(inner, point))

    assert transform_points(compose(outer, inner), point) == pytest.approx(one_by_one, abs=1e-9)


@given(poses)
def test_invert_undoes_a_pose(pose: FloatArray) -> None:
    there_and_back = compose(invert(pose), pose)

    assert there_and_back == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], abs=1e-9)


@given(poses, poses)
def test_arrays_and_floats_give_the_same_numbers(outer: FloatArray, inner: FloatArray) -> None:
    found = compose(np.stack([outer, inner]), np.stack([inner, outer]))

    for row, pair in zip(found, [(outer, inner), (inner, outer)], strict=True):
        expected = rigid_transforms.compose(*map(an_origin, pair))
        assert row == pytest.approx(from_origin(expected), abs=1e-12)


def test_matrices_of_many_rotations_are_stacked() -> None:
    many = np.array([from_rpy(0.1 * i, 0.2, 0.3) for i in range(6)]).reshape(2, 3, 4)

    matrices = to_matrix(many)

    assert matrices.shape == (2, 3, 3, 3)
    assert matrices[1, 2] @ [1.0, 2.0, 3.0] == pytest.approx(
        rotate(many[1, 2], np.array([1.0, 2.0, 3.0]))
    )


def test_from_axis_angle_broadcasts_over_angles() -> None:
    found = from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array([0.0, math.pi]))

    assert found == pytest.approx(np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]))


@given(vectors, vectors)
def test_cross_is_that_of_numpy(left: FloatArray, right: FloatArray) -> None:
    assert cross(left, right).tolist() == np.cross(left, right).tolist()
