"""Loop: steps at deadlines, flat out, paused, and on request."""

import pytest

from tests.engines import STEP_NS
from tests.fakes import MemoryCall
from tests.sim_server.fakes import ServerFixture, a_server, answer_of, wheel_speeds
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
from zensim.sim_server.runtime.loop import IDLE_POLL_S, MAX_LAG_NS, POLL_S

POLL_NS = round(POLL_S * 1e9)
MILLISECOND = 1_000_000


def a_paused_server(*names: str) -> ServerFixture:
    server = a_server(*names)
    server.world.clock.pause()
    return server


def turns_until_answered(server: ServerFixture, call: MemoryCall) -> int:
    """Turn the loop until a call has its reply; return the number of turns."""
    before = server.world.clock.steps
    while not call.is_over:
        server.loop.turn()
    return server.world.clock.steps - before


def request_steps(server: ServerFixture, steps: int) -> MemoryCall:
    return server.request("step_simulation", StepSimulationRequest(steps))


def code_of(call: MemoryCall) -> int:
    response = answer_of(call, StepSimulationResponse)
    assert isinstance(response, StepSimulationResponse)
    return response.result.result


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_loop_steps_at_deadlines_that_do_not_drift(factor: float) -> None:
    server = a_server(factor=factor)
    start_ns, period_ns = server.wall.ns, round(STEP_NS / factor)

    server.turn_for(5.0)

    late = [
        began_ns - (start_ns + i * period_ns) for i, began_ns in enumerate(server.engine.began_ns)
    ]
    assert len(late) == pytest.approx(5.0 * 240.0 * factor, abs=1)
    assert min(late) >= 0
    assert max(late) <= POLL_NS


def test_loop_keeps_its_deadlines_when_a_step_takes_most_of_its_time() -> None:
    server = a_server(cost_ns=STEP_NS - 100_000)

    server.turn_for(2.0)

    assert server.world.clock.steps == pytest.approx(480, abs=1)
    assert server.parts.pacing.loop_stats.slipped_ns == 0


def test_loop_waits_for_the_deadline_and_no_longer() -> None:
    server = a_server()

    server.turn_for(1.0)

    assert max(server.wall.slept_s) == IDLE_POLL_S
    assert sum(server.wall.slept_s) == pytest.approx(1.0, abs=0.01)


def test_loop_looks_for_input_more_often_for_a_while_after_a_request() -> None:
    server = a_server()
    server.request("info", InfoRequest())
    server.turn_for(0.09)

    busy_s = max(server.wall.slept_s)
    server.wall.slept_s.clear()
    server.turn_for(0.09)

    assert (busy_s, max(server.wall.slept_s)) == (POLL_S, IDLE_POLL_S)


def test_loop_catches_up_when_it_was_delayed_a_little() -> None:
    server = a_server()
    server.turn_for(1.0)

    server.wall.ns += MAX_LAG_NS - 5 * MILLISECOND
    server.turn_for(1.0)

    assert server.world.clock.time_ns == pytest.approx(2_045 * MILLISECOND, abs=2 * STEP_NS)
    assert server.parts.pacing.loop_stats.slipped_ns == 0


def test_loop_moves_the_deadline_and_reports_it_when_it_was_delayed_for_long() -> None:
    server = a_server()
    server.turn_for(1.0)

    server.wall.ns += 700 * MILLISECOND
    server.turn_for(1.0)

    slipped_ns = server.parts.pacing.loop_stats.slipped_ns
    assert slipped_ns == pytest.approx(700 * MILLISECOND, abs=2 * STEP_NS)
    assert server.world.clock.time_ns == pytest.approx(2_000 * MILLISECOND, abs=2 * STEP_NS)
    stats = server.publisher.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert stats.slipped_s == pytest.approx(0.7, abs=0.01)


def test_loop_makes_no_burst_when_it_was_delayed_for_long() -> None:
    server = a_server()
    server.turn_for(1.0)
    before = server.world.clock.steps

    server.wall.ns += 10_000 * MILLISECOND
    server.turn_for(0.1)

    assert server.world.clock.steps - before == pytest.approx(0.1 * 240, abs=2)


def test_loop_is_as_fast_as_the_engine_when_that_is_too_slow() -> None:
    server = a_server(cost_ns=2 * STEP_NS)

    server.turn_for(3.0)

    assert server.world.clock.steps == pytest.approx(3.0 * 120, abs=2)
    assert server.parts.pacing.loop_stats.real_time_factor == pytest.approx(0.5, abs=0.01)
    assert server.parts.pacing.loop_stats.slipped_ns == pytest.approx(1_500 * MILLISECOND, rel=0.1)


def test_loop_steps_at_every_turn_when_flat_out() -> None:
    server = a_server(factor=0.0)

    for _ in range(100):
        server.loop.turn()

    assert server.world.clock.steps == 100
    assert server.wall.slept_s == []


def test_loop_neither_steps_nor_catches_up_when_paused() -> None:
    server = a_server()
    server.turn_for(0.5)
    server.world.clock.pause()
    before = server.world.clock.steps

    server.turn_for(5.0)
    steps_while_paused = server.world.clock.steps - before
    server.world.clock.change_state(State.PLAYING)
    server.turn_for(0.5)

    assert steps_while_paused == 0
    assert server.world.clock.steps - before == pytest.approx(120, abs=2)
    assert server.parts.pacing.loop_stats.slipped_ns == 0


