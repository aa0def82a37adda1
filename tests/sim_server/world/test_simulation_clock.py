"""Transitions between all states of the simulation."""

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


def make_request(state: int) -> SetSimulationStateRequest:
    return SetSimulationStateRequest(SimulationState(state))


@pytest.mark.parametrize("table", [STATE_NAMES, STATE_EVENTS, ALLOWED_TRANSITIONS])
def test_each_table_has_every_state(table: dict[State, object]) -> None:
    assert set(table) == set(State)


@pytest.mark.parametrize("present", State)
@pytest.mark.parametrize("wanted", State)
def test_state_changes_as_the_table_allows(present: State, wanted: State) -> None:
    parts = make_parts(a_world("r0"))
    parts.world.clock.state = present

    try:
        handle_request(parts, make_request(wanted))
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
def test_unknown_state_is_refused(present: State, wanted: int) -> None:
    parts = make_parts(a_world())
    parts.world.clock.state = present

    with pytest.raises(RequestRefused) as refused:
        handle_request(parts, make_request(wanted))

    assert refused.value.code == SetSimulationStateCode.INCORRECT_TRANSITION


def test_states_of_world_loading_cannot_be_requested() -> None:
    for present, following in ALLOWED_TRANSITIONS.items():
        assert not following & {State.NO_WORLD, State.LOADING_WORLD, present}


def test_stop_resets_the_world() -> None:
    parts = make_parts(a_world("r0"))
    parts.world.step()
    goal = parts.pacing.step_goals.add(5)

    handle_request(parts, make_request(State.STOPPED))

    assert (parts.world.clock.steps, parts.world.clock.epoch, names_in(parts.world)) == (0, 1, [])
    assert goal.is_over
    assert kinds_of_events(parts.world) == ["deleted", "reset", "stopped"]


def test_pause_changes_nothing_else() -> None:
    parts = make_parts(a_world("r0"))
    parts.world.step()

    handle_request(parts, make_request(State.PAUSED))

    assert (parts.world.clock.steps, parts.world.clock.epoch, names_in(parts.world)) == (
        1,
        0,
        ["r0"],
    )
