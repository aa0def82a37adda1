"""A short fuzz run of a server with each engine; `make fuzz` runs hundreds of times as long."""

import random
from collections import Counter
from pathlib import Path

import pytest

from tests.hostile.mutants import mutate, own_robots
from tests.hostile.server_fuzz import (
    ENGINES,
    FuzzFailure,
    FuzzSettings,
    find_slug,
    fuzz_server,
    make_reference,
    own_seeds,
)
from zensim.sim_server.description.pipeline import read_robot
from zensim.sim_server.errors import ModelError

RUNS = 20
SILENT = Path("/dev/null")


@pytest.mark.short_form
@pytest.mark.parametrize("engine", ENGINES)
def test_server_and_a_driven_robot_survive_mutants(engine: str) -> None:
    settings = FuzzSettings(engine, RUNS, SILENT, seed=7)

    found = Counter(
        outcome for outcome, _ in fuzz_server(settings, own_seeds(), make_reference(settings))
    )

    assert found.total() == RUNS
    assert found["simulated"] > RUNS // 8
    assert len(found) > 3


@pytest.mark.short_form
def test_fuzzer_notices_a_robot_that_was_disturbed() -> None:
    settings = FuzzSettings(ENGINES[0], 1, SILENT)

    with pytest.raises(FuzzFailure):
        list(fuzz_server(settings, own_seeds(), [b"another state"]))


def test_mutants_repeat_and_are_often_parsed() -> None:
    seeds, parsed = own_robots(), 0
    for run in range(100):
        text = mutate(seeds[run % len(seeds)], random.Random(run))
        assert text == mutate(seeds[run % len(seeds)], random.Random(run))
        parsed += is_parsed(text)

    assert 20 < parsed < 90


def is_parsed(text: str) -> bool:
    try:
        read_robot(text, allow_missing=True)
    except ModelError:
        return False
    return True


@pytest.mark.parametrize("text", own_robots(), ids=lambda text: str(len(text)))
def test_own_robots_are_read_before_they_are_changed(text: str) -> None:
    assert is_parsed(text)


@pytest.mark.parametrize(
    ("message", "slug"),
    [("urdf.mass: too light", "urdf.mass"), ("entity 'a': exists", "refused"), ("no", "refused")],
)
def test_slug_of_a_refusal_is_found(message: str, slug: str) -> None:
    assert find_slug(message) == slug
