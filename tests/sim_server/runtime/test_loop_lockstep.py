"""Loop in lockstep, and at requested steps: it waits for the agents, and serves meanwhile."""

import struct

import pytest

from tests.fakes import MemoryCall
from tests.models import on_ground
from tests.sim_server.fakes import CONTROL_STEPS, Stage, a_birth, a_stage, wheel_speeds
from zensim.proto.bus import Sample
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.keys import drive_command
from zensim.proto.messages.agent_messages import ClaimEntityRequest, DriveCommand
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    State,
    StepSimulationRequest,
    StepSimulationResponse,
)
from zensim.proto.messages.telemetry_messages import Event, InfoRequest, Stats
from zensim.sim_server.pacing.lockstep import Lockstep, LockstepSettings, OnMiss
from zensim.sim_server.runtime.loop import POLL_S, ServerLoop

TIMEOUT_S = 0.5


def a_locked_stage(
    *names: str, factor: float = 0.0, is_on: bool = True, on_miss: OnMiss = "hold"
) -> Stage:
    """A stage whose carts have an agent each, of their names, that does not answer by itself."""
    stage = a_stage(*names, factor=factor, cost_ns=1_000_000)
    stage.context.lockstep = Lockstep(LockstepSettings(is_on, TIMEOUT_S, on_miss))
    stage.loop = ServerLoop(stage.context, stage.inbox, stage.outlet, stage.wall)
    for name in names:
        stage.inbox.agents.append((name, True))
        stage.ask("claim_entity", ClaimEntityRequest(name, (name,)))
    return stage


