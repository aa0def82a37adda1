"""Loop in lockstep and at requested steps: it waits for agents, and handles requests meanwhile."""

import struct

import pytest

from tests.fakes import MemoryCall
from tests.models import on_ground
from tests.sim_server.fakes import CONTROL_STEPS, ServerFixture, a_server, a_spawn, wheel_speeds
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.agent_messages import ClaimEntityRequest, DriveCommand
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    State,
    StepSimulationRequest,
    StepSimulationResponse,
)
from zensim.proto.messages.telemetry_messages import Event, InfoRequest, Stats
from zensim.proto.network_protocols import Sample
from zensim.proto.settings.lockstep_settings import LockstepSettings, OnMiss
from zensim.proto.topic_catalog import DRIVE_COMMAND
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.runtime.loop import POLL_S, ServerLoop

TIMEOUT_S = 0.5


def a_locked_server(
    *names: str, factor: float = 0.0, is_on: bool = True, on_miss: OnMiss = "hold"
) -> ServerFixture:
    """Make a server with one agent per cart, of the same name, that does not reply by itself."""
    server = a_server(*names, factor=factor, cost_ns=1_000_000)
    server.parts.pacing.lockstep = Lockstep(
        LockstepSettings(lockstep=is_on, lockstep_timeout=TIMEOUT_S, on_miss=on_miss)
    )
    server.loop = ServerLoop(server.parts, server.inbox, server.publisher, server.wall)
    for name in names:
        server.inbox.agents.append((name, True))
        server.request("claim_entity", ClaimEntityRequest(name, (name,)))
    return server


