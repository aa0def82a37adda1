"""Loop: steps at their deadlines, flat out, paused, and one by one when asked."""

import pytest

from tests.engines import STEP_NS
from tests.fakes import MemoryCall
from tests.sim_server.fakes import Stage, a_stage, answer_of, wheel_speeds
from zensim.proto.messages.agent_messages import ClaimEntityRequest, ClaimEntityResponse
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    ResetSimulationRequest,
    SetSimulationStateRequest,
    SimulationState,
    State,
    StepSimulationRequest,
    StepSimulationResponse,
)
from zensim.proto.messages.telemetry_messages import Info, InfoRequest, Stats
from zensim.sim_server.runtime.loop import MAX_LAG_NS, POLL_S

POLL_NS = round(POLL_S * 1e9)
MILLISECOND = 1_000_000


def a_paused_stage(*names: str) -> Stage:
    stage = a_stage(*names)
    stage.world.pause()
    return stage


def turns_until_answered(stage: Stage, call: MemoryCall) -> int:
    """Turn the loop until a call is answered; tell how many steps that took."""
    before = stage.world.steps
    while not call.is_over:
        stage.loop.turn()
    return stage.world.steps - before


def ask_for_steps(stage: Stage, steps: int) -> MemoryCall:
    return stage.ask("step_simulation", StepSimulationRequest(steps))


def code_of(call: MemoryCall) -> int:
    response = answer_of(call, StepSimulationResponse)
    assert isinstance(response, StepSimulationResponse)
    return response.result.result


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_loop_steps_at_deadlines_that_do_not_drift(factor: float) -> None:
    stage = a_stage(factor=factor)
    start_ns, period_ns = stage.wall.ns, round(STEP_NS / factor)

    stage.turn_for(5.0)

    late = [
        began_ns - (start_ns + i * period_ns) for i, began_ns in enumerate(stage.engine.began_ns)
    ]
    assert len(late) == pytest.approx(5.0 * 240.0 * factor, abs=1)
    assert min(late) >= 0
    assert max(late) <= POLL_NS


def test_loop_keeps_its_deadlines_when_a_step_takes_most_of_its_time() -> None:
    stage = a_stage(cost_ns=STEP_NS - 100_000)

    stage.turn_for(2.0)

    assert stage.world.steps == pytest.approx(480, abs=1)
    assert stage.context.loop_stats.slipped_ns == 0


def test_loop_waits_for_the_deadline_and_no_longer() -> None:
    stage = a_stage()

    stage.turn_for(1.0)

    assert max(stage.wall.slept_s) <= POLL_S
    assert sum(stage.wall.slept_s) == pytest.approx(1.0, abs=0.01)


def test_loop_catches_up_when_it_was_held_up_a_little() -> None:
    stage = a_stage()
    stage.turn_for(1.0)

    stage.wall.ns += MAX_LAG_NS - 5 * MILLISECOND
    stage.turn_for(1.0)

    assert stage.world.time_ns == pytest.approx(2_045 * MILLISECOND, abs=2 * STEP_NS)
    assert stage.context.loop_stats.slipped_ns == 0


def test_loop_lets_the_deadline_slip_and_says_so_when_it_was_held_up_for_long() -> None:
    stage = a_stage()
    stage.turn_for(1.0)

    stage.wall.ns += 700 * MILLISECOND
    stage.turn_for(1.0)

    slipped_ns = stage.context.loop_stats.slipped_ns
    assert slipped_ns == pytest.approx(700 * MILLISECOND, abs=2 * STEP_NS)
    assert stage.world.time_ns == pytest.approx(2_000 * MILLISECOND, abs=2 * STEP_NS)
    stats = stage.outlet.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert stats.slipped_s == pytest.approx(0.7, abs=0.01)


def test_loop_makes_no_burst_when_it_was_held_up_for_long() -> None:
    stage = a_stage()
    stage.turn_for(1.0)
    before = stage.world.steps

    stage.wall.ns += 10_000 * MILLISECOND
    stage.turn_for(0.1)

    assert stage.world.steps - before == pytest.approx(0.1 * 240, abs=2)


def test_loop_is_as_fast_as_the_engine_when_that_is_too_slow() -> None:
    stage = a_stage(cost_ns=2 * STEP_NS)

    stage.turn_for(3.0)

    assert stage.world.steps == pytest.approx(3.0 * 120, abs=2)
    assert stage.context.loop_stats.real_time_factor == pytest.approx(0.5, abs=0.01)
    assert stage.context.loop_stats.slipped_ns == pytest.approx(1_500 * MILLISECOND, rel=0.1)


def test_loop_steps_at_every_turn_when_flat_out() -> None:
    stage = a_stage(factor=0.0)

    for _ in range(100):
        stage.loop.turn()

    assert stage.world.steps == 100
    assert stage.wall.slept_s == []


def test_loop_neither_steps_nor_catches_up_when_paused() -> None:
    stage = a_stage()
    stage.turn_for(0.5)
    stage.world.pause()
    before = stage.world.steps

    stage.turn_for(5.0)
    steps_while_paused = stage.world.steps - before
    stage.world.play()
    stage.turn_for(0.5)

    assert steps_while_paused == 0
    assert stage.world.steps - before == pytest.approx(120, abs=2)
    assert stage.context.loop_stats.slipped_ns == 0


