"""A world that takes the place of another: nothing of the old one is left, whatever it was."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.engines import STEP_NS, ObedientEngine
from tests.sim_server.fakes import a_command, a_world, kinds_of_events, names_in
from zensim.proto.messages.simulation_messages import State
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.world.applied_forces import LinkWrench, TimeSpan
from zensim.sim_server.world.simulated_world import World

names = st.lists(st.sampled_from(["a", "b", "c", "d"]), unique=True)


def a_pair(old: list[str], new: list[str]) -> tuple[World, ObedientEngine, ObedientEngine]:
    """Make a world, and let it become another; give both engines."""
    engines = (ObedientEngine(EngineConfig(STEP_NS)), ObedientEngine(EngineConfig(STEP_NS)))
    world, other = a_world(*old, engine=engines[0]), a_world(*new, engine=engines[1])
    if old:
        world.claim("agent", tuple(old), "stop")
        world.applied_forces.add(LinkWrench(old[0], 0, np.zeros(6), TimeSpan(0, None)))
    world.step()
    world.clock.take_events()
    world.replace_with(other, State.STOPPED)
    return world, *engines


@given(old=names, new=names)
def test_world_holds_what_the_other_held_and_nothing_else(old: list[str], new: list[str]) -> None:
    world, before, after = a_pair(old, new)

    assert names_in(world) == new
    assert before.is_closed
    assert not after.is_closed
    assert [entity.body for entity in world.entities] == list(after.bodies)
    assert (len(world.claims), len(world.applied_forces)) == (0, 0)
    assert (world.clock.steps, world.clock.epoch, world.clock.state) == (0, 1, State.STOPPED)
    told = ["deleted"] * len(old) + ["loaded"] + ["spawned"] * len(new)
    assert kinds_of_events(world) == told
    assert len(world.states().base) == len(new)


def test_command_for_the_old_world_is_dropped() -> None:
    world, _, _ = a_pair(["a"], ["a"])
    stale = a_command(world, "agent", 1.0, 1.0)
    world.claim("agent", ("a",), "stop")

    assert not world.command("agent", stale)


def test_agent_that_lost_everything_is_told_so() -> None:
    world, _, _ = a_pair(["a", "b"], [])

    told = dict(world.drive_states())

    assert told["agent"].claims == b""
    assert told["agent"].epoch == 1