def answer_states(
    server: ServerFixture, speed: float = 1.0, *, silent: tuple[str, ...] = ()
) -> None:
    """Reply to the drive states as the agents would."""
    sent, server.publisher.drive_states = server.publisher.drive_states, []
    for agent, state in sent:
        if agent in silent or not state.claims:
            continue
        targets = encode_targets(speed, 2 * len(state.claims) // 4)
        command = DriveCommand(state.epoch, state.step, state.claims, targets)
        send(server, agent, command)


def encode_targets(speed: float, count: int) -> bytes:
    return struct.pack(f"<{count}d", *[speed] * count)


def send(server: ServerFixture, agent: str, command: DriveCommand) -> None:
    payload = encode(command, Format.MSGPACK)
    server.inbox.commands.append(Sample(DRIVE_COMMAND.key("default", agent), payload, ""))


def result_of(call: MemoryCall) -> Result:
    (answer,) = call.answers
    return decode(StepSimulationResponse, answer.payload, answer.encoding).result


def turn(server: ServerFixture, turns: int, *, silent: tuple[str, ...] = ()) -> None:
    for _ in range(turns):
        server.loop.turn()
        answer_states(server, silent=silent)


def test_locked_loop_waits_until_every_agent_has_replied() -> None:
    server = a_locked_server("r0", "r1")
    turn(server, 5, silent=("r1",))
    stuck = (server.world.clock.steps, server.parts.pacing.lockstep.awaited)

    server.world.release("r1")
    server.inbox.agents.append(("r1", False))
    turn(server, 10)

    assert stuck == (0, ("r1",))
    assert server.world.clock.steps > CONTROL_STEPS


def test_locked_loop_makes_a_control_period_for_each_reply() -> None:
    server = a_locked_server("r0")
    server.loop.turn()

    seen = []
    for _ in range(4):
        seen.append(server.world.clock.steps)
        answer_states(server)
        for _ in range(CONTROL_STEPS + 3):
            server.loop.turn()

    assert seen == [0, 3, 6, 9]


def test_locked_loop_applies_replies_in_the_next_step() -> None:
    server = a_locked_server("r0")
    server.loop.turn()

    answer_states(server, 3.0)
    server.loop.turn()

    assert server.world.clock.steps == 1
    assert wheel_speeds(server.world) == [3.0, 3.0]


def test_locked_loop_drops_commands_for_another_step() -> None:
    server = a_locked_server("r0")
    server.loop.turn()
    ((_, state),) = server.publisher.drive_states
    early = DriveCommand(state.epoch, state.step + 3, state.claims, encode_targets(9.0, 2))

    send(server, "r0", early)
    server.loop.turn()

    assert server.world.clock.steps == 0
    assert server.world.claims.dropped == 1


def test_locked_loop_serves_while_it_waits_and_does_not_spin() -> None:
    server = a_locked_server("r0")
    server.loop.turn()
    server.wall.slept_s.clear()
    call = server.request("info", InfoRequest())

    for _ in range(10):
        server.loop.turn()

    assert call.is_over
    assert server.wall.slept_s == [POLL_S] * 10


def test_stats_list_awaited_agents() -> None:
    server = a_locked_server("r0", "r1", on_miss="wait")
    turn(server, 3, silent=("r1",))

    server.turn_for(1.2)

    stats = server.publisher.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert (stats.awaited, stats.misses) == (("r1",), {})


def test_stats_count_misses() -> None:
    server = a_locked_server("r0", on_miss="fail")

    server.turn_for(1.2)

    stats = server.publisher.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert (stats.awaited, stats.misses) == ((), {"r0": 1})


def test_holding_loop_continues_with_the_old_targets_after_the_timeout() -> None:
    server = a_locked_server("r0", on_miss="hold")
    turn(server, 10)
    rolling = wheel_speeds(server.world)
    steps = server.world.clock.steps

    server.turn_for(TIMEOUT_S - 0.1)
    while server.world.clock.steps < steps + 10:
        server.loop.turn()

    assert wheel_speeds(server.world) == rolling == [1.0, 1.0]
    assert server.parts.pacing.lockstep.misses["r0"] >= 1
    assert ("missed", "") in server.events()


def test_waiting_loop_waits_until_the_token_disappears() -> None:
    server = a_locked_server("r0", on_miss="wait")
    server.turn_for(20 * TIMEOUT_S)
    waited = server.world.clock.steps

    server.inbox.agents.append(("r0", False))
    server.turn_for(0.1)

    assert waited == 0
    assert server.world.clock.steps > 0


def test_waiting_loop_publishes_states_again() -> None:
    server = a_locked_server("r0", on_miss="wait")
    turn(server, 10)
    server.loop.turn()
    while not server.parts.pacing.lockstep.is_waiting:
        server.loop.turn()
    server.publisher.drive_states.clear()
    steps = server.world.clock.steps

    server.turn_for(2.5 * TIMEOUT_S)
    repeated = [(state.step, state.is_awaited) for _, state in server.publisher.drive_states]
    answer_states(server)
    server.turn_for(0.01)

    assert repeated == [(steps, True)] * 2
    assert server.world.clock.steps > steps


def test_failing_loop_pauses_and_reports_it() -> None:
    server = a_locked_server("r0", on_miss="fail")
    turn(server, 10)

    server.turn_for(TIMEOUT_S + 0.1)

    assert server.world.clock.state == State.PAUSED
    (missed,) = [one for one in server.publisher.on("events") if isinstance(one, Event)][-2:-1]
    assert (missed.kind, missed.agent) == ("missed", "r0")


def test_failing_loop_continues_when_played_and_the_agent_replies_again() -> None:
    server = a_locked_server("r0", on_miss="fail")
    server.turn_for(TIMEOUT_S + 0.1)
    before = server.world.clock.steps

    server.world.clock.change_state(State.PLAYING)
    turn(server, 20)

    assert server.world.clock.steps > before + CONTROL_STEPS


def test_state_is_published_at_once_after_a_claim() -> None:
    server = a_locked_server("r0", is_on=False)
    server.world.clock.pause()

    server.loop.turn()

    ((agent, state),) = server.publisher.drive_states
    assert (agent, state.step, state.is_awaited, state.newest_claim) == ("r0", 0, False, 1)


def test_states_are_published_at_once_in_a_new_epoch() -> None:
    server = a_locked_server("r0")
    turn(server, 20)
    server.publisher.drive_states.clear()

    server.world.reset(ResetScope.ALL & ~ResetScope.SPAWNED)
    server.loop.turn()

    ((agent, state), *_) = server.publisher.drive_states
    assert (agent, state.epoch, state.step) == ("r0", 1, 0)


def test_reply_of_an_old_epoch_is_dropped_after_a_reset() -> None:
    server = a_locked_server("r0")
    server.loop.turn()
    server.world.reset(ResetScope.TIME)

    answer_states(server, 9.0)
    server.loop.turn()

    assert server.world.claims.dropped == 1
    assert server.parts.pacing.lockstep.awaited == ("r0",)


def test_agent_that_claims_more_while_it_is_awaited_gets_a_new_state_and_is_awaited_again() -> None:
    server = a_locked_server("r0")
    server.loop.turn()
    server.world.spawn(a_spawn("r1", base=on_ground(5.0)))
    server.request("claim_entity", ClaimEntityRequest("r0", ("r1",)))
    server.publisher.drive_states.clear()

    server.loop.turn()
    ((_, state),) = server.publisher.drive_states
    answer_states(server)
    server.loop.turn()

    assert len(state.claims) == 8
    assert server.world.clock.steps == 1


def test_entity_that_is_deleted_while_its_agent_is_awaited_blocks_nothing() -> None:
    server = a_locked_server("r0", "r1")
    server.loop.turn()
    server.world.delete("r1")

    turn(server, 20)

    assert server.world.clock.steps > CONTROL_STEPS


@pytest.mark.parametrize("is_on", [True, False])
def test_step_request_gets_its_reply_when_the_agents_have_replied(is_on: bool) -> None:  # noqa: FBT001
    server = a_locked_server("r0", is_on=is_on)
    server.world.clock.pause()
    turn(server, 3)
    call = server.request("step_simulation", StepSimulationRequest(CONTROL_STEPS))

    for _ in range(20):
        server.loop.turn()
    was_over = call.is_over
    answer_states(server)
    server.loop.turn()

    assert (was_over, call.is_over) == (False, True)
    assert server.world.clock.steps == CONTROL_STEPS


def test_step_request_lists_late_agents_with_hold() -> None:
    server = a_locked_server("r0", is_on=False)
    server.world.clock.pause()
    turn(server, 3)
    call = server.request("step_simulation", StepSimulationRequest(4 * CONTROL_STEPS))

    server.turn_for(TIMEOUT_S + 0.2)

    result = result_of(call)
    assert result.result == ResultCode.OK
    assert "r0" in result.error_message


def test_step_request_fails_when_an_agent_is_late_with_fail() -> None:
    server = a_locked_server("r0", is_on=False, on_miss="fail")
    server.world.clock.pause()
    turn(server, 3)
    call = server.request("step_simulation", StepSimulationRequest(4 * CONTROL_STEPS))

    server.turn_for(TIMEOUT_S + 0.2)

    result = result_of(call)
    assert result.result == ResultCode.OPERATION_FAILED
    assert "'r0'" in result.error_message
    assert server.world.clock.steps == CONTROL_STEPS


def test_free_running_loop_waits_for_no_agent() -> None:
    server = a_locked_server("r0", is_on=False)

    for _ in range(20):
        server.loop.turn()

    assert server.world.clock.steps == 20
    assert not any(state.is_awaited for _, state in server.publisher.drive_states)


def test_requested_steps_wait_for_the_reply_to_the_state_of_a_claim() -> None:
    server = a_locked_server("r0", is_on=False)
    server.world.clock.pause()
    server.loop.turn()
    server.publisher.drive_states = []

    call = server.request("step_simulation", StepSimulationRequest(1))
    server.loop.turn()
    waited = server.world.clock.steps
    turn(server, 3)

    assert (waited, server.world.clock.steps) == (0, 1)
    assert result_of(call).result == ResultCode.OK


def test_state_of_a_claim_is_published_again_while_the_world_is_paused() -> None:
    server = a_locked_server("r0", is_on=False)
    server.world.clock.pause()
    server.loop.turn()
    server.publisher.drive_states = []

    server.wall.sleep(0.5)
    server.loop.turn()
    early = list(server.publisher.drive_states)
    server.wall.sleep(1.0)
    server.loop.turn()

    assert early == []
    assert [agent for agent, _ in server.publisher.drive_states] == ["r0"]
