"""Worlds in free running over the network, which the engine repeats with equal bits."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.integration.random_runs import STEPS_PER_S, find_change, make_random_run
from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.input_messages import Inputs
from zensim.sim_server.input_log.input_records import StateSums, write_records
from zensim.sim_server.input_log.resimulation import ResimChanges, Resimulation
from zensim.sim_server.physics.engine_calls import Command, Steps

SECONDS = 1.5


@pytest.mark.parametrize(
    "engine", [pytest.param("pybullet", marks=pytest.mark.long_form), "mujoco"]
)
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


@pytest.mark.parametrize(
    "engine", ["pybullet", pytest.param("mujoco", marks=pytest.mark.long_form)]
)
def test_changed_byte_of_a_command_is_found_in_the_second_in_which_it_acts(
    engine: EngineName, tmp_path: Path
) -> None:
    run = make_random_run(engine, seconds=SECONDS, seed=4)

    def find_difference(messages: Sequence[Inputs]) -> int | None:
        again = Resimulation(tmp_path, ResimChanges())
        for message in messages:
            again.feed(message)
        first = again.finish().first_difference
        return None if first is None else first.step

    step, found = find_change(run.messages, find_difference)

    assert step <= found <= step + STEPS_PER_S


def test_a_change_without_effect_is_followed_by_one_of_a_later_command() -> None:
    # A message begins with commands of steps before its own.
    targets = np.full(2, 3.0).tobytes()
    command, steps = Command(0, targets), Steps(2)
    (data,) = write_records((command, steps, StateSums(8, b""), command, steps))
    messages = [Inputs(step=step, records=data) for step in (0, 10, 20, 30)]
    changed_places: list[int] = []

    def find_difference(tried: Sequence[Inputs]) -> int | None:
        pairs = enumerate(zip(tried, messages, strict=False))
        changed_places.extend(place for place, (one, now) in pairs if one is not now)
        return 42 if len(changed_places) == 2 else None

    assert find_change(messages, find_difference)[1] == 42
    assert changed_places == [2, 3]
