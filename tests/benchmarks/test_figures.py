"""How a figure is judged and written."""

import pytest

from benchmarks.figures import Figure, Limit, missed, missed_among, table


def a_figure(*samples: float, limit: Limit | None = None) -> Figure:
    return Figure(what="way", unit="ms", samples=samples, limit=limit)


def cells(figure: Figure) -> list[str]:
    return [cell.strip() for cell in table([figure]).splitlines()[2].strip("|").split("|")]


@pytest.mark.parametrize(
    ("limit", "is_missed"),
    [
        (Limit("max", "<=", 3.0), False),
        (Limit("max", "<=", 2.9), True),
        (Limit("min", ">=", 1.0), False),
        (Limit("mean", ">=", 2.1), True),
        (Limit("median", "<=", 2.0), False),
        (Limit("p99", "<=", 2.9), True),
        (None, False),
    ],
)
def test_figure_is_missed_when_its_statistic_is_beyond_the_limit(
    limit: Limit | None, *, is_missed: bool
) -> None:
    assert a_figure(3.0, 1.0, 2.0, limit=limit).is_missed is is_missed


def test_table_shows_what_was_asked_what_was_seen_and_the_spread() -> None:
    figure = a_figure(*[float(i) for i in range(1, 12)], limit=Limit("max", "<=", 12.0))

    assert cells(figure) == [
        *("way [ms]", "max <= 12", "11, met", "6", "2 to 10", "", "1 to 11", "11")
    ]


def test_table_shows_the_99th_percentile_of_many_samples() -> None:
    assert cells(a_figure(*[float(i) for i in range(1, 201)]))[5] == "198"


def test_table_marks_what_was_missed() -> None:
    assert cells(a_figure(0.5, limit=Limit("min", ">=", 0.99)))[2] == "0.5, **missed**"


def test_missed_says_both_what_was_asked_and_what_was_seen() -> None:
    figure = a_figure(1234.5, limit=Limit("p99", "<=", 50.0))

    assert missed(figure) == "way [ms]: asked p99 <= 50, seen 1234"


def test_missed_refuses_a_figure_of_which_nothing_was_asked() -> None:
    with pytest.raises(ValueError, match="'way"):
        missed(a_figure(1.0))


def test_short_run_is_not_judged_by_what_other_programs_can_break() -> None:
    figures = [
        a_figure(2.0, limit=Limit("max", "<=", 1.0, is_timed=True)),
        a_figure(3.0, limit=Limit("max", "<=", 1.0)),
        a_figure(4.0),
    ]

    assert missed_among(figures, is_short=True) == ("way [ms]: asked max <= 1, seen 3",)
    assert len(missed_among(figures, is_short=False)) == 2
