"""A short fuzz run of every parser; `make fuzz` runs a thousand times as long."""

import pytest

from tests.hostile.fuzz import READERS, SHARES, fuzz

RUNS = 200


@pytest.mark.parametrize("reader", READERS)
def test_parser_accepts_or_refuses_damaged_input(reader: str) -> None:
    found = fuzz(reader, runs=RUNS, seed=7)

    assert found.total() == RUNS
    assert found["read"] > 0
    assert len(found) > 1


def test_same_seed_gives_the_same_outcomes() -> None:
    assert fuzz("bundle", runs=50, seed=1) == fuzz("bundle", runs=50, seed=1)


def test_every_parser_gets_its_share_of_the_runs() -> None:
    assert set(SHARES) == set(READERS)
    assert sum(SHARES.values()) == pytest.approx(1.0)
