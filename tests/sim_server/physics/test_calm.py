"""Who hardly moves, and whom others may touch."""

import msgspec
import numpy as np
import pytest

from tests.models import a_box, a_box_bot, a_state, an_arm
from zensim.proto.messages.model_messages import Decay, Model
from zensim.sim_server.physics.calm import (
    BRAKED,
    LOOSE,
    Calm,
    State,
    bounds_of,
    first_state,
    reached,
)
from zensim.sim_server.physics.engine import FloatArray, Reading

STEPS = 10
ONE = np.array([3], dtype=np.intp)


def a_reading(base: FloatArray, *positions: float) -> Reading:
    return Reading(base[None], np.array(positions), np.zeros(len(positions)))


def calm_with(model: Model) -> Calm:
    calm = Calm(STEPS)
    calm.take(int(ONE[0]), model, 0.2, 0)
    return calm


def is_calm_after(calm: Calm, states: list[FloatArray]) -> bool:
    """Compare a state at each step, and say whether the last is one of calm."""
    return bool(
        [calm.compare(ONE, a_reading(state), step) for step, state in enumerate(states)][-1]
    )


def test_body_is_calm_when_it_has_stayed_for_long_enough() -> None:
    calm = calm_with(a_box())
    states = [a_state((1.0, 2.0, 3.0), turn=(0.1, 0.2, 0.3))] * (STEPS + 1)

    assert not is_calm_after(calm, states[:-1])
    assert is_calm_after(calm_with(a_box()), states)


@pytest.mark.parametrize("each_m", [1e-4, 1e-3])
def test_body_that_drifts_is_never_calm(each_m: float) -> None:
    states = [a_state((each_m * step, 0.0, 0.0)) for step in range(200)]

    assert not any(is_calm_after(calm_with(a_box()), states[:n]) for n in range(1, 200, 7))


def test_body_that_turns_slowly_is_never_calm() -> None:
    states = [a_state(turn=(0.0, 0.0, 5e-4 * step)) for step in range(50)]

    assert not is_calm_after(calm_with(a_box()), states)


def test_body_whose_joint_swings_is_not_calm() -> None:
    calm = calm_with(an_arm("revolute"))
    still = a_state()

    found = [calm.compare(ONE, a_reading(still, 0.01 * step), step) for step in range(30)]

    assert not any(is_calm.any() for is_calm in found)


def test_robot_with_braked_wheels_may_creep_and_a_box_may_not() -> None:
    assert bounds_of(a_box_bot()) == BRAKED
    assert bounds_of(a_box()) == LOOSE


def test_body_that_stirs_begins_anew() -> None:
    calm, states = calm_with(a_box()), [a_state()] * (STEPS + 1)
    is_calm_after(calm, states)

    calm.stir(int(ONE[0]), STEPS)

    assert not calm.compare(ONE, a_reading(a_state()), STEPS + 1).any()


def test_sleeper_keeps_its_pose_and_loses_its_velocity() -> None:
    calm = calm_with(a_box_bot())

    calm.lay_down(ONE, a_reading(a_state((1.0, 0.0, 0.0), linear=(1e-4, 0.0, 0.0)), 0.5, -0.5))

    assert calm.state[3] == State.ASLEEP
    assert calm.base[3].tolist() == a_state((1.0, 0.0, 0.0)).tolist()
    assert calm.joints_of(ONE).tolist() == [0.5, -0.5]


def test_room_is_made_for_more_bodies_and_more_joints() -> None:
    calm = calm_with(a_box())

    calm.take(500, a_box_bot(), 0.1, 7)

    assert (calm.state[3], calm.state[500], calm.state[499]) == (
        State.AWAKE,
        State.AWAKE,
        State.UNKNOWN,
    )


def test_what_something_acts_on_in_every_step_is_restless() -> None:
    box = a_box()
    dragged = msgspec.structs.replace(box.links[0], decay=Decay(0.1, 0.1))

    assert first_state(box) == State.AWAKE
    assert first_state(a_box(is_static=True)) == State.FIXED
    assert first_state(msgspec.structs.replace(box, links=(dragged,))) == State.RESTLESS


def test_others_are_reached_by_as_much_as_may_be_driven() -> None:
    others = np.array([[1.0, 0.0, 0.0], [1.5, 0.0, 0.0], [9.0, 0.0, 0.0]])
    slow, fast = a_state(), a_state(linear=(4.0, 0.0, 0.0))
    radius, radii = np.array([0.4]), np.full(3, 0.4)

    near = reached(slow[None], radius, others, radii, 0.2)
    far = reached(fast[None], radius, others, radii, 0.2)

    assert near.tolist() == [True, False, False]
    assert far.tolist() == [True, True, False]
    assert not reached(np.zeros((0, 13)), np.zeros(0), others, radii, 0.2).any()