def test_loop_replies_at_once_when_paused() -> None:
    server = a_paused_server()
    server.turn_for(1.0)
    call = server.request("info", InfoRequest())

    server.loop.turn()

    info = answer_of(call, Info)
    assert isinstance(info, Info)
    assert info.state == "paused"


def test_loop_replies_between_two_steps() -> None:
    server = a_server()
    server.loop.turn()
    call = server.request("info", InfoRequest())

    server.loop.turn()

    assert call.is_over
    assert server.world.clock.steps == 1


def test_loop_runs_until_it_should_stop() -> None:
    server = a_server(factor=0.0)

    server.loop.run(lambda: server.world.clock.steps == 7)

    assert server.world.clock.steps == 7


@pytest.mark.parametrize("steps", [1, 2, 50])
def test_loop_replies_to_a_step_request_when_its_last_step_is_done(steps: int) -> None:
    server = a_paused_server()
    call = request_steps(server, steps)

    made = turns_until_answered(server, call)
    server.turn_for(0.1)

    assert (made, code_of(call)) == (steps, ResultCode.OK)
    assert server.world.clock.steps == steps
    assert server.world.clock.state == State.PAUSED


def test_loop_makes_requested_steps_without_waiting() -> None:
    server = a_paused_server()

    turns_until_answered(server, request_steps(server, 1000))

    assert server.wall.slept_s == []


def test_loop_replies_to_queued_step_requests_one_after_the_other() -> None:
    server = a_paused_server()
    first, second = request_steps(server, 3), request_steps(server, 4)

    until_first = turns_until_answered(server, first)
    was_second_answered = second.is_over
    until_second = turns_until_answered(server, second)

    assert (until_first, was_second_answered, until_second) == (3, False, 4)


def test_loop_serves_while_it_makes_requested_steps() -> None:
    server = a_paused_server()
    steps = request_steps(server, 100)
    server.loop.turn()
    info = server.request("info", InfoRequest())

    server.loop.turn()

    assert info.is_over
    assert not steps.is_over


@pytest.mark.parametrize("scope", [ResetScope.TIME, ResetScope.STATE, ResetScope.ALL])
def test_loop_makes_as_many_steps_as_requested_when_it_is_reset_meanwhile(
    scope: ResetScope,
) -> None:
    server = a_paused_server("r0")
    turns_until_answered(server, request_steps(server, 500))
    first, second = request_steps(server, 10), request_steps(server, 10)
    for _ in range(5):
        server.loop.turn()

    reset = server.request("reset_simulation", ResetSimulationRequest(scope))
    turns = 5
    while not second.is_over:
        server.loop.turn()
        turns += 1

    assert reset.is_over
    assert first.is_over
    assert turns == 20


def test_loop_finishes_requested_steps_when_it_plays_meanwhile() -> None:
    server = a_paused_server()
    call = request_steps(server, 5)
    server.request(
        "set_simulation_state", SetSimulationStateRequest(SimulationState(State.PLAYING))
    )

    assert turns_until_answered(server, call) == 5


def test_loop_refuses_a_step_request_at_once_when_it_plays() -> None:
    server = a_server()
    call = request_steps(server, 5)

    server.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE


def test_loop_replies_to_a_retry_in_place_of_a_pending_step_request() -> None:
    server = a_paused_server()
    first, retry = request_steps(server, 5), request_steps(server, 5)
    first.request_id = retry.request_id = b"the same"

    turns_until_answered(server, retry)
    server.turn_for(0.1)

    assert server.world.clock.steps == 5


def test_loop_applies_a_command_in_the_step_of_the_same_turn() -> None:
    server = a_server("r0", factor=0.0)
    server.world.claim("a", ("r0",), "stop")

    server.drive("a", 3.0, 3.0)
    server.loop.turn()

    assert wheel_speeds(server.world) == [3.0, 3.0]


def test_loop_grants_a_claim_that_comes_with_the_token() -> None:
    server = a_server("r0")
    server.inbox.agents.append(("a", True))
    call = server.request("claim_entity", ClaimEntityRequest("a", ("r0",)))

    server.loop.turn()

    response = answer_of(call, ClaimEntityResponse)
    assert isinstance(response, ClaimEntityResponse)
    assert response.result == Result()
    assert server.world.claims.agent_of("r0") == "a"


def test_loop_reports_the_cpu_time_that_delayed_a_step() -> None:
    server = a_server("r0")
    server.engine.cost_ns = 7 * MILLISECOND
    while not server.engine.began_ns:
        server.loop.turn()
    server.engine.cost_ns = 0
    server.turn_for(1.1)

    assert server.parts.pacing.loop_stats.busy_max_s == pytest.approx(0.007, abs=1e-3)


def test_requested_steps_of_a_paused_world_are_made_in_one_call() -> None:
    server = a_server("r1")
    server.world.clock.pause()
    goal = server.parts.pacing.step_goals.add(5)
    finished: list[int] = []

    server.loop.make_requested_steps(lambda: finished.append(server.world.clock.steps))

    assert finished == [1, 2, 3, 4, 5]
    assert goal.status == "succeeded"