def answer_states(stage: Stage, speed: float = 1.0, *, silent: tuple[str, ...] = ()) -> None:
    """Let the agents answer what they were told."""
    told, stage.outlet.drive_states = stage.outlet.drive_states, []
    for agent, state in told:
        if agent in silent or not state.claims:
            continue
        targets = encode_targets(speed, 2 * len(state.claims) // 4)
        command = DriveCommand(state.epoch, state.step, state.claims, targets)
        send(stage, agent, command)


def encode_targets(speed: float, count: int) -> bytes:
    return struct.pack(f"<{count}d", *[speed] * count)


def send(stage: Stage, agent: str, command: DriveCommand) -> None:
    payload = encode(command, Format.MSGPACK)
    stage.inbox.commands.append(Sample(drive_command("default", agent), payload, ""))


def result_of(call: MemoryCall) -> Result:
    (answer,) = call.answers
    return decode(StepSimulationResponse, answer.payload, answer.encoding).result


def turn(stage: Stage, turns: int, *, silent: tuple[str, ...] = ()) -> None:
    for _ in range(turns):
        stage.loop.turn()
        answer_states(stage, silent=silent)


def test_locked_loop_stands_until_every_agent_has_answered() -> None:
    stage = a_locked_stage("r0", "r1")
    turn(stage, 5, silent=("r1",))
    stuck = (stage.world.steps, stage.context.lockstep.awaited)

    stage.world.release("r1")
    stage.inbox.agents.append(("r1", False))
    turn(stage, 10)

    assert stuck == (0, ("r1",))
    assert stage.world.steps > CONTROL_STEPS


def test_locked_loop_makes_a_control_period_for_each_answer() -> None:
    stage = a_locked_stage("r0")
    stage.loop.turn()

    seen = []
    for _ in range(4):
        seen.append(stage.world.steps)
        answer_states(stage)
        for _ in range(CONTROL_STEPS + 3):
            stage.loop.turn()

    assert seen == [0, 3, 6, 9]


def test_locked_loop_carries_out_what_was_answered_in_the_very_next_step() -> None:
    stage = a_locked_stage("r0")
    stage.loop.turn()

    answer_states(stage, 3.0)
    stage.loop.turn()

    assert stage.world.steps == 1
    assert wheel_speeds(stage.world) == [3.0, 3.0]


def test_locked_loop_drops_commands_for_another_step() -> None:
    stage = a_locked_stage("r0")
    stage.loop.turn()
    ((_, state),) = stage.outlet.drive_states
    early = DriveCommand(state.epoch, state.step + 3, state.claims, encode_targets(9.0, 2))

    send(stage, "r0", early)
    stage.loop.turn()

    assert stage.world.steps == 0
    assert stage.world.claims.dropped == 1


def test_locked_loop_serves_while_it_waits_and_does_not_spin() -> None:
    stage = a_locked_stage("r0")
    stage.loop.turn()
    stage.wall.slept_s.clear()
    call = stage.ask("info", InfoRequest())

    for _ in range(10):
        stage.loop.turn()

    assert call.is_over
    assert stage.wall.slept_s == [POLL_S] * 10


def test_stats_say_who_is_awaited() -> None:
    stage = a_locked_stage("r0", "r1", on_miss="wait")
    turn(stage, 3, silent=("r1",))

    stage.turn_for(1.2)

    stats = stage.outlet.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert (stats.awaited, stats.misses) == (("r1",), {})


def test_stats_say_who_has_missed() -> None:
    stage = a_locked_stage("r0", on_miss="fail")

    stage.turn_for(1.2)

    stats = stage.outlet.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert (stats.awaited, stats.misses) == ((), {"r0": 1})


def test_holding_loop_goes_on_with_the_old_targets_after_the_timeout() -> None:
    stage = a_locked_stage("r0", on_miss="hold")
    turn(stage, 10)
    rolling = wheel_speeds(stage.world)
    steps = stage.world.steps

    stage.turn_for(TIMEOUT_S + 0.1)

    assert stage.world.steps > steps
    assert wheel_speeds(stage.world) == rolling == [1.0, 1.0]
    assert stage.context.lockstep.misses["r0"] >= 1
    assert ("missed", "") in stage.events()


def test_waiting_loop_waits_until_the_token_goes() -> None:
    stage = a_locked_stage("r0", on_miss="wait")
    stage.turn_for(20 * TIMEOUT_S)
    waited = stage.world.steps

    stage.inbox.agents.append(("r0", False))
    stage.turn_for(0.1)

    assert waited == 0
    assert stage.world.steps > 0


def test_waiting_loop_tells_again_what_may_have_been_lost() -> None:
    stage = a_locked_stage("r0", on_miss="wait")
    turn(stage, 10)
    stage.loop.turn()
    while not stage.context.lockstep.is_waiting:
        stage.loop.turn()
    stage.outlet.drive_states.clear()
    steps = stage.world.steps

    stage.turn_for(2.5 * TIMEOUT_S)
    repeated = [(state.step, state.is_awaited) for _, state in stage.outlet.drive_states]
    answer_states(stage)
    stage.turn_for(0.01)

    assert repeated == [(steps, True)] * 2
    assert stage.world.steps > steps


def test_failing_loop_stands_still_and_says_so() -> None:
    stage = a_locked_stage("r0", on_miss="fail")
    turn(stage, 10)

    stage.turn_for(TIMEOUT_S + 0.1)

    assert stage.world.state == State.PAUSED
    (missed,) = [one for one in stage.outlet.on("events") if isinstance(one, Event)][-2:-1]
    assert (missed.kind, missed.agent) == ("missed", "r0")
    assert "did not answer step" in missed.message


def test_failing_loop_goes_on_when_it_is_told_to_play_and_the_agent_answers_again() -> None:
    stage = a_locked_stage("r0", on_miss="fail")
    stage.turn_for(TIMEOUT_S + 0.1)
    before = stage.world.steps

    stage.world.play()
    turn(stage, 20)

    assert stage.world.steps > before + CONTROL_STEPS


def test_agent_is_told_at_once_what_it_has_claimed() -> None:
    stage = a_locked_stage("r0", is_on=False)
    stage.world.pause()

    stage.loop.turn()

    ((agent, state),) = stage.outlet.drive_states
    assert (agent, state.step, state.is_awaited, state.newest_claim) == ("r0", 0, False, 1)


def test_agents_are_told_at_once_of_a_new_epoch() -> None:
    stage = a_locked_stage("r0")
    turn(stage, 20)
    stage.outlet.drive_states.clear()

    stage.world.reset(ResetScope.ALL & ~ResetScope.SPAWNED)
    stage.loop.turn()

    ((agent, state), *_) = stage.outlet.drive_states
    assert (agent, state.epoch, state.step) == ("r0", 1, 0)


def test_answer_of_an_old_epoch_is_dropped_after_a_reset() -> None:
    stage = a_locked_stage("r0")
    stage.loop.turn()
    stage.world.reset(ResetScope.TIME)

    answer_states(stage, 9.0)
    stage.loop.turn()

    assert stage.world.claims.dropped == 1
    assert stage.context.lockstep.awaited == ("r0",)


def test_agent_that_claims_more_while_it_is_awaited_is_told_and_awaited_anew() -> None:
    stage = a_locked_stage("r0")
    stage.loop.turn()
    stage.world.spawn(a_birth("r1", base=on_ground(5.0)))
    stage.ask("claim_entity", ClaimEntityRequest("r0", ("r1",)))
    stage.outlet.drive_states.clear()

    stage.loop.turn()
    ((_, state),) = stage.outlet.drive_states
    answer_states(stage)
    stage.loop.turn()

    assert len(state.claims) == 8
    assert stage.world.steps == 1


def test_entity_that_is_deleted_while_its_agent_is_awaited_stops_nothing() -> None:
    stage = a_locked_stage("r0", "r1")
    stage.loop.turn()
    stage.world.delete("r1")

    turn(stage, 20)

    assert stage.world.steps > CONTROL_STEPS


@pytest.mark.parametrize("is_on", [True, False])
def test_step_request_is_answered_when_the_agents_have_answered(is_on: bool) -> None:  # noqa: FBT001
    stage = a_locked_stage("r0", is_on=is_on)
    stage.world.pause()
    turn(stage, 3)
    call = stage.ask("step_simulation", StepSimulationRequest(CONTROL_STEPS))

    for _ in range(20):
        stage.loop.turn()
    was_over = call.is_over
    answer_states(stage)
    stage.loop.turn()

    assert (was_over, call.is_over) == (False, True)
    assert stage.world.steps == CONTROL_STEPS


def test_step_request_says_who_did_not_answer_when_it_holds() -> None:
    stage = a_locked_stage("r0", is_on=False)
    stage.world.pause()
    turn(stage, 3)
    call = stage.ask("step_simulation", StepSimulationRequest(4 * CONTROL_STEPS))

    stage.turn_for(TIMEOUT_S + 0.2)

    result = result_of(call)
    assert result.result == ResultCode.OK
    assert result.error_message == "not all steps were answered in time by: r0"


def test_step_request_fails_when_an_agent_is_late_and_that_is_to_fail() -> None:
    stage = a_locked_stage("r0", is_on=False, on_miss="fail")
    stage.world.pause()
    turn(stage, 3)
    call = stage.ask("step_simulation", StepSimulationRequest(4 * CONTROL_STEPS))

    stage.turn_for(TIMEOUT_S + 0.2)

    result = result_of(call)
    assert result.result == ResultCode.OPERATION_FAILED
    assert result.error_message.startswith("ended after 3 of 12 steps: agent 'r0' did not answer")
    assert stage.world.steps == CONTROL_STEPS


def test_free_running_loop_waits_for_nobody() -> None:
    stage = a_locked_stage("r0", is_on=False)

    for _ in range(20):
        stage.loop.turn()

    assert stage.world.steps == 20
    assert not any(state.is_awaited for _, state in stage.outlet.drive_states)
