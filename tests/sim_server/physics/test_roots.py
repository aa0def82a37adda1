"""States go from root links to their centres of mass and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_box, a_lopsided_box, a_state
from zensim.sim_server.physics.blueprint import blueprint_of
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.roots import Roots

numbers = st.floats(-3.0, 3.0)
triples = st.tuples(numbers, numbers, numbers)
states = st.builds(a_state, triples, turn=triples, linear=triples, angular=triples)


@given(state=states, body=st.sampled_from([0, 63, 64, 300]))
def test_state_of_a_root_link_comes_back_from_that_of_its_centre(
    state: FloatArray, body: int
) -> None:
    roots = Roots()
    roots.remember(body, blueprint_of(a_lopsided_box()).parts[0])

    back = roots.states([body], roots.com_state(body, state)[None])[0]

    assert back[:3] == pytest.approx(state[:3], abs=1e-9)
    assert abs(float(back[3:7] @ state[3:7])) == pytest.approx(1.0)
    assert back[7:] == pytest.approx(state[7:], abs=1e-9)


def test_centre_goes_round_a_root_link_that_turns() -> None:
    roots = Roots()
    roots.remember(0, blueprint_of(a_lopsided_box()).parts[0])

    com = roots.com_state(0, a_state((1.0, 0.0, 0.0), angular=(0.0, 0.0, 2.0)))

    assert com[:3] == pytest.approx([1.3, -0.2, 0.1])
    assert com[7:10] == pytest.approx([0.4, 0.6, 0.0])


def test_body_whose_number_is_used_again_has_the_root_of_its_own() -> None:
    roots = Roots()
    roots.remember(0, blueprint_of(a_lopsided_box()).parts[0])
    roots.remember(0, blueprint_of(a_box()).parts[0])

    turns, arms = roots.turns_and_arms([0], a_state()[None])

    assert not arms.any()
    assert turns.tolist() == [[0.0, 0.0, 0.0, 1.0]]
    assert np.array_equal(roots.com_state(0, a_state()), a_state())