def test_loop_answers_at_once_when_paused() -> None:
    stage = a_paused_stage()
    stage.turn_for(1.0)
    call = stage.ask("info", InfoRequest())

    stage.loop.turn()

    info = answer_of(call, Info)
    assert isinstance(info, Info)
    assert info.state == "paused"


def test_loop_answers_between_two_steps() -> None:
    stage = a_stage()
    stage.loop.turn()
    call = stage.ask("info", InfoRequest())

    stage.loop.turn()

    assert call.is_over
    assert stage.world.steps == 1


def test_loop_runs_until_it_should_stop() -> None:
    stage = a_stage(factor=0.0)

    stage.loop.run(lambda: stage.world.steps == 7)

    assert stage.world.steps == 7


@pytest.mark.parametrize("steps", [1, 2, 50])
def test_loop_answers_a_step_request_when_its_last_step_is_done(steps: int) -> None:
    stage = a_paused_stage()
    call = ask_for_steps(stage, steps)

    made = turns_until_answered(stage, call)
    stage.turn_for(0.1)

    assert (made, code_of(call)) == (steps, ResultCode.OK)
    assert stage.world.steps == steps
    assert stage.world.state == State.PAUSED


def test_loop_makes_requested_steps_without_waiting() -> None:
    stage = a_paused_stage()

    turns_until_answered(stage, ask_for_steps(stage, 1000))

    assert stage.wall.slept_s == []


def test_loop_answers_queued_step_requests_one_after_the_other() -> None:
    stage = a_paused_stage()
    first, second = ask_for_steps(stage, 3), ask_for_steps(stage, 4)

    until_first = turns_until_answered(stage, first)
    was_second_answered = second.is_over
    until_second = turns_until_answered(stage, second)

    assert (until_first, was_second_answered, until_second) == (3, False, 4)


def test_loop_serves_while_it_makes_requested_steps() -> None:
    stage = a_paused_stage()
    steps = ask_for_steps(stage, 100)
    stage.loop.turn()
    info = stage.ask("info", InfoRequest())

    stage.loop.turn()

    assert info.is_over
    assert not steps.is_over


@pytest.mark.parametrize("scope", [ResetScope.TIME, ResetScope.STATE, ResetScope.ALL])
def test_loop_makes_as_many_steps_as_asked_for_when_it_is_reset_meanwhile(
    scope: ResetScope,
) -> None:
    stage = a_paused_stage("r0")
    turns_until_answered(stage, ask_for_steps(stage, 500))
    first, second = ask_for_steps(stage, 10), ask_for_steps(stage, 10)
    for _ in range(5):
        stage.loop.turn()

    reset = stage.ask("reset_simulation", ResetSimulationRequest(scope))
    turns = 5
    while not second.is_over:
        stage.loop.turn()
        turns += 1

    assert reset.is_over
    assert first.is_over
    assert turns == 20


def test_loop_finishes_requested_steps_when_it_plays_meanwhile() -> None:
    stage = a_paused_stage()
    call = ask_for_steps(stage, 5)
    stage.ask("set_simulation_state", SetSimulationStateRequest(SimulationState(State.PLAYING)))

    assert turns_until_answered(stage, call) == 5


def test_loop_refuses_a_step_request_at_once_when_it_plays() -> None:
    stage = a_stage()
    call = ask_for_steps(stage, 5)

    stage.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE


def test_loop_answers_a_retry_in_place_of_a_step_request_that_waits() -> None:
    stage = a_paused_stage()
    first, retry = ask_for_steps(stage, 5), ask_for_steps(stage, 5)
    first.request_id = retry.request_id = b"the same"

    turns_until_answered(stage, retry)
    stage.turn_for(0.1)

    assert stage.world.steps == 5


def test_loop_carries_out_a_command_in_the_step_of_the_same_turn() -> None:
    stage = a_stage("r0", factor=0.0)
    stage.world.claim("a", ("r0",), "stop")

    stage.drive("a", 3.0, 3.0)
    stage.loop.turn()

    assert wheel_speeds(stage.world) == [3.0, 3.0]


def test_loop_grants_a_claim_that_comes_with_the_token() -> None:
    stage = a_stage("r0")
    stage.inbox.agents.append(("a", True))
    call = stage.ask("claim_entity", ClaimEntityRequest("a", ("r0",)))

    stage.loop.turn()

    response = answer_of(call, ClaimEntityResponse)
    assert isinstance(response, ClaimEntityResponse)
    assert response.result == Result()
    assert stage.world.claims.agent_of("r0") == "a"


def test_loop_tells_the_cpu_time_that_held_a_step_up() -> None:
    stage = a_stage("r0")
    stage.engine.cost_ns = 7 * MILLISECOND
    while not stage.engine.began_ns:
        stage.loop.turn()
    stage.engine.cost_ns = 0
    stage.turn_for(1.1)

    assert stage.context.loop_stats.busy_max_s == pytest.approx(0.007, abs=1e-3)
