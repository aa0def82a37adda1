"""What a sweep has shown, by the values that varied."""

from tests.deploy.sweep.sweep_samples import make_sweep_row
from zensim.deploy.sweep.sweep_report import MarginSummary, format_groups, group_rows

ROWS = [
    make_sweep_row("a", inputs={"v": 10, "w": "x"}, margins={"apart": 0.5}, cpu_s=0.1),
    make_sweep_row("b", inputs={"v": 2, "w": "x"}, margins={"apart": -0.5}, is_passed=False),
    make_sweep_row("c", inputs={"v": 10, "w": "y"}, margins={"apart": 0.1}, cpu_s=0.3),
    make_sweep_row("d", inputs={"v": 2, "w": "x"}, is_passed=False, error="killed"),
]


def test_groups_are_sorted_by_number_and_sum_up_margins() -> None:
    low, high = group_rows(ROWS, ["v"])

    assert (low.inputs, low.runs, low.passed, low.errors) == ({"v": 2}, 2, 0, 1)
    assert low.margins == {"apart": MarginSummary(-0.5, -0.5)}
    assert high.margins == {"apart": MarginSummary(0.1, 0.3)}
    assert high.cpu_s == 0.2


def test_all_values_part_the_runs_and_none_joins_them() -> None:
    assert len(group_rows(ROWS, ["v", "w"])) == 3
    assert [one.runs for one in group_rows(ROWS, [])] == [4]


def test_table_has_a_line_for_each_group() -> None:
    lines = format_groups(group_rows(ROWS, ["v"])).splitlines()

    assert lines[0].startswith("| v | runs | passed | errors |")
    assert "-0.5, -0.5" in lines[2]
    assert len(lines) == 4
