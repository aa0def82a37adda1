"""Lockstep under any sequence of replies, silence, liveliness changes and requests."""

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.models import on_ground
from tests.sim_server.fakes import CONTROL_STEPS, ServerFixture, a_spawn
from tests.sim_server.runtime.test_loop_lockstep import TIMEOUT_S, a_locked_server, answer_states
from zensim.proto.messages.agent_messages import ClaimEntityRequest
from zensim.proto.messages.simulation_messages import State
from zensim.proto.settings.lockstep_settings import OnMiss

AGENTS = ("r0", "r1", "r2")
ACTS = st.one_of(
    st.tuples(st.just("answer"), st.sets(st.sampled_from(AGENTS))),
    st.tuples(st.sampled_from(("go", "come", "delete", "spawn")), st.sampled_from(AGENTS)),
    st.tuples(st.just("reset"), st.sampled_from((1, 2, 3))),
    st.tuples(st.just("wait"), st.sampled_from((0.001, 0.6 * TIMEOUT_S, 1.1 * TIMEOUT_S))),
)


def act(server: ServerFixture, what: str, argument: object) -> None:
    """Do one action, then turn the loop a few times."""
    if what == "answer" and isinstance(argument, set):
        answer_states(server, silent=tuple(argument))
    elif what == "reset" and isinstance(argument, int):
        server.world.reset(argument)
    elif what == "wait" and isinstance(argument, float):
        server.turn_for(argument)
    else:
        _change_liveliness(server, what, str(argument))
    for _ in range(CONTROL_STEPS + 1):
        server.loop.turn()


def _change_liveliness(server: ServerFixture, what: str, name: str) -> None:
    is_there = name in {entity.name for entity in server.world.entities}
    if what in ("go", "come"):
        server.inbox.agents.append((name, what == "come"))
        if what == "come":
            server.request("claim_entity", ClaimEntityRequest(name, (name,)))
    elif what == "delete" and is_there:
        server.world.delete(name)
    elif what == "spawn" and not is_there:
        server.world.spawn(a_spawn(name, base=on_ground(float(AGENTS.index(name)))))


@settings(max_examples=40)
@given(st.lists(ACTS, max_size=12), st.sampled_from(("wait", "hold", "fail")))
def test_time_never_goes_back_in_an_epoch_and_continues_when_all_agents_reply(
    acts: list[tuple[str, object]], on_miss: OnMiss
) -> None:
    server = a_locked_server(*AGENTS, on_miss=on_miss)
    moments = [(0, 0)]

    for what, argument in acts:
        act(server, what, argument)
        moments.append((server.world.clock.epoch, server.world.clock.steps))
        assert set(server.parts.pacing.lockstep.awaited) <= set(server.world.claims.agents)

    assert moments == sorted(moments)
    if server.world.clock.state == State.PAUSED:
        server.world.clock.change_state(State.PLAYING)
    server.publisher.drive_states.clear()
    before = server.world.clock.steps
    server.turn_for(1.1 * TIMEOUT_S)
    for _ in range(4 * CONTROL_STEPS):
        answer_states(server)
        if server.world.clock.state == State.PAUSED:
            server.world.clock.change_state(State.PLAYING)
        server.loop.turn()
    assert server.world.clock.steps > before + CONTROL_STEPS
