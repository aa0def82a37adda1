"""Pendulums, arms that hold, mimic chains, lifts and gears, against the textbook."""

from collections.abc import Iterator

from benchmarks.figures import Figure


def rows(engine: str, *, is_short: bool) -> Iterator[Figure]:
    """Measure each situation in one engine."""
    yield from ()
