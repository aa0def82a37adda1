"""Loop: agents that appear and disappear, and their robots."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import MemoryCall
from tests.models import on_ground
from tests.sim_server.fakes import (
    ServerFixture,
    a_command,
    a_server,
    a_spawn,
    answer_of,
    floats,
    names_in,
    wheel_speeds,
)
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import (
    ClaimEntityRequest,
    ClaimEntityResponse,
    OnRelease,
    TwistCommands,
)
from zensim.proto.messages.result_messages import ClaimCode, ResultCode
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.proto.messages.telemetry_messages import Event, GetModelsRequest, Stats
from zensim.proto.network_protocols import Sample
from zensim.proto.topic_catalog import DRIVE_COMMAND, TWISTS
from zensim.sim_server.runtime.loop import TAKEOVER_NS
from zensim.sim_server.service_parts import ShareGrace


def a_driven_server(*names: str, on_release: OnRelease = "stop") -> ServerFixture:
    """A flat-out loop whose agent `a` drives all carts at 3 rad/s."""
    server = a_server(*names, factor=0.0)
    server.inbox.agents.append(("a", True))
    server.request("claim_entity", ClaimEntityRequest("a", names, on_release))
    server.loop.turn()
    server.drive("a", *[3.0, 3.0] * len(names))
    server.loop.turn()
    return server


def claim_of(call: MemoryCall) -> ClaimEntityResponse:
    response = answer_of(call, ClaimEntityResponse)
    assert isinstance(response, ClaimEntityResponse)
    return response


def test_loop_stops_wheels_and_releases_claims_in_the_turn_that_an_agent_disappears() -> None:
    server = a_driven_server("r0", "r1")
    rolling = wheel_speeds(server.world)

    server.inbox.agents.append(("a", False))
    server.loop.turn()

    assert rolling == [3.0] * 4
    assert wheel_speeds(server.world) == [0.0] * 4
    assert server.world.claims.agents == ()
    assert server.events()[-2:] == [("released", "r0"), ("released", "r1")]


def test_loop_keeps_wheels_turning_when_an_agent_with_keep_disappears() -> None:
    server = a_driven_server("r0", on_release="keep")

    server.inbox.agents.append(("a", False))
    server.loop.turn()

    assert wheel_speeds(server.world) == [3.0, 3.0]
    assert server.world.claims.agents == ()


def test_loop_deletes_robots_when_an_agent_with_delete_disappears() -> None:
    server = a_driven_server("r0", on_release="delete")

    server.inbox.agents.append(("a", False))
    server.loop.turn()

    assert names_in(server.world) == []


def test_loop_publishes_nothing_for_an_agent_that_has_disappeared() -> None:
    server = a_driven_server("r0")
    server.inbox.agents.append(("a", False))
    server.loop.turn()
    server.publisher.drive_states.clear()

    for _ in range(12):
        server.loop.turn()

    assert server.publisher.forgotten == ["a"]
    assert server.publisher.drive_states == []


def test_loop_drops_the_last_command_of_an_agent_that_has_disappeared() -> None:
    server = a_driven_server("r0")

    server.drive("a", 9.0, 9.0)
    server.inbox.agents.append(("a", False))
    server.loop.turn()

    assert wheel_speeds(server.world) == [0.0, 0.0]
    assert server.world.claims.dropped == 1


def test_loop_warns_once_when_an_agent_begins_to_withhold_messages() -> None:
    server = a_driven_server("r0")
    server.events()

    for withheld_hz in (0, 900, 800, 0, 700):
        withheld = msgspec.structs.replace(
            a_command(server.world, "a", 3.0, 3.0), withheld_hz=withheld_hz
        )
        key = DRIVE_COMMAND.key("default", "a")
        server.inbox.commands.append(Sample(key, encode(withheld, Format.MSGPACK), ""))
        server.loop.turn()

    assert [kind for kind, _ in server.events()].count("warning") == 2


def test_loop_refuses_a_claim_when_its_token_disappears_in_the_same_turn() -> None:
    server = a_server("r0")
    server.inbox.agents += [("a", True), ("a", False)]
    call = server.request("claim_entity", ClaimEntityRequest("a", ("r0",)))

    server.loop.turn()

    assert claim_of(call).result.result == ResultCode.INCORRECT_STATE
    assert server.world.claims.agent_of("r0") == ""


def test_loop_grants_a_claim_again_when_an_agent_restarts_in_one_turn() -> None:
    server = a_driven_server("r0")
    old = server.world.claimed_by_agent()["a"].claims
    server.inbox.agents += [("a", False), ("a", True)]
    call = server.request("claim_entity", ClaimEntityRequest("a", ("r0",)))

    server.loop.turn()

    assert claim_of(call).result.result == ResultCode.OK
    assert server.world.claimed_by_agent()["a"].claims != old


def test_loop_lets_another_agent_claim_released_robots() -> None:
    server = a_driven_server("r0")
    server.inbox.agents += [("a", False), ("b", True)]
    call = server.request("claim_entity", ClaimEntityRequest("b", ("r0",)))

    server.loop.turn()

    assert claim_of(call).result.result == ResultCode.OK
    assert server.world.claims.agent_of("r0") == "b"


def test_loop_accepts_unknown_agents() -> None:
    server = a_server("r0")

    server.inbox.agents += [("", True), ("ghost", False), ("no name!", False)]
    server.loop.turn()

    assert server.world.claims.agents == ()


def test_loop_publishes_every_control_step_to_agents() -> None:
    server = a_driven_server("r0")
    server.publisher.drive_states.clear()

    for _ in range(9):
        server.wall.sleep(0.001)
        server.drive("a", 3.0, 3.0)
        server.loop.turn()

    assert sent_steps(server) == [3, 6, 9]


def test_loop_publishes_no_faster_than_agents_reply_when_flat_out() -> None:
    server = a_driven_server("r0")
    server.publisher.drive_states.clear()

    for _ in range(60):
        server.wall.sleep(0.0001)
        server.drive("a", 3.0, 3.0)
        server.loop.turn()

    assert sent_steps(server) == [3, 24, 45]


def test_loop_waits_a_limited_time_for_a_reply_when_flat_out() -> None:
    server = a_server("r0", "r1", factor=0.0)
    for agent, name in (("prompt", "r0"), ("silent", "r1")):
        server.inbox.agents.append((agent, True))
        server.request("claim_entity", ClaimEntityRequest(agent, (name,), "stop"))
    server.loop.turn()
    server.publisher.drive_states.clear()

    for _ in range(12):
        server.wall.sleep(0.003)
        server.drive("prompt", 3.0, 3.0)
        server.loop.turn()

    sent = [(agent, state.step) for agent, state in server.publisher.drive_states]
    assert [step for agent, step in sent if agent == "prompt"] == [3, 6, 9, 12]
    assert [step for agent, step in sent if agent == "silent"] == [9]


def test_loop_publishes_a_state_again_20_ms_after_one_without_a_reply() -> None:
    server = a_server("r0", factor=0.0)
    server.inbox.agents.append(("silent", True))
    server.request("claim_entity", ClaimEntityRequest("silent", ("r0",), "stop"))
    server.loop.turn()
    server.publisher.drive_states.clear()

    seen = []
    for before_s in (0.0, 0.015, 0.0, 0.0, 0.005):
        server.wall.sleep(before_s)
        server.loop.turn()
        seen.append(sent_steps(server))

    assert seen == [[], [], [], [], [6]]


def test_loop_publishes_the_last_state_when_paused() -> None:
    server = a_driven_server("r0")
    for _ in range(9):
        server.loop.turn()
    server.publisher.drive_states.clear()

    server.world.clock.pause()
    server.loop.turn()
    server.loop.turn()

    assert sent_steps(server) == [server.world.clock.steps]


def sent_steps(server: ServerFixture) -> list[int]:
    return [state.step for _, state in server.publisher.drive_states]


def test_loop_publishes_states_at_80_hz_with_240_steps() -> None:
    server = a_server("r0")
    server.world.claim("a", ("r0",), "stop")

    server.turn_for(3.0)

    assert len(server.publisher.drive_states) == pytest.approx(3 * 80, abs=1)


def test_loop_reports_the_time_until_a_robot_is_driven() -> None:
    server = a_server("r0")
    born_ns = server.world.entities.find("r0").born_ns
    server.world.claim("a", ("r0",), "stop")
    server.turn_for(0.5)

    server.drive("a", 1.0, 1.0)
    driven_ns = server.wall.ns
    server.turn_for(1.0)

    stats = server.publisher.on("stats")[-1]
    assert isinstance(stats, Stats)
    assert stats.ready_s == {"r0": pytest.approx((driven_ns - born_ns) * 1e-9, abs=1e-3)}


def test_loop_reports_no_ready_robot_when_its_command_was_dropped() -> None:
    server = a_server("r0")
    server.world.claim("a", ("r0",), "stop")

    server.drive("a", 1.0)
    server.loop.turn()

    assert server.world.ready_s == {}
    assert server.world.claims.dropped == 1


def test_stats_show_an_agent_that_misses_states() -> None:
    server = a_server("r0", "r1")
    server.world.claim("good", ("r0",), "stop")
    server.world.claim("starved", ("r1",), "stop")
    server.drive("starved", 1.0, 1.0)

    for _ in range(250):
        server.drive("good", 1.0, 1.0)
        server.turn_for(0.01)

    stats = server.publisher.on("stats")[-1]
    assert isinstance(stats, Stats)
    good, starved = stats.agent_commands["good"], stats.agent_commands["starved"]
    assert good.due_hz == starved.due_hz == pytest.approx(80.0, rel=0.1)
    assert good.taken_hz >= 0.9 * good.due_hz
    assert (starved.taken, starved.taken_hz) == (1, 0.0)
    assert stats.real_time_factor == pytest.approx(1.0, abs=0.05)
    assert server.parts.pacing.loop_stats.commands.least_share == 0.0


@given(
    payload=st.binary(max_size=80),
    encoding=st.sampled_from(["", "application/cdr", "application/json", "text/plain"]),
    agent=st.sampled_from(["a", "b", "*"]),
)
def test_loop_drops_and_counts_any_bytes_for_a_command(
    payload: bytes, encoding: str, agent: str
) -> None:
    server = a_driven_server("r0")

    server.inbox.commands.append(Sample(DRIVE_COMMAND.key("default", agent), payload, encoding))
    server.loop.turn()

    assert server.world.claims.dropped == 1
    assert wheel_speeds(server.world) == [3.0, 3.0]


@given(
    claims=st.binary(max_size=12),
    targets=st.binary(max_size=40),
    epoch=st.integers(0, 2),
    step=st.integers(0, 2**63),
)
def test_loop_drops_and_counts_any_command_that_does_not_fit(
    claims: bytes, targets: bytes, epoch: int, step: int
) -> None:
    server = a_driven_server("r0")
    fitting = a_command(server.world, "a", 0.0, 0.0)
    command = type(fitting)(epoch, step, claims, targets)
    is_fitting = (epoch, claims, len(targets)) == (0, fitting.claims, 16)

    server.inbox.commands.append(
        Sample(DRIVE_COMMAND.key("default", "a"), encode(command, Format.MSGPACK), "")
    )
    server.loop.turn()

    assert server.world.claims.dropped == (not is_fitting)
    assert np.isfinite(wheel_speeds(server.world)).all()


@pytest.mark.parametrize("key", ["sim/default/drive", "sim/default/drive/a/b/command", "x", ""])
def test_loop_drops_a_command_of_an_unknown_agent(key: str) -> None:
    server = a_driven_server("r0")
    good = encode(a_command(server.world, "a", 9.0, 9.0), Format.MSGPACK)

    server.inbox.commands.append(Sample(key, good, ""))
    server.loop.turn()

    assert server.world.claims.dropped == 1
    assert wheel_speeds(server.world) == [3.0, 3.0]


def test_loop_reports_the_agent_of_a_robot() -> None:
    server = a_driven_server("r0")
    call = server.request("get_models", GetModelsRequest())

    server.loop.turn()

    assert call.is_over
    assert server.world.claims.agent_of("r0") == "a"


def a_paced_driven_server(*names: str, on_release: OnRelease = "stop") -> ServerFixture:
    """A loop at real time whose agent `a` drives all carts at 3 rad/s."""
    server = a_server(*names)
    server.inbox.agents.append(("a", True))
    server.request("claim_entity", ClaimEntityRequest("a", names, on_release))
    server.turn_for(0.01)
    server.drive("a", *[3.0, 3.0] * len(names))
    server.turn_for(0.01)
    return server


def rest(server: ServerFixture, seconds: float) -> None:
    """Let agent `a` say that it needs no state for a while."""
    command = msgspec.structs.replace(
        a_command(server.world, "a", 3.0, 3.0), rest_ns=round(seconds * 1e9)
    )
    key = DRIVE_COMMAND.key("default", "a")
    server.inbox.commands.append(Sample(key, encode(command, Format.MSGPACK), ""))


def test_loop_publishes_no_state_to_an_agent_that_rests() -> None:
    server = a_paced_driven_server("r0")
    rest(server, 0.1)
    server.turn_for(0.02)
    before = len(sent_steps(server))

    server.turn_for(0.07)
    resting = len(sent_steps(server))
    server.turn_for(0.03)

    assert resting == before
    assert len(sent_steps(server)) > before
    assert wheel_speeds(server.world) == [3.0, 3.0]


def test_rest_ends_with_the_next_command() -> None:
    server = a_paced_driven_server("r0")
    rest(server, 0.2)
    server.turn_for(0.02)
    before = len(sent_steps(server))

    server.drive("a", 2.0, 2.0)
    server.turn_for(0.05)

    assert len(sent_steps(server)) > before


def order_a_twist(server: ServerFixture) -> None:
    orders = TwistCommands("c", ("r0",), floats([1.0, 0.0, 0.0]))
    server.inbox.twists.append(Sample(TWISTS.key("default"), encode(orders, Format.MSGPACK), ""))


@pytest.mark.parametrize(
    "change",
    [
        order_a_twist,
        lambda server: server.world.clock.pause(),
        lambda server: server.world.reset(ResetScope.TIME),
        lambda server: server.world.claim("a", ("r1",), "stop"),
    ],
    ids=["ordered twist", "pause", "reset", "claim"],
)
def test_rest_ends_when_anything_else_changes(change: Callable[[ServerFixture], object]) -> None:
    server = a_paced_driven_server("r0")
    server.world.spawn(a_spawn("r1", base=on_ground(3.0)))
    rest(server, 0.2)
    server.turn_for(0.03)
    before = len(sent_steps(server))

    change(server)
    server.turn_for(0.03)

    assert len(sent_steps(server)) > before


def timed_out(server: ServerFixture) -> list[tuple[str, str]]:
    sent = [event for event in server.publisher.on("events") if isinstance(event, Event)]
    return [(event.entity, event.agent) for event in sent if event.kind == "timed_out"]


def test_loop_stops_the_robots_of_a_silent_agent_after_the_timeout() -> None:
    server = a_paced_driven_server("r0", "r1")
    commanded_ns = server.world.clock.time_ns

    server.turn_for(0.37)
    before = wheel_speeds(server.world)
    server.turn_for(0.03)

    assert server.world.clock.time_ns - commanded_ns < 415_000_000
    assert before == [3.0] * 4
    assert wheel_speeds(server.world) == [0.0] * 4
    assert timed_out(server) == [("r0", "a"), ("r1", "a")]
    assert server.world.claims.agent_of("r0") == "a"


def test_loop_reports_a_silent_agent_once_and_obeys_it_again() -> None:
    server = a_paced_driven_server("r0")
    server.turn_for(2.0)
    reported = timed_out(server)

    server.drive("a", 2.0, 2.0)
    server.turn_for(0.35)

    assert reported == [("r0", "a")]
    assert wheel_speeds(server.world) == [2.0, 2.0]
    server.turn_for(0.2)
    assert wheel_speeds(server.world) == [0.0, 0.0]
    assert timed_out(server) == [("r0", "a")] * 2


def test_loop_drives_on_while_commands_come() -> None:
    server = a_paced_driven_server("r0")

    for _ in range(20):
        server.drive("a", 3.0, 3.0)
        server.turn_for(0.3)

    assert wheel_speeds(server.world) == [3.0, 3.0]
    assert timed_out(server) == []


def test_loop_lets_a_silent_agent_with_keep_drive_on() -> None:
    server = a_paced_driven_server("r0", on_release="keep")

    server.turn_for(2.0)

    assert wheel_speeds(server.world) == [3.0, 3.0]
    assert timed_out(server) == []


def test_loop_does_not_take_agents_for_silent_while_time_stands() -> None:
    server = a_paced_driven_server("r0")

    server.world.clock.pause()
    server.turn_for(5.0)
    server.world.clock.change_state(State.PLAYING)
    server.turn_for(0.3)

    assert timed_out(server) == []


def test_loop_gives_agents_wall_time_to_reply_when_time_runs_fast() -> None:
    server = a_driven_server("r0")

    while server.world.clock.time_ns < 20_000_000_000:
        server.wall.sleep(0.00001)
        server.loop.turn()

    assert timed_out(server) == []
    assert wheel_speeds(server.world) == [3.0, 3.0]


def test_loop_counts_silence_from_a_reset_on() -> None:
    server = a_paced_driven_server("r0")
    server.turn_for(0.3)
    server.world.reset(ResetScope.TIME)
    server.turn_for(0.3)
    before = timed_out(server)

    server.turn_for(0.2)

    assert before == []
    assert timed_out(server) == [("r0", "a")]


def test_loop_stops_robots_of_an_agent_that_never_commands() -> None:
    server = a_paced_driven_server("r0", on_release="keep")
    server.inbox.agents += [("a", False), ("b", True)]
    server.turn_for(0.01)
    server.request("claim_entity", ClaimEntityRequest("b", ("r0",), "stop"))

    server.turn_for(1.0)

    assert wheel_speeds(server.world) == [0.0, 0.0]
    assert timed_out(server) == [("r0", "b")]


def test_loop_lets_another_agent_claim_the_robots_of_a_silent_one() -> None:
    server = a_paced_driven_server("r0")
    server.inbox.agents.append(("b", True))
    early = server.request("claim_entity", ClaimEntityRequest("b", ("r0",)))
    server.turn_for(0.6)
    late = server.request("claim_entity", ClaimEntityRequest("b", ("r0",)))

    server.turn_for(0.1)

    assert claim_of(early).result.result == ClaimCode.ALREADY_CLAIMED
    assert claim_of(late).result.result == ResultCode.OK
    assert server.world.claims.agent_of("r0") == "b"
    assert ("a", b"") in [(who, state.claims) for who, state in server.publisher.drive_states]


def test_loop_waits_anew_when_the_claims_of_an_agent_change() -> None:
    server = a_paced_driven_server("r0", "r1")
    server.turn_for(0.3)
    server.world.delete("r1")

    server.turn_for(0.3)

    assert timed_out(server) == []
    server.turn_for(0.4)
    assert timed_out(server) == [("r0", "a")]


def test_pool_starts_until_its_first_command_or_its_end() -> None:
    server = a_driven_server("r0")
    graces = server.parts.agents.graces
    graces.update(dict.fromkeys("abc", ShareGrace(0, 0, 1)))

    server.drive("a", 3.0, 3.0)
    server.drive("b", 3.0, 3.0)  # has no claims
    server.inbox.agents.append(("c", False))
    server.loop.turn()
    server.loop.turn()

    assert list(graces) == ["b"]


def test_silent_pool_keeps_its_robots_for_a_time_that_grows_with_their_number() -> None:
    few, many = a_paced_driven_server("r0"), a_paced_driven_server("r0", "r1", "r2")
    lasting = []
    for server in (few, many):
        server.turn_for(0.5)
        lasting.append(server.parts.agents.graces["a"].lasts_ns)

    assert timed_out(many) == [("r0", "a"), ("r1", "a"), ("r2", "a")]
    assert lasting == [TAKEOVER_NS, 3 * TAKEOVER_NS]


def test_command_ends_the_time_that_a_silent_pool_has() -> None:
    server = a_paced_driven_server("r0")
    server.turn_for(0.5)
    before = dict(server.parts.agents.graces)

    server.drive("a", 3.0, 3.0)
    server.loop.turn()

    assert list(before) == ["a"]
    assert server.parts.agents.graces == {}
