"""Step goals with progress, cancel and retry; runs to a time; speed."""

from collections.abc import Callable
from typing import TypeVar

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.engines import STEP_NS
from tests.fakes import MemoryCall
from tests.sim_server.fakes import ServerFixture, a_server, answer_of
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    CancelStepsResponse,
    JoinLockstepRequest,
    JoinLockstepResponse,
    ResetScope,
    RunToRequest,
    RunToResponse,
    SetSimulationStateRequest,
    SetSpeedRequest,
    SetSpeedResponse,
    SimulateStepsRequest,
    SimulateStepsResponse,
    SimulationState,
    State,
    StepSimulationRequest,
    StepsProgress,
)
from zensim.proto.messages.standard_messages import Time, ns_from_time, time_from_ns
from zensim.proto.messages.telemetry_messages import Info, InfoRequest
from zensim.sim_server.services.simulation_services import MAX_GOALS, MAX_STEPS

Answer = TypeVar("Answer", bound=msgspec.Struct)


def a_paused_server(*names: str) -> ServerFixture:
    server = a_server(*names)
    server.world.clock.pause()
    return server


def simulate(server: ServerFixture, steps: int, goal_id: str = "g") -> MemoryCall:
    return server.request("simulate_steps", SimulateStepsRequest(steps, goal_id))


def read(call: MemoryCall, kind: type[Answer]) -> Answer:
    answer = answer_of(call, kind)
    assert isinstance(answer, kind)
    return answer


def turn(server: ServerFixture, turns: int) -> None:
    for _ in range(turns):
        server.loop.turn()


def progress_in(server: ServerFixture) -> list[StepsProgress]:
    sent = server.publisher.on("simulate_steps_feedback")
    return [one for one in sent if isinstance(one, StepsProgress)]


def test_goal_gets_its_reply_when_its_last_step_is_made() -> None:
    server = a_paused_server()
    call = simulate(server, 5)

    turn(server, 5)

    assert read(call, SimulateStepsResponse) == SimulateStepsResponse(
        Result(), "g", "succeeded", 5, 0
    )
    assert server.world.clock.steps == 5


def test_goal_publishes_progress_before_the_reply() -> None:
    server = a_paused_server()
    simulate(server, 5)

    turn(server, 1)
    first = progress_in(server)
    turn(server, 4)

    assert first == [StepsProgress("g", 0, 5)]
    assert progress_in(server)[-1] == StepsProgress("g", 5, 0, "succeeded")


def test_canceled_goal_reports_completed_steps() -> None:
    server = a_paused_server()
    goal = simulate(server, 100)
    turn(server, 7)

    cancel = server.request("cancel_steps", CancelStepsRequest("g"))
    turn(server, 2)

    answer = read(goal, SimulateStepsResponse)
    assert (answer.status, answer.completed_steps, answer.remaining_steps) == ("canceled", 7, 93)
    assert answer.result == Result(ResultCode.OPERATION_FAILED, "canceled after 7 of 100 steps")
    assert read(cancel, CancelStepsResponse).goal_ids == ("g",)
    assert server.world.clock.steps == 7


def test_cancel_without_an_id_ends_requested_steps_of_every_kind() -> None:
    server = a_paused_server()
    server.request("step_simulation", StepSimulationRequest(100))
    simulate(server, 100)
    turn(server, 1)

    cancel = server.request("cancel_steps", CancelStepsRequest())
    turn(server, 5)

    assert read(cancel, CancelStepsResponse).goal_ids == ("", "g")
    assert server.world.clock.steps == 1


@pytest.mark.parametrize(
    ("goal_id", "code"), [("other", ResultCode.NOT_FOUND), ("g", ResultCode.INCORRECT_STATE)]
)
def test_cancel_is_refused_for_a_goal_that_is_not_active(goal_id: str, code: int) -> None:
    server = a_paused_server()
    simulate(server, 1)
    turn(server, 2)

    call = server.request("cancel_steps", CancelStepsRequest(goal_id))
    turn(server, 1)

    assert read(call, CancelStepsResponse).result.result == code


def test_goal_requested_again_is_joined() -> None:
    server = a_paused_server()
    first = simulate(server, 10)
    turn(server, 3)

    second = simulate(server, 10)
    turn(server, 7)

    assert read(first, SimulateStepsResponse) == read(second, SimulateStepsResponse)
    assert server.world.clock.steps == 10


def test_result_of_an_ended_goal_is_returned_again() -> None:
    server = a_paused_server()
    first = simulate(server, 10)
    turn(server, 12)

    second = simulate(server, 10)
    turn(server, 1)

    assert read(second, SimulateStepsResponse) == read(first, SimulateStepsResponse)
    assert server.world.clock.steps == 10


def test_goal_of_the_same_id_and_other_steps_is_refused() -> None:
    server = a_paused_server()
    simulate(server, 10)
    call = simulate(server, 11)

    turn(server, 1)

    result = read(call, SimulateStepsResponse).result
    assert result.result == ResultCode.OPERATION_FAILED


