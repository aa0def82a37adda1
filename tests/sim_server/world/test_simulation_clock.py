"""States of the simulation: every pair of them, asked for by every number."""

import pytest

from tests.sim_server.fakes import a_world, handle_request, kinds_of_events, make_parts, names_in
from zensim.proto.messages.result_messages import SetSimulationStateCode
from zensim.proto.messages.simulation_messages import (
    SetSimulationStateRequest,
    SimulationState,
    State,
)
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.world.simulation_clock import ALLOWED_TRANSITIONS, STATE_EVENTS, STATE_NAMES

STANDING = {State.STOPPED, State.PAUSED}


def asked(state: int) -> SetSimulationStateRequest:
    return SetSimulationStateRequest(SimulationState(state))


@pytest.mark.parametrize("table", [STATE_NAMES, STATE_EVENTS, ALLOWED_TRANSITIONS])
def test_every_state_is_told_of(table: dict[State, object]) -> None:
    assert set(table) == set(State)


@pytest.mark.parametrize("present", State)
@pytest.mark.parametrize("wanted", State)
def test_state_follows_another_as_the_table_says(present: State, wanted: State) -> None:
    parts = make_parts(a_world("r0"))
    parts.world.clock.state = present

    try:
        handle_request(parts, asked(wanted))
        code = None
    except RequestRefused as refused:
        code = refused.code

    if wanted == present:
        assert code == SetSimulationStateCode.ALREADY_IN_TARGET_STATE
    elif wanted in ALLOWED_TRANSITIONS[present]:
        assert (code, parts.world.clock.state) == (None, wanted)
    else:
        assert (code, parts.world.clock.state) == (
            SetSimulationStateCode.INCORRECT_TRANSITION,
            present,
        )


@pytest.mark.parametrize("present", State)
@pytest.mark.parametrize("wanted", [6, 77, 255])
def test_state_that_is_none_is_refused_with_those_that_are(present: State, wanted: int) -> None:
    parts = make_parts(a_world())
    parts.world.clock.state = present

    with pytest.raises(RequestRefused, match=f"{wanted}, which is no state; use") as refused:
        handle_request(parts, asked(wanted))

    assert refused.value.code == SetSimulationStateCode.INCORRECT_TRANSITION


def test_world_is_never_asked_for_as_a_state() -> None:
    for present, following in ALLOWED_TRANSITIONS.items():
        assert not following & {State.NO_WORLD, State.LOADING_WORLD, present}


def test_stop_goes_back_to_the_start() -> None:
    parts = make_parts(a_world("r0"))
    parts.world.step()
    goal = parts.pacing.step_goals.add(5)

    handle_request(parts, asked(State.STOPPED))

    assert (parts.world.clock.steps, parts.world.clock.epoch, names_in(parts.world)) == (0, 1, [])
    assert goal.is_over
    assert kinds_of_events(parts.world) == ["deleted", "reset", "stopped"]


def test_pause_keeps_everything_where_it_is() -> None:
    parts = make_parts(a_world("r0"))
    parts.world.step()

    handle_request(parts, asked(State.PAUSED))

    assert (parts.world.clock.steps, parts.world.clock.epoch, names_in(parts.world)) == (
        1,
        0,
        ["r0"],
    )
