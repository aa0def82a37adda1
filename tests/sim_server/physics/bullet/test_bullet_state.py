"""Conversion of states between root links and centres of mass."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_box, a_lopsided_box, a_state
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.bullet.pybullet_engine import (
    ComFrames,
    QuaternionTuple,
    Vector3Tuple,
    read_base_states,
    read_joint_states,
)
from zensim.sim_server.physics.engine import FloatArray

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


numbers = st.floats(-3.0, 3.0)
triples = st.tuples(numbers, numbers, numbers)
states = st.builds(a_state, triples, turn=triples, linear=triples, angular=triples)


@given(state=states, body=st.sampled_from([0, 63, 64, 300]))
def test_state_of_a_root_link_comes_back_from_that_of_its_centre(
    state: FloatArray, body: int
) -> None:
    roots = ComFrames()
    roots.add(body, make_blueprint(a_lopsided_box()).parts[0])

    back = roots.states([body], roots.to_com_state(body, state)[None])[0]

    assert back[:3] == pytest.approx(state[:3], abs=1e-9)
    assert abs(float(back[3:7] @ state[3:7])) == pytest.approx(1.0)
    assert back[7:] == pytest.approx(state[7:], abs=1e-9)


def test_centre_of_mass_moves_around_a_rotating_root_link() -> None:
    roots = ComFrames()
    roots.add(0, make_blueprint(a_lopsided_box()).parts[0])

    com = roots.to_com_state(0, a_state((1.0, 0.0, 0.0), angular=(0.0, 0.0, 2.0)))

    assert com[:3] == pytest.approx([1.3, -0.2, 0.1])
    assert com[7:10] == pytest.approx([0.4, 0.6, 0.0])


def test_reused_body_number_has_new_offsets() -> None:
    roots = ComFrames()
    roots.add(0, make_blueprint(a_lopsided_box()).parts[0])
    roots.add(0, make_blueprint(a_box()).parts[0])

    turns, arms = roots.orientations_and_arms([0], a_state()[None])

    assert not arms.any()
    assert turns.tolist() == [[0.0, 0.0, 0.0, 1.0]]
    assert np.array_equal(roots.to_com_state(0, a_state()), a_state())
