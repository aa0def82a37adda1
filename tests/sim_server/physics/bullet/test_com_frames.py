"""States of root links and of centres of mass are converted to each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_box, a_lopsided_box, a_state
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.bullet.com_frames import ComFrames
from zensim.sim_server.physics.engine import FloatArray

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
