"""Metric families: buckets of durations, labels."""

import pytest

from zensim.proto.metric_families import BUCKETS, DurationHistogram, make_labelled

MS = 1_000_000


def read(histogram: DurationHistogram) -> dict[str, float]:
    family = histogram.make_family("zensim_x_seconds", "X.")
    return {one.labels.get("le", one.suffix): one.value for one in family.samples}


def test_histogram_counts_durations_up_to_each_bound() -> None:
    histogram = DurationHistogram()

    for duration_ns in (0, MS, MS + 1, 30 * MS, 5000 * MS):
        histogram.add(duration_ns)

    values = read(histogram)
    assert (values["0.001"], values["0.002"], values["0.02"]) == (2, 3, 3)
    assert (values["0.05"], values["1.0"], values["+Inf"]) == (4, 4, 5)
    assert values["_count"] == histogram.count == 5
    assert values["_sum"] == pytest.approx(5.032000001)


def test_empty_histogram_has_all_buckets() -> None:
    values = read(DurationHistogram())

    assert set(values) == {*BUCKETS, "_count", "_sum"}
    assert set(values.values()) == {0}


def test_labelled_values_have_their_labels() -> None:
    family = make_labelled("zensim_x", "gauge", "X.", {("a", "b"): 2.0}, "one", "two")

    assert [(dict(one.labels), one.value) for one in family.samples] == [
        ({"one": "a", "two": "b"}, 2.0)
    ]