@pytest.mark.parametrize("goal_id", ["x" * 65, "a\nb", "\0"])
def test_invalid_goal_id_is_refused(goal_id: str) -> None:
    server = a_paused_server()
    call = simulate(server, 1, goal_id)

    turn(server, 1)

    assert read(call, SimulateStepsResponse).result.result == ResultCode.OPERATION_FAILED
    assert server.world.clock.steps == 0


@pytest.mark.parametrize("steps", [0, MAX_STEPS + 1, 2**64 - 1])
def test_goal_of_too_many_or_no_steps_is_refused(steps: int) -> None:
    server = a_paused_server()
    call = simulate(server, steps)

    turn(server, 1)

    assert read(call, SimulateStepsResponse).result.result == ResultCode.OPERATION_FAILED


def test_goals_beyond_the_limit_are_refused() -> None:
    server = a_paused_server()
    calls = [simulate(server, 1000, f"g{i}") for i in range(MAX_GOALS + 1)]

    turn(server, 10)  # the budget of one is less than so many requests

    assert [call.is_over for call in calls] == [False] * MAX_GOALS + [True]
    assert read(calls[-1], SimulateStepsResponse).result.result == ResultCode.INCORRECT_STATE


def test_goal_is_refused_while_playing() -> None:
    server = a_server()
    call = simulate(server, 1)

    turn(server, 1)

    assert read(call, SimulateStepsResponse).result.result == ResultCode.INCORRECT_STATE


def test_goal_is_aborted_when_the_simulation_is_stopped() -> None:
    server = a_paused_server()
    call = simulate(server, 100)
    turn(server, 3)

    server.world.clock.state = State.STOPPED
    turn(server, 1)

    answer = read(call, SimulateStepsResponse)
    assert (answer.status, answer.completed_steps) == ("aborted", 3)


@pytest.mark.parametrize(
    ("wanted_ns", "steps"), [(0, 0), (1, 1), (STEP_NS, 1), (STEP_NS + 1, 2), (240 * STEP_NS, 240)]
)
def test_run_goes_to_the_first_step_at_or_after_a_time(wanted_ns: int, steps: int) -> None:
    server = a_paused_server()
    call = server.request("run_to", RunToRequest(time_from_ns(wanted_ns)))

    turn(server, max(1, steps))

    answer = read(call, RunToResponse)
    assert (answer.result, answer.completed_steps) == (Result(), steps)
    assert ns_from_time(answer.time) == server.world.clock.time_ns == steps * STEP_NS


@given(st.integers(0, 3 * 10**9), st.integers(0, 50))
def test_run_reaches_any_time_and_makes_no_step_too_many(wanted_ns: int, before: int) -> None:
    server = a_paused_server()
    for _ in range(before):
        server.world.step()
    call = server.request("run_to", RunToRequest(time_from_ns(wanted_ns)))

    while not call.is_over:
        server.loop.turn()

    is_past = wanted_ns < before * STEP_NS
    code = ResultCode.OPERATION_FAILED if is_past else ResultCode.OK
    assert read(call, RunToResponse).result.result == code
    assert is_past or 0 <= server.world.clock.time_ns - wanted_ns < STEP_NS


def test_run_to_a_past_time_is_refused() -> None:
    server = a_paused_server()
    for _ in range(240):
        server.world.step()
    call = server.request("run_to", RunToRequest(Time(0, 500_000_000)))

    turn(server, 1)

    result = read(call, RunToResponse).result
    assert result.result == ResultCode.OPERATION_FAILED


def test_run_is_refused_while_other_steps_are_active() -> None:
    server = a_paused_server()
    simulate(server, 10)
    call = server.request("run_to", RunToRequest(Time(1)))

    turn(server, 1)

    assert read(call, RunToResponse).result.result == ResultCode.INCORRECT_STATE


def test_run_is_refused_while_playing() -> None:
    server = a_server()
    call = server.request("run_to", RunToRequest(Time(1)))

    turn(server, 1)

    assert read(call, RunToResponse).result.result == ResultCode.INCORRECT_STATE


def test_run_is_aborted_by_a_reset() -> None:
    server = a_paused_server()
    call = server.request("run_to", RunToRequest(Time(1)))
    turn(server, 5)

    server.world.reset(ResetScope.TIME)
    turn(server, 5)

    result = read(call, RunToResponse).result
    assert result.result == ResultCode.OPERATION_FAILED
    assert server.world.clock.steps == 0


@pytest.mark.parametrize("factor", [0.01, 0.5, 2.0, 1000.0])
def test_speed_applies_at_once(factor: float) -> None:
    server = a_server(factor=0.02)
    server.turn_for(0.1)
    before_ns = server.world.clock.time_ns
    call = server.request("set_speed", SetSpeedRequest(factor))

    seconds = 100.0 * STEP_NS * 1e-9 / factor
    server.turn_for(seconds)

    assert read(call, SetSpeedResponse).result == Result()
    made = (server.world.clock.time_ns - before_ns) / STEP_NS
    assert made == pytest.approx(100, abs=4) or factor > 2.0


