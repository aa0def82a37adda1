"""Rows of a sweep, and their columns."""

from tests.deploy.sweep.sweep_samples import make_report, make_run, make_sweep_row
from zensim.deploy.sweep.sweep_rows import find_unequal_repeats, make_columns, make_row


def test_row_has_inputs_margins_digest_and_verdict() -> None:
    row = make_row(make_run(), make_report())

    assert (row.id, row.digest, row.inputs) == ("a1", "abc", {"behaviours.go.v": 0.3})
    assert row.margins == {"there": 0.25, "stops": None}
    assert (row.is_passed, row.failed) == (False, ("stops",))


def test_columns_name_inputs_margins_and_versions() -> None:
    columns = make_columns([make_row(make_run(), make_report())])

    assert columns["in.behaviours.go.v"] == [0.3]
    assert columns["margin.there"] == [0.25]
    assert columns["version.zensim"] == ["0.1.0"]
    assert {len(values) for values in columns.values()} == {1}


def test_column_of_mixed_values_has_one_type() -> None:
    rows = [
        make_sweep_row("a", inputs={"n": 1, "t": "x", "m": "x"}),
        make_sweep_row("b", inputs={"n": 2.5, "t": None, "m": 3}),
        make_sweep_row("c", inputs={"n": 2, "m": {"uniform": [0, 1]}}),
    ]

    columns = make_columns(rows)

    assert columns["in.n"] == [1.0, 2.5, 2.0]
    assert columns["in.t"] == ["x", None, None]
    assert columns["in.m"] == ["x", "3", '{"uniform": [0, 1]}']


def test_whole_numbers_beyond_64_bits_are_text() -> None:
    rows = [make_sweep_row("a", inputs={"g": 2**64}), make_sweep_row("b", inputs={"g": 1})]

    assert make_columns(rows)["in.g"] == [str(2**64), "1"]


def test_error_that_is_no_text_can_be_written() -> None:
    row = make_row(make_run(), make_report(error="no file \udcff"))

    assert row.error == "no file ?"


def test_repeats_with_unequal_states_are_found() -> None:
    rows = [
        make_sweep_row("a", inputs={"v": 1}, digest="x"),
        make_sweep_row("b", inputs={"v": 1}, digest="y", repeat=1),
        make_sweep_row("c", inputs={"v": 2}, digest="x"),
        make_sweep_row("d", inputs={"v": 2}, digest="", error="killed", repeat=1),
    ]

    assert find_unequal_repeats(rows) == [("a", "b")]
