"""Loop: agents that come, go and come again, and what becomes of their robots."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import MemoryCall
from tests.sim_server.fakes import Stage, a_command, a_stage, answer_of, names_in, wheel_speeds
from zensim.proto.bus import Sample
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.keys import drive_command
from zensim.proto.messages.agent_messages import ClaimEntityRequest, ClaimEntityResponse, OnRelease
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.telemetry_messages import GetModelsRequest, Stats


def a_driven_stage(*names: str, on_release: OnRelease = "stop") -> Stage:
    """A flat-out loop whose agent `a` drives all carts at 3 rad/s."""
    stage = a_stage(*names, factor=0.0)
    stage.inbox.agents.append(("a", True))
    stage.ask("claim_entity", ClaimEntityRequest("a", names, on_release))
    stage.loop.turn()
    stage.drive("a", *[3.0, 3.0] * len(names))
    stage.loop.turn()
    return stage


def claim_of(call: MemoryCall) -> ClaimEntityResponse:
    response = answer_of(call, ClaimEntityResponse)
    assert isinstance(response, ClaimEntityResponse)
    return response


def test_loop_stops_wheels_and_releases_claims_in_the_turn_that_an_agent_goes() -> None:
    stage = a_driven_stage("r0", "r1")
    rolling = wheel_speeds(stage.world)

    stage.inbox.agents.append(("a", False))
    stage.loop.turn()

    assert rolling == [3.0] * 4
    assert wheel_speeds(stage.world) == [0.0] * 4
    assert stage.world.claims.agents == ()
    assert stage.events()[-2:] == [("released", "r0"), ("released", "r1")]


def test_loop_lets_wheels_turn_when_an_agent_goes_that_said_keep() -> None:
    stage = a_driven_stage("r0", on_release="keep")

    stage.inbox.agents.append(("a", False))
    stage.loop.turn()

    assert wheel_speeds(stage.world) == [3.0, 3.0]
    assert stage.world.claims.agents == ()


def test_loop_deletes_robots_when_an_agent_goes_that_said_delete() -> None:
    stage = a_driven_stage("r0", on_release="delete")

    stage.inbox.agents.append(("a", False))
    stage.loop.turn()

    assert names_in(stage.world) == []


def test_loop_forgets_an_agent_that_has_gone_and_tells_it_nothing_more() -> None:
    stage = a_driven_stage("r0")
    stage.inbox.agents.append(("a", False))
    stage.loop.turn()
    stage.outlet.drive_states.clear()

    for _ in range(12):
        stage.loop.turn()

    assert stage.outlet.forgotten == ["a"]
    assert stage.outlet.drive_states == []


def test_loop_drops_the_last_command_of_an_agent_that_has_gone() -> None:
    stage = a_driven_stage("r0")

    stage.drive("a", 9.0, 9.0)
    stage.inbox.agents.append(("a", False))
    stage.loop.turn()

    assert wheel_speeds(stage.world) == [0.0, 0.0]
    assert stage.world.claims.dropped == 1


def test_loop_refuses_a_claim_when_its_token_goes_in_the_same_turn() -> None:
    stage = a_stage("r0")
    stage.inbox.agents += [("a", True), ("a", False)]
    call = stage.ask("claim_entity", ClaimEntityRequest("a", ("r0",)))

    stage.loop.turn()

    assert claim_of(call).result.result == ResultCode.INCORRECT_STATE
    assert stage.world.claims.agent_of("r0") == ""


def test_loop_grants_a_claim_anew_when_an_agent_goes_and_comes_in_one_turn() -> None:
    stage = a_driven_stage("r0")
    old = stage.world.fleets()["a"].claims
    stage.inbox.agents += [("a", False), ("a", True)]
    call = stage.ask("claim_entity", ClaimEntityRequest("a", ("r0",)))

    stage.loop.turn()

    assert claim_of(call).result.result == ResultCode.OK
    assert stage.world.fleets()["a"].claims != old


def test_loop_lets_another_agent_claim_what_was_left() -> None:
    stage = a_driven_stage("r0")
    stage.inbox.agents += [("a", False), ("b", True)]
    call = stage.ask("claim_entity", ClaimEntityRequest("b", ("r0",)))

    stage.loop.turn()

    assert claim_of(call).result.result == ResultCode.OK
    assert stage.world.claims.agent_of("r0") == "b"


def test_loop_takes_agents_that_nobody_has_heard_of() -> None:
    stage = a_stage("r0")

    stage.inbox.agents += [("", True), ("ghost", False), ("no name!", False)]
    stage.loop.turn()

    assert stage.world.claims.agents == ()


def test_loop_tells_agents_of_every_control_step() -> None:
    stage = a_driven_stage("r0")
    stage.outlet.drive_states.clear()

    for _ in range(9):
        stage.wall.sleep(0.001)
        stage.drive("a", 3.0, 3.0)
        stage.loop.turn()

    assert steps_told(stage) == [3, 6, 9]


def test_loop_tells_no_more_often_than_agents_answer_when_time_runs_fast() -> None:
    stage = a_driven_stage("r0")
    stage.outlet.drive_states.clear()

    for _ in range(60):
        stage.wall.sleep(0.0001)
        stage.drive("a", 3.0, 3.0)
        stage.loop.turn()

    assert steps_told(stage) == [3, 24, 45]


def test_loop_waits_for_an_answer_before_it_tells_more_when_time_runs_fast_but_not_long() -> None:
    stage = a_stage("r0", "r1", factor=0.0)
    for agent, name in (("prompt", "r0"), ("silent", "r1")):
        stage.inbox.agents.append((agent, True))
        stage.ask("claim_entity", ClaimEntityRequest(agent, (name,), "stop"))
    stage.loop.turn()
    stage.outlet.drive_states.clear()

    for _ in range(12):
        stage.wall.sleep(0.003)
        stage.drive("prompt", 3.0, 3.0)
        stage.loop.turn()

    told = [(agent, state.step) for agent, state in stage.outlet.drive_states]
    assert [step for agent, step in told if agent == "prompt"] == [3, 6, 9, 12]
    assert [step for agent, step in told if agent == "silent"] == [9]


def test_loop_tells_where_robots_came_to_when_time_stands_again() -> None:
    stage = a_driven_stage("r0")
    for _ in range(9):
        stage.loop.turn()
    stage.outlet.drive_states.clear()

    stage.world.pause()
    stage.loop.turn()
    stage.loop.turn()

    assert steps_told(stage) == [stage.world.steps]


def steps_told(stage: Stage) -> list[int]:
    return [state.step for _, state in stage.outlet.drive_states]


def test_loop_tells_an_agent_80_times_a_second_at_240_steps() -> None:
    stage = a_stage("r0")
    stage.world.claim("a", ("r0",), "stop")

    stage.turn_for(3.0)

    assert len(stage.outlet.drive_states) == pytest.approx(3 * 80, abs=1)


def test_loop_tells_how_long_a_robot_took_to_be_driven() -> None:
    stage = a_stage("r0")
    born_ns = stage.world.entity("r0").born_ns
    stage.world.claim("a", ("r0",), "stop")
    stage.turn_for(0.5)

    stage.drive("a", 1.0, 1.0)
    driven_ns = stage.wall.ns
    stage.turn_for(1.0)

    stats = stage.outlet.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert stats.ready_s == {"r0": pytest.approx((driven_ns - born_ns) * 1e-9, abs=1e-3)}


def test_loop_takes_no_robot_for_driven_when_its_command_was_dropped() -> None:
    stage = a_stage("r0")
    stage.world.claim("a", ("r0",), "stop")

    stage.drive("a", 1.0)
    stage.loop.turn()

    assert stage.world.ready_s == {}
    assert stage.world.claims.dropped == 1


@given(
    payload=st.binary(max_size=80),
    encoding=st.sampled_from(["", "application/cdr", "application/json", "text/plain"]),
    agent=st.sampled_from(["a", "b", "*"]),
)
def test_loop_drops_and_counts_any_bytes_for_a_command(
    payload: bytes, encoding: str, agent: str
) -> None:
    stage = a_driven_stage("r0")

    stage.inbox.commands.append(Sample(drive_command("default", agent), payload, encoding))
    stage.loop.turn()

    assert stage.world.claims.dropped == 1
    assert wheel_speeds(stage.world) == [3.0, 3.0]


@given(
    claims=st.binary(max_size=12),
    targets=st.binary(max_size=40),
    epoch=st.integers(0, 2),
    step=st.integers(0, 2**63),
)
def test_loop_drops_and_counts_any_command_that_does_not_fit(
    claims: bytes, targets: bytes, epoch: int, step: int
) -> None:
    stage = a_driven_stage("r0")
    fitting = a_command(stage.world, "a", 0.0, 0.0)
    command = type(fitting)(epoch, step, claims, targets)
    is_fitting = (epoch, claims, len(targets)) == (0, fitting.claims, 16)

    stage.inbox.commands.append(
        Sample(drive_command("default", "a"), encode(command, Format.MSGPACK), "")
    )
    stage.loop.turn()

    assert stage.world.claims.dropped == (not is_fitting)
    assert np.isfinite(wheel_speeds(stage.world)).all()


@pytest.mark.parametrize("key", ["sim/default/drive", "sim/default/drive/a/b/command", "x", ""])
def test_loop_drops_a_command_on_a_key_of_nobody(key: str) -> None:
    stage = a_driven_stage("r0")
    good = encode(a_command(stage.world, "a", 9.0, 9.0), Format.MSGPACK)

    stage.inbox.commands.append(Sample(key, good, ""))
    stage.loop.turn()

    assert stage.world.claims.dropped == 1
    assert wheel_speeds(stage.world) == [3.0, 3.0]


def test_loop_tells_who_drives_a_robot() -> None:
    stage = a_driven_stage("r0")
    call = stage.ask("get_models", GetModelsRequest())

    stage.loop.turn()

    assert call.is_over
    assert stage.world.claims.agent_of("r0") == "a"
