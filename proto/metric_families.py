"""Values that a program counts, in the form of Prometheus; no library, no network."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping
from typing import Final, Literal, TypeAlias

import msgspec

BOUNDS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
BOUNDS_NS: Final = tuple(round(bound_s * 1e9) for bound_s in BOUNDS_S)
BUCKETS: Final = (*map(str, BOUNDS_S), "+Inf")

MetricKind = Literal["counter", "gauge", "histogram", "summary"]


class MetricSample(msgspec.Struct, frozen=True):
    """A value of a family."""

    value: float
    labels: Mapping[str, str] = {}
    suffix: str = ""
    """Appended to the name of the family."""


class MetricFamily(msgspec.Struct, frozen=True):
    """Values of one name; those of a counter end in `_total`."""

    name: str
    kind: MetricKind
    documentation: str
    samples: tuple[MetricSample, ...]


ListMetrics: TypeAlias = Callable[[], Iterable[MetricFamily]]


def make_gauge(name: str, documentation: str, value: float) -> MetricFamily:
    """Make a family with one value that rises and falls."""
    return MetricFamily(name, "gauge", documentation, (MetricSample(value),))


def make_counter(name: str, documentation: str, value: float) -> MetricFamily:
    """Make a family with one value that only rises."""
    return MetricFamily(name, "counter", documentation, (MetricSample(value),))


def make_labelled(
    name: str,
    kind: MetricKind,
    documentation: str,
    values: Mapping[tuple[str, ...], float],
    *labels: str,
) -> MetricFamily:
    """Make a family with a value for each combination of labels.

    Args:
        name: Of the family.
        kind: Of the family.
        documentation: One line.
        values: By the values of the labels.
        labels: Their names.
    """
    samples = tuple(
        MetricSample(value, dict(zip(labels, key, strict=True)))
        for key, value in tuple(values.items())
    )
    return MetricFamily(name, kind, documentation, samples)


class DurationHistogram:
    """Counts durations by buckets; `add` takes a third of a microsecond."""

    def __init__(self) -> None:
        self.sum_ns = 0
        self._counts = [0] * len(BUCKETS)

    def add(self, duration_ns: int) -> None:
        """Count a duration."""
        self._counts[bisect_left(BOUNDS_NS, duration_ns)] += 1
        self.sum_ns += duration_ns

    @property
    def count(self) -> int:
        """Number of durations."""
        return sum(self._counts)

    def make_family(self, name: str, documentation: str) -> MetricFamily:
        """Make the family of its buckets, their sum [s] and number."""
        samples, total = [], 0
        for bound, count in zip(BUCKETS, tuple(self._counts), strict=True):
            total += count
            samples.append(MetricSample(total, {"le": bound}, "_bucket"))
        samples.append(MetricSample(total, suffix="_count"))
        samples.append(MetricSample(self.sum_ns * 1e-9, suffix="_sum"))
        return MetricFamily(name, "histogram", documentation, tuple(samples))
