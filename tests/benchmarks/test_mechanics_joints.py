"""Short form of the joints of `python -m benchmarks mechanics`: each is within its tolerance."""

import pytest

from benchmarks.bench_mechanics import ENGINES
from benchmarks.figures import missed_among
from benchmarks.mechanics_joints import rows


@pytest.mark.parametrize("engine", ENGINES)
def test_joints_are_as_mechanics_says(engine: str) -> None:
    assert missed_among(rows(engine, is_short=True), is_short=True) == ()