def test_speed_of_zero_is_flat_out() -> None:
    server = a_server(factor=1.0)
    server.request("set_speed", SetSpeedRequest(0.0))

    turn(server, 50)

    assert server.world.clock.steps >= 49


def test_info_returns_the_target_speed() -> None:
    server = a_server()
    server.request("set_speed", SetSpeedRequest(4.0))
    call = server.request("info", InfoRequest())

    turn(server, 1)

    assert read(call, Info).target_real_time_factor == 4.0


@pytest.mark.parametrize("factor", [-1.0, 0.009, 1001.0, float("inf"), float("nan")])
def test_speed_out_of_range_is_refused(factor: float) -> None:
    server = a_server()
    call = server.request("set_speed", SetSpeedRequest(factor))

    turn(server, 1)

    assert read(call, SetSpeedResponse).result.result == ResultCode.OPERATION_FAILED
    assert server.parts.pacing.target_real_time_factor == 1.0


def ask_for(server: ServerFixture, state: State) -> None:
    request = SetSimulationStateRequest(SimulationState(state))
    server.request("set_simulation_state", request)
    turn(server, 1)


def become_stepping(server: ServerFixture) -> None:
    """Let client c1 step, which pauses a world that plays."""
    server.inbox.clients.append(("c1", True))
    turn(server, 1)
    server.request("simulate_steps", SimulateStepsRequest(1, client="c1"))
    turn(server, 2)


def end_stepping(server: ServerFixture) -> None:
    server.inbox.clients.append(("c1", False))
    turn(server, 1)


@pytest.mark.parametrize("make", [a_server, a_paused_server])
def test_world_returns_to_its_state_when_its_client_has_gone(
    make: Callable[[], ServerFixture],
) -> None:
    server = make()
    before = server.world.clock.state
    become_stepping(server)
    assert server.world.clock.state == State.PAUSED

    end_stepping(server)

    assert server.world.clock.state == before


@pytest.mark.parametrize(
    ("make", "asked"), [(a_server, State.PAUSED), (a_paused_server, State.PLAYING)]
)
def test_state_that_is_asked_for_outlasts_the_client_that_steps(
    make: Callable[[], ServerFixture], asked: State
) -> None:
    server = make()
    become_stepping(server)

    ask_for(server, asked)
    end_stepping(server)

    assert server.world.clock.state == asked


def test_speed_that_is_asked_for_outlasts_the_client_that_steps() -> None:
    server = a_server(factor=1.0)
    become_stepping(server)

    server.request("set_speed", SetSpeedRequest(4.0))
    turn(server, 1)
    end_stepping(server)

    assert server.parts.pacing.target_real_time_factor == 4.0


def join(server: ServerFixture, step: int = 0, steps: int = 0) -> MemoryCall:
    """Let client c2 finish a step and wait for its next one."""
    return server.request("join_lockstep", JoinLockstepRequest("c2", steps, 0, step))


def let_join(server: ServerFixture) -> None:
    server.inbox.clients.append(("c2", True))
    turn(server, 1)


def test_requested_steps_await_a_client_that_has_joined_at_each_control_step() -> None:
    server = a_paused_server()
    let_join(server)
    control = server.world.control_steps
    woken = join(server)
    steps = simulate(server, 2 * control)

    turn(server, 3 * control)
    assert read(woken, JoinLockstepResponse).snapshot is not None
    assert server.world.clock.steps == control
    again = join(server, control)
    turn(server, 3 * control)
    assert server.world.clock.steps == 2 * control
    assert again.is_over
    assert not steps.is_over
    join(server, 2 * control)
    turn(server, 2)

    assert read(steps, SimulateStepsResponse).status == "succeeded"


def test_client_that_has_joined_and_is_gone_holds_no_step_back() -> None:
    server = a_paused_server()
    let_join(server)
    woken = join(server)
    steps = simulate(server, 3 * server.world.control_steps)
    turn(server, 2 * server.world.control_steps)

    server.inbox.clients.append(("c2", False))
    turn(server, 4 * server.world.control_steps)

    assert woken.is_over
    assert read(steps, SimulateStepsResponse).status == "succeeded"


def test_request_of_a_client_that_is_gone_is_answered() -> None:
    server = a_paused_server()
    let_join(server)
    waiting = join(server)
    turn(server, 1)

    server.inbox.clients.append(("c2", False))
    turn(server, 2)

    result = read(waiting, JoinLockstepResponse).result
    assert result.result == ResultCode.INCORRECT_STATE


@pytest.mark.parametrize("steps", [1, 10**8])
def test_client_cannot_join_between_control_steps(steps: int) -> None:
    server = a_paused_server()
    server.world.control_steps = 3
    let_join(server)
    call = join(server, steps=steps)

    turn(server, 1)

    assert read(call, JoinLockstepResponse).result.result == ResultCode.OPERATION_FAILED


def test_client_without_a_token_cannot_join() -> None:
    server = a_paused_server()
    call = join(server)

    turn(server, 1)

    assert read(call, JoinLockstepResponse).result.result == ResultCode.INCORRECT_STATE
