"""Measured figures, their limits, and their format."""

import statistics
from collections.abc import Callable, Iterable
from typing import Literal

import msgspec


def quantile(ordered: list[float], share: float) -> float:
    """Compute a quantile of sorted numbers."""
    return ordered[round(share * (len(ordered) - 1))]


Statistic = Literal["mean", "median", "p95", "p99", "min", "max"]
STATISTICS: dict[Statistic, Callable[[list[float]], float]] = {
    "mean": statistics.fmean,
    "median": lambda ordered: quantile(ordered, 0.5),
    "p95": lambda ordered: quantile(ordered, 0.95),
    "p99": lambda ordered: quantile(ordered, 0.99),
    "min": lambda ordered: ordered[0],
    "max": lambda ordered: ordered[-1],
}
LEAST_FOR_P99 = 100
"""Fewest samples with a 99th percentile; with fewer it is the maximum."""
HEAD = ("figure", "asked", "seen", "median", "p10 to p90", "p99", "min to max", "n")


class Limit(msgspec.Struct, frozen=True):
    """A limit on one statistic of a figure."""

    statistic: Statistic
    relation: Literal["<=", ">="]
    bound: float
    is_timed: bool = False
    """Whether it depends on the load of the machine."""

    def __str__(self) -> str:
        return f"{self.statistic} {self.relation} {self.bound:g}"

    @classmethod
    def parse(cls, text: str) -> "Limit":
        """Read a limit as it is written; raises msgspec.ValidationError for others."""
        statistic, relation, bound = text.split()
        values = {"statistic": statistic, "relation": relation, "bound": float(bound)}
        return msgspec.convert(values, cls)

    def is_met(self, value: float) -> bool:
        """Whether a value of the statistic is within the limit."""
        return value <= self.bound if self.relation == "<=" else value >= self.bound


class Figure(msgspec.Struct, frozen=True, kw_only=True):
    """One quantity, measured at least once."""

    what: str
    unit: str
    samples: tuple[float, ...]
    limit: Limit | None = None

    def __str__(self) -> str:
        return f"{self.what} [{self.unit}]" if self.unit else self.what

    def value(self, statistic: Statistic) -> float:
        """Compute a statistic of the samples."""
        return STATISTICS[statistic](sorted(self.samples))

    @property
    def is_missed(self) -> bool:
        """Whether the limit is exceeded."""
        return self.limit is not None and not self.limit.is_met(self.value(self.limit.statistic))


def table(figures: Iterable[Figure]) -> str:
    """Format figures as a Markdown table."""
    head = f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}\n"
    return head + "".join(f"| {' | '.join(_cells(figure))} |\n" for figure in figures)


def missed(figure: Figure) -> str:
    """Format the limit and the measured value in one line."""
    if figure.limit is None:
        raise ValueError(f"nothing was asked of '{figure}'")
    return f"{figure}: asked {figure.limit}, seen {written(figure.value(figure.limit.statistic))}"


def missed_among(figures: Iterable[Figure], *, is_short: bool) -> tuple[str, ...]:
    """List exceeded limits; in a short run only those independent of the machine's load."""
    judged = (one for one in figures if one.limit and not (is_short and one.limit.is_timed))
    return tuple(missed(one) for one in judged if one.is_missed)


def written(number: float) -> str:
    """Format a number with three significant digits."""
    return f"{number:.0f}" if abs(number) >= 1000 else f"{number:.3g}"


def _cells(figure: Figure) -> tuple[str, ...]:
    low, high = (quantile(sorted(figure.samples), share) for share in (0.1, 0.9))
    count = len(figure.samples)
    return (
        str(figure),
        str(figure.limit or ""),
        _seen(figure),
        written(figure.value("median")),
        f"{written(low)} to {written(high)}",
        written(figure.value("p99")) if count >= LEAST_FOR_P99 else "",
        f"{written(figure.value('min'))} to {written(figure.value('max'))}",
        str(count),
    )


def _seen(figure: Figure) -> str:
    if figure.limit is None:
        return ""
    verdict = "**missed**" if figure.is_missed else "met"
    return f"{written(figure.value(figure.limit.statistic))}, {verdict}"
