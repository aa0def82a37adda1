"""States of bodies and joints are read into arrays, body by body."""

from collections.abc import Sequence

import numpy as np
import pytest

from zensim.sim_server.physics.bullet.pybullet_engine import (
    QuaternionTuple,
    Vector3Tuple,
    read_base_states,
    read_joint_states,
)

CLIENT = 3
Joint = tuple[float, float, Sequence[float], float]


def place_of(body: int, client: int) -> tuple[Vector3Tuple, QuaternionTuple]:
    return (float(body), 1.0, 2.0), (3.0, 4.0, 5.0, float(client))


def velocity_of(body: int, client: int) -> tuple[Vector3Tuple, Vector3Tuple]:
    return (7.0, 8.0, 9.0), (10.0, 11.0, float(body + client))


def joints_of(body: int, joints: Sequence[int], client: int) -> list[Joint]:
    return [(body + joint / 10.0, float(client), (0.0,) * 6, 0.0) for joint in joints]


def test_each_body_is_a_row() -> None:
    rows = read_base_states((5, 6), CLIENT, place_of, velocity_of)

    assert rows.tolist() == [
        [5.0, 1.0, 2.0, 3.0, 4.0, 5.0, 3.0, 7.0, 8.0, 9.0, 10.0, 11.0, 8.0],
        [6.0, 1.0, 2.0, 3.0, 4.0, 5.0, 3.0, 7.0, 8.0, 9.0, 10.0, 11.0, 9.0],
    ]


def test_no_bodies_are_no_rows() -> None:
    assert read_base_states((), CLIENT, place_of, velocity_of).shape == (0, 13)


def test_joints_follow_each_other_body_by_body() -> None:
    positions, velocities = read_joint_states([(5, (0, 1)), (6, (2,))], CLIENT, joints_of)

    assert positions == pytest.approx([5.0, 5.1, 6.2])
    assert velocities.tolist() == [3.0] * 3


def test_no_joints_are_empty_arrays_of_numbers() -> None:
    positions, velocities = read_joint_states([], CLIENT, joints_of)

    assert positions.shape == velocities.shape == (0,)
    assert positions.dtype == np.float64
