"""Measured pages: sections by name, and what was missed."""

from benchmarks.measured_page import format_page, list_missed, read_sections

ONE = """## One

`.venv/bin/python -m benchmarks one`

| figure | asked | seen | n |
|---|---|---|---|
| way [m] | max <= 2 | 3, **missed** | 1 |
| time [s] | max <= 2 | 1, met | 1 |
"""
TWO = """## Two

`.venv/bin/python -m benchmarks two`

| load | latest step [ms] | memory most / kept [MiB] |
|---|---|---|
| flood | 70.6 **missed** | 110 **missed** / 3 |
| none | 3 | 1 / 1 |
"""


def test_sections_are_found_by_the_command_below_their_heading() -> None:
    text = f"# Page\n\n## Missed\n\nNothing.\n\n{ONE}\n{TWO}"

    assert read_sections(text) == {"one": ONE, "two": TWO}


def test_missed_figures_are_named_with_limit_and_value() -> None:
    assert list(list_missed(ONE)) == ["way [m]: asked max <= 2, seen 3"]


def test_missed_columns_of_other_tables_are_named() -> None:
    assert list(list_missed(TWO)) == [
        "flood: latest step [ms] 70.6, memory most / kept [MiB] 110 / 3"
    ]


def test_page_has_machine_misses_and_sections_in_the_order_of_names() -> None:
    page = format_page("# Page\n", [("cores", "2")], {"two": TWO, "one": ONE}, ["one", "two"])

    order = ("# Page", "| cores | 2 |", "## Missed", "- way [m]:", "- flood:", "## One", "## Two")
    assert sorted(order, key=page.index) == list(order)
    assert read_sections(page) == {"one": ONE, "two": TWO}


def test_page_says_that_nothing_was_missed() -> None:
    assert "## Missed\n\nNothing.\n" in format_page("# Page\n", [], {}, [])
