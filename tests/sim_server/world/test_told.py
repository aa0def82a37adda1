"""Where an entity is said to be while time runs: as agents were told."""

import pytest

from tests.engines import STEP_NS
from tests.models import on_ground
from tests.sim_server.fakes import CONTROL_STEPS, a_command, a_world
from zensim.sim_server.errors import EntityNotFound
from zensim.sim_server.world.simulated_world import MAX_STATE_AGE_NS, World


def moving() -> World:
    """Let a cart drive, and tell agents of a control step."""
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 5.0, 5.0))
    for _ in range(CONTROL_STEPS):
        world.step()
    list(world.drive_states())
    return world


def test_entity_is_where_agents_were_told_until_the_next_control_step() -> None:
    world = moving()
    there = world.state_of("r0").copy()

    for _ in range(CONTROL_STEPS - 1):
        world.step()
        row, time_ns = world.reported_state("r0")
        assert row.tolist() == there.tolist()
        assert time_ns == CONTROL_STEPS * STEP_NS

    assert world.state_of("r0")[0] > there[0]


def test_entity_is_read_anew_when_nobody_was_told_of_a_control_step() -> None:
    world = moving()
    for _ in range(CONTROL_STEPS):
        world.step()

    row, time_ns = world.reported_state("r0")

    assert row.tolist() == world.state_of("r0").tolist()
    assert time_ns == 2 * CONTROL_STEPS * STEP_NS


def test_entity_is_read_anew_when_agents_are_seldom_told() -> None:
    world = moving()
    world.control_steps = 240
    steps = MAX_STATE_AGE_NS // STEP_NS + 1
    for _ in range(steps):
        world.step()

    assert world.reported_state("r0")[1] == (CONTROL_STEPS + steps) * STEP_NS


def test_entity_is_where_it_was_put_as_soon_as_it_was_put_there() -> None:
    world = moving()
    world.step()

    world.place("r0", on_ground(7.0))

    assert world.reported_state("r0")[0][0] == pytest.approx(7.0)


def test_entity_is_where_it_is_now_while_time_stands() -> None:
    world = moving()
    world.clock.pause()
    world.step()

    row, time_ns = world.reported_state("r0")

    assert row.tolist() == world.state_of("r0").tolist()
    assert time_ns == (CONTROL_STEPS + 1) * STEP_NS


def test_entity_that_is_not_there_is_not_told_of() -> None:
    with pytest.raises(EntityNotFound):
        moving().reported_state("r2")
