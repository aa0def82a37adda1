"""Rows of acceptance tables: what is asked of a count or a time."""

from collections.abc import Iterable

from benchmarks.figures import Figure, Limit


def naming(what: str, items: Iterable[str]) -> str:
    """Add what was found to the name of a row, if there is any."""
    return ": ".join((what, ", ".join(items))).removesuffix(": ")


def none_of(what: str, count: float, unit: str = "") -> Figure:
    """Make a row for what must not occur."""
    return Figure(what=what, unit=unit, samples=(float(count),), limit=Limit("max", "<=", 0.0))


def all_of(what: str, count: float, wanted: float, unit: str = "") -> Figure:
    """Make a row for what must occur at least so often."""
    return Figure(what=what, unit=unit, samples=(float(count),), limit=Limit("min", ">=", wanted))


def at_most(
    what: str, samples: Iterable[float], bound: float, unit: str, *, is_timed: bool = False
) -> Figure:
    """Make a row for the largest of some values."""
    limit = Limit("max", "<=", bound, is_timed=is_timed)
    return Figure(what=what, unit=unit, samples=tuple(samples), limit=limit)


def within(
    what: str, samples: Iterable[float], bounds: tuple[float, float], unit: str
) -> tuple[Figure, Figure]:
    """Make two rows: the least value and the largest one."""
    values = tuple(samples)
    low, high = bounds
    return (
        Figure(what=f"{what}, least", unit=unit, samples=values, limit=Limit("min", ">=", low)),
        Figure(what=f"{what}, largest", unit=unit, samples=values, limit=Limit("max", "<=", high)),
    )
