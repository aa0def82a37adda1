"""Worlds in free running over the network, which the engine repeats with equal bits."""

from pathlib import Path

import pytest

from tests.integration.random_runs import change_command, make_random_run
from zensim.sim_server.input_log.resimulation import ResimChanges, Resimulation
from zensim.sim_server.physics.engine_config import EngineName

SECONDS = 1.5


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_run_over_the_network_is_repeated(engine: EngineName, tmp_path: Path) -> None:
    run = make_random_run(engine, seconds=SECONDS, seed=3)
    again = Resimulation(tmp_path, ResimChanges())

    for message in run.messages:
        again.feed(message)
    result = again.finish()

    assert result.first_difference is None
    assert (result.is_exact, result.lost_messages, result.starts) == (True, 0, 1)
    assert result.control_steps > 0
    assert result.states == result.equal_states > 0
    assert run.inputs > 1
    assert {one.service for message in run.messages for one in message.requests} >= {
        "spawn_entity",
        "claim_entity",
    }


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_changed_byte_of_a_command_is_found_where_it_acts(
    engine: EngineName, tmp_path: Path
) -> None:
    run = make_random_run(engine, seconds=SECONDS, seed=4)
    changed, step = change_command(run.messages, run.messages[-1].step // 2)
    again = Resimulation(tmp_path, ResimChanges())

    for message in changed:
        again.feed(message)
    first = again.finish().first_difference

    assert first is not None
    assert (first.step, first.count) == (step, 1)
